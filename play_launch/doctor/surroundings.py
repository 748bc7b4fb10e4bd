"""What started this process, as far as its rights depend on that. Pure."""

from __future__ import annotations

import re
from enum import StrEnum
from typing import Final

_SESSION: Final = re.compile(r"session-\w+\.scope$")


class Surroundings(StrEnum):
    """What gives rights, and takes them."""

    LOGIN = "login"
    """A shell, or nobody that is known."""
    SYSTEM_SERVICE = "system service"
    USER_SERVICE = "user service"
    DOCKER = "Docker"
    PODMAN = "Podman"


def surroundings_of(groups: str, *, docker: bool, podman: bool) -> Surroundings:
    """Conclude what started us.

    Args:
        groups: What `/proc/self/cgroup` says.
        docker: Whether Docker's mark is there, `/.dockerenv`.
        podman: Whether Podman's is, `/run/.containerenv`.
    """
    if podman:
        return Surroundings.PODMAN
    if docker:
        return Surroundings.DOCKER
    for line in groups.splitlines():
        path = line.partition(":")[2].partition(":")[2]
        if _SESSION.search(path):
            return Surroundings.LOGIN
        if re.search(r"/user@\d+\.service/.*\.service(/|$)", path):
            return Surroundings.USER_SERVICE
        if re.match(r"/system\.slice/.*\.service(/|$)", path):
            return Surroundings.SYSTEM_SERVICE
    return Surroundings.LOGIN

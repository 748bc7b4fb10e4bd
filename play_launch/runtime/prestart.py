"""Prestart: `replay` starts the session's guard and zygotes before it reads its configuration.

Python imports for longer than a container's program takes to be linked, on another processor.
Until the configuration is known to be good, nothing of ROS runs. If it is not, the guard ends the
zygotes when the supervisor exits. Imports only what is needed, as all of the start waits for it.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from play_launch.container.environment import child_environment, find_allocator, for_isolation
from play_launch.container.ros import (
    MixedInstallationError,
    NotInstalledError,
    component_container,
    ros_installation,
    spawn_guard,
)
from play_launch.process.guard import SessionGuard
from play_launch.process.zygote import Zygote
from play_launch.ros.fastdds.sweep_command import sweep_command

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

SWITCH: Final = "PLAY_LAUNCH_ZYGOTE"
"""Environment variable: with 0 every container is executed on its own."""
_TYPE: Final = re.compile(rb"container_type[\"']?\s*:\s*[\"']?(\w+)")

_MOST_TEXT: Final = 4_000_000


@dataclass(slots=True)
class Prestart:
    """Processes that run already."""

    guard: SessionGuard | None = None
    zygotes: list[Zygote] = field(default_factory=list)


_prestart = Prestart()


def begin(config: Path) -> None:
    """Start what containers of that file need; failures are reported by the start itself."""
    if os.environ.get(SWITCH) == "0":
        return
    try:
        if not config.is_file():
            return  # opening a pipe would wait, and opening a device can set something off
        with config.open("rb") as file:
            kinds = kinds_of_containers(file.read(_MOST_TEXT))
        if not kinds:
            return
        plain = child_environment(os.environ, ros_installation())
        program = component_container()
        _prestart.guard = SessionGuard.start(spawn_guard(), afterwards=sweep_command())
        # Such a program refuses to be forked, see container_native/src/main/zygote.cpp.
        for is_isolated in () if has_rclcpp(program) else kinds:
            environment = _with_allocator(plain) if is_isolated else plain
            _prestart.zygotes.append(Zygote.start(_prestart.guard, program, environment))
    except (OSError, ValueError, NotInstalledError, MixedInstallationError):
        return


def take() -> Prestart:
    """Pass on what was started, once."""
    taken = Prestart(_prestart.guard, list(_prestart.zygotes))
    _prestart.guard = None
    _prestart.zygotes.clear()
    return taken


def has_rclcpp(program: Path) -> bool:
    """Whether a container's program is linked with rclcpp."""
    return b"\0librclcpp.so\0" in program.read_bytes()


def kinds_of_containers(text: bytes) -> list[bool]:
    """Guess which containers the text of a configuration has: False ordinary, True isolated.

    A wrong guess is a zygote too many or too few.
    """
    if b"containers" not in text:
        return []
    types = set(_TYPE.findall(text))
    isolated = {each for each in types if each.startswith(b"isolated")}
    ordinary = types - isolated - {b"stock"}
    return [False] * (not types or bool(ordinary)) + [True] * bool(isolated)


def _with_allocator(environment: Mapping[str, str]) -> dict[str, str]:
    return for_isolation(environment, find_allocator().library)

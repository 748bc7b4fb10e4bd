"""What `replay` starts before it reads its configuration: the guard of the session and zygotes.

Python imports for longer than a container's program takes to be linked, on another processor.
Until the configuration is known to be good, nothing of ROS runs. If it is not, the guard ends the
zygotes when we end. Imports nothing that is not needed for this: everybody waits for it.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from play_launch.fastdds.sweep_command import sweep_command
from play_launch.install.allocator import find_allocator, for_isolation
from play_launch.install.environment import child_environment
from play_launch.install.ros import (
    MixedInstallationError,
    NotInstalledError,
    component_container,
    ros_installation,
    spawn_guard,
)
from play_launch.process.guard import SessionGuard
from play_launch.process.zygote import Zygote

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

SWITCH: Final = "PLAY_LAUNCH_ZYGOTE"
"""Environment variable: with 0 every container is executed on its own."""
_TYPE: Final = re.compile(rb"container_type[\"']?\s*:\s*[\"']?(\w+)")

_MOST_TEXT: Final = 4_000_000


@dataclass(slots=True)
class HeadStart:
    """What runs already."""

    guard: SessionGuard | None = None
    zygotes: list[Zygote] = field(default_factory=list)


_head_start = HeadStart()


def begin(config: Path) -> None:
    """Start what containers of that file are going to need; failures are for others to report."""
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
        _head_start.guard = SessionGuard.start(spawn_guard(), afterwards=sweep_command())
        # Such a program refuses to be forked, see container_native/src/main/zygote.cpp.
        for is_isolated in () if has_rclcpp(program) else kinds:
            environment = _with_allocator(plain) if is_isolated else plain
            _head_start.zygotes.append(Zygote.start(_head_start.guard, program, environment))
    except (OSError, ValueError, NotInstalledError, MixedInstallationError):
        return


def take() -> HeadStart:
    """Hand over what was started; the next one gets nothing."""
    taken = HeadStart(_head_start.guard, list(_head_start.zygotes))
    _head_start.guard = None
    _head_start.zygotes.clear()
    return taken


def has_rclcpp(program: Path) -> bool:
    """Say whether a container's program is linked with rclcpp."""
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

"""Makes this process speak ROS as a session does: same domain, middleware and discovery."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from play_launch.control.protocol import ROS_VARIABLES, Code, ControlError

if TYPE_CHECKING:
    from play_launch.control.client import ControlClient


def enter_environment_of(client: ControlClient) -> None:
    """Set what the session says about ROS; before anything of rclpy is imported.

    Root becomes the user of the session before that: profiles and middleware, which that user
    chooses, load libraries. Raises ControlError.
    """
    from play_launch.process.machine import (  # noqa: PLC0415 - slow, and rclpy is slower
        SHARED_MEMORY_FIX,
        full_shared_memory,
        shared_memory_room,
    )

    if full := full_shared_memory(shared_memory_room()):
        raise ControlError(Code.REFUSED, f"{full}; fix: {SHARED_MEMORY_FIX}")
    found = client.ask("environment")
    user = client.peer()
    if os.geteuid() == 0 and user.uid != 0:
        try:
            _become(user.uid, user.gid)
        except OSError as error:
            raise ControlError(
                Code.REFUSED, f"run this as user {user.uid}, whose session it is: {error}"
            ) from None
    for name in [name for name in os.environ if name.startswith(ROS_VARIABLES)]:
        del os.environ[name]
    # What it says besides is not taken over: LD_LIBRARY_PATH would choose libraries.
    os.environ.update(
        {name: str(value) for name, value in found.items() if name.startswith(ROS_VARIABLES)}
    )
    try:
        import rclpy  # noqa: F401, PLC0415
    except ImportError as error:
        raise ControlError(
            Code.REFUSED, f"ROS cannot be loaded as user {os.geteuid()}: {error}"
        ) from None


def _become(user: int, group: int) -> None:
    """Become a user for good, with home and groups."""
    import pwd  # noqa: PLC0415 - for root only

    groups, home = [group], "/"
    try:
        entry = pwd.getpwuid(user)
        groups, home = os.getgrouplist(entry.pw_name, group), entry.pw_dir
    except KeyError:
        pass  # a user of a container, without a name here
    os.setgroups(groups)
    os.setresgid(group, group, group)
    os.setresuid(user, user, user)
    os.environ["HOME"] = home

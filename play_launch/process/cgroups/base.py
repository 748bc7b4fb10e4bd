"""Below which group those of a session are made: facts about this machine, and the decision."""

from __future__ import annotations

import os
import re
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.process.cgroups.names import SUPERVISOR

if TYPE_CHECKING:
    from collections.abc import Iterable

_TYPE: Final = "cgroup2"
_OCTAL: Final = re.compile(r"\\([0-7]{3})")
_SYSTEMD: Final = "/run/systemd/system"
_DELEGATED: Final = ("user.delegate", "trusted.delegate")
"""Attributes by which systemd marks what it delegates; before version 251 only the second, which
root alone sees."""
_USER_MANAGER: Final = re.compile(r"user@.+\.service")
SCOPE_FIX: Final = (
    "start it by systemd-run --user --scope -p Delegate=yes play-launch ..., or Delegate=yes in "
    "its systemd unit"
)
_ROOT_FIX: Final = (
    "start it by systemd-run --scope -p Delegate=yes play-launch ..., Delegate=yes in its systemd "
    "unit, or a base_path such as /sys/fs/cgroup/play_launch"
)
READ_ONLY_FIX: Final = (
    "docker run --security-opt writable-cgroups=true (Docker 28 or newer), podman run "
    "--security-opt unmask=/sys/fs/cgroup, or --privileged"
)
_MOUNT_FIX: Final = (
    "mount -t cgroup2 none /sys/fs/cgroup, or boot with systemd.unified_cgroup_hierarchy=1"
)


class GroupError(Exception):
    """Control groups, or requested controllers, are missing; the text has cause and fix."""


class Hierarchy(Struct, frozen=True):
    """The hierarchy of version 2 as this process sees it, and the group that it is in itself."""

    mount: Path
    own: Path


class OwnGroup(Struct, frozen=True, kw_only=True):
    """What decides whether the group that we are in may be used."""

    is_writable: bool
    is_read_only: bool
    """The file system itself is."""
    is_top: bool
    """Nothing is above it, as far as this process sees."""
    is_root_user: bool
    is_systemds: bool
    """A manager of systemd arranges it: the user's own, for root the system's."""
    is_marked: bool
    """systemd says that it, or a group above it, is delegated to others than a manager."""


def hierarchy(mountinfo: str, cgroup: str) -> Hierarchy | None:
    """Parse ``/proc/self/mountinfo`` and ``/proc/self/cgroup``; None without cgroup v2."""
    own = own_path(cgroup)
    inside = PurePosixPath(own)
    if not own or ".." in inside.parts:  # above the root of the namespace that it is seen from
        return None
    for root, mount in _mounts(mountinfo.splitlines()):
        if inside.is_relative_to(root):
            return Hierarchy(Path(mount), Path(mount) / inside.relative_to(root))
    return None


def own_path(cgroup: str) -> str:
    """Give the group of the process of that file in ``/proc``; empty: it does not say."""
    return next((line[3:] for line in cgroup.splitlines() if line.startswith("0::")), "")


def _mounts(lines: Iterable[str]) -> Iterable[tuple[str, str]]:
    for line in lines:
        before, _, after = line.partition(" - ")
        fields = before.split(" ")
        if after.split(" ")[0] == _TYPE and len(fields) > 4:
            yield _plain(fields[3]), _plain(fields[4])


def _plain(text: str) -> str:
    return _OCTAL.sub(lambda found: chr(int(found[1], 8)), text)


def own_hierarchy() -> Hierarchy:
    """Find it on this machine; raises GroupError."""
    try:
        mountinfo, cgroup = (
            Path("/proc/self", each).read_text(encoding="utf-8", errors="surrogateescape")
            for each in ("mountinfo", "cgroup")
        )
    except OSError as error:
        raise GroupError(
            f"the control group of play-launch is not known: {error}; fix: a /proc that its user "
            "may read"
        ) from None
    found = hierarchy(mountinfo, cgroup)
    if found is None:
        raise GroupError(no_hierarchy(mountinfo, cgroup))
    return found


def no_hierarchy(mountinfo: str, cgroup: str) -> str:
    """Return why the own group is unknown, and the fix."""
    mounts = [mount for _, mount in _mounts(mountinfo.splitlines())]
    if not mounts:
        return f"no hierarchy of cgroup v2 is mounted; fix: {_MOUNT_FIX}"
    own = own_path(cgroup) or "none of version 2"
    return (
        f"the control group of play-launch is not below {mounts[0]}: /proc/self/cgroup names "
        f"{own}; fix: start it in a group below that (echo 0 > {mounts[0]}/cgroup.procs in its "
        "shell)"
    )


def facts_of(group: Path, mount: Path) -> OwnGroup:
    """Look at a group that we may be in."""
    try:
        is_read_only = bool(os.statvfs(group).f_flag & os.ST_RDONLY)
    except OSError:
        is_read_only = False
    is_root_user = os.geteuid() == 0
    to = next((each.name for each in _upwards(group, mount) if _is_marked(each)), "")
    to_manager = _USER_MANAGER.fullmatch(to) is not None
    return OwnGroup(
        is_writable=all(
            os.access(each, os.W_OK)
            for each in (group, group / "cgroup.procs", group / "cgroup.subtree_control")
        ),
        is_read_only=is_read_only,
        is_top=group == mount,
        is_root_user=is_root_user,
        # The user's manager gets its group marked where systemd marks any for users to see.
        is_systemds=to_manager or (is_root_user and Path(_SYSTEMD).is_dir()),
        is_marked=to != "" and not to_manager,
    )


def _upwards(group: Path, mount: Path) -> Iterable[Path]:
    return (each for each in (group, *group.parents) if each.is_relative_to(mount))


def _is_marked(group: Path) -> bool:
    try:
        return not set(os.listxattr(group)).isdisjoint(_DELEGATED)
    except OSError:
        return False


def own_base(own: Path) -> Path:
    """Give the group to look at: the one that we are in, without the leaf we may be in already."""
    return own.parent if own.name == SUPERVISOR else own


def delegated_group() -> Path:
    """Return the group below which sessions can make theirs; raises GroupError."""
    found = own_hierarchy()
    base = own_base(found.own)
    if why := obstacle(base, facts_of(base, found.mount)):
        raise GroupError(why)
    return base


def obstacle(group: Path, facts: OwnGroup) -> str:
    """Return why a group found under `auto` is not usable, and the fix; empty if it is."""
    fix = _ROOT_FIX if facts.is_root_user else SCOPE_FIX
    if facts.is_read_only:
        return f"{group} is read-only; fix: {READ_ONLY_FIX}"
    if not facts.is_writable:
        return f"the control group {group} is not delegated to this user; fix: {fix}"
    if facts.is_systemds and not (facts.is_top or facts.is_marked):
        # systemd rearranges what it has not given away, and there may be others' processes in it.
        return f"the control group {group} is systemd's own, not delegated; fix: {fix}"
    return ""

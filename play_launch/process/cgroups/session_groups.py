"""The groups of one session, from the first process to the last, and the group above them."""

from __future__ import annotations

import logging
import os
import re
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Final

from play_launch.process.cgroups.group import (
    CONTAINER,
    DELEGATION_FIX,
    SUPERVISOR,
    Group,
    GroupError,
    SessionName,
    group_name,
    path_of,
    why_killed,
)
from play_launch.process.identity import ProcessIdentity, read_stat

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from play_launch.config.resources import GroupLimits, GroupPolicy

_END_LIMIT: Final = 10.0
"""Seconds from the kill of a session's processes to their end."""
_MOVES: Final = 9  # passes: processes may fork while they are moved
_USER_MANAGER: Final = re.compile(r"user@.+\.service")
_DELEGATED: Final = frozenset({"user.delegate", "trusted.delegate"})
"""Attributes by which systemd marks what it delegates; before version 251 only the second, which
root alone sees."""

_log = logging.getLogger(__name__)


def hierarchy(mountinfo: str, own: str) -> tuple[Path, Path] | None:
    """Find the mount of cgroup v2 and in it the group `own`; None if it is not mounted."""
    for line in mountinfo.splitlines() if own else ():
        before, _, after = line.partition(" - ")
        root, mount = before.split(" ")[3:5]
        inside = PurePosixPath(own)
        if after.startswith("cgroup2 ") and inside.is_relative_to(root) and "/.." not in own:
            return Path(mount), Path(mount) / inside.relative_to(root)
    return None


def own_hierarchy() -> tuple[Path, Path]:
    """Return the mount of cgroup v2 and the group of this process in it; raises GroupError."""
    own = path_of(os.getpid())
    try:
        mounts = Path("/proc/self/mountinfo").read_text(errors="surrogateescape")
    except OSError as error:
        raise GroupError(
            f"the mounted hierarchies of control groups are unknown: {error}"
        ) from error
    found = hierarchy(mounts, own)
    if found is None:
        raise GroupError(
            f"no hierarchy of cgroup v2 with the group of play-launch ({own or 'unknown'}) is "
            "mounted; fix: mount -t cgroup2 none /sys/fs/cgroup, or boot with "
            "systemd.unified_cgroup_hierarchy=1"
        )
    return found


def delegated_group() -> Path:
    """Return the group that play-launch runs in, if it is delegated to it; raises GroupError."""
    mount, own = own_hierarchy()
    base = own.parent if own.name == SUPERVISOR else own
    if not _is_delegated(base, mount):
        raise GroupError(
            f"the control group {base} is not delegated to play-launch; fix: {DELEGATION_FIX}"
        )
    return base


def _is_delegated(group: Path, mount: Path) -> bool:
    files = (group, group / "cgroup.procs", group / "cgroup.subtree_control")
    if not all(os.access(each, os.W_OK) for each in files):
        return False
    above = (each for each in (group, *group.parents) if each.is_relative_to(mount))
    marked = next((each for each in above if _is_marked(each)), None)
    if marked is None:  # root may write everywhere; systemd before 251 marks nothing for users
        is_systemds = os.geteuid() == 0 and Path("/run/systemd/system").is_dir()
        return group == mount or not is_systemds
    # Groups below that of a user's manager are the manager's, unless it has delegated them.
    return _USER_MANAGER.fullmatch(marked.name) is None


def _is_marked(group: Path) -> bool:
    with suppress(OSError):
        return not _DELEGATED.isdisjoint(os.listxattr(group))
    return False


class SessionGroups:
    """Makes the groups of members and nodes; there are none until `begin`.

    What the kernel refuses is logged once. Where groups are required, it raises GroupError.
    """

    def __init__(self) -> None:
        namespace, pid = Path("/proc/self/ns/pid").stat().st_ino, os.getpid()
        self._name = SessionName(namespace, pid, read_stat(pid).start_time)
        self._session: Group | None = None
        self._top = Path()
        self._is_required = False
        self._reported: set[str] = set()
        self._members: set[str] = set()
        """Names of members and nodes that have a group."""
        self._with_nodes: set[str] = set()
        """Names of members whose nodes have groups, too."""
        self._nodes: dict[int, Group] = {}
        """Groups of nodes by attempt."""

    @property
    def folder(self) -> Path | None:
        """Folder of the session's own group, with all others in it; None without groups."""
        return None if self._session is None else self._session.path

    def begin(self, policy: GroupPolicy, controllers: Iterable[str]) -> None:
        """Make the group of the session, with these controllers; raises GroupError if required."""
        if self._session is not None:
            return
        self._is_required = policy.required
        try:
            base = self._base(policy, needed := frozenset(controllers))
            sweep(base, self._name.namespace)
            session = Group(base / str(self._name))
            session.make()
            self._session = session
            self._enable(session, needed)
        except GroupError as error:
            self.end()
            if policy.required:
                raise
            self._warn(f"processes run without control groups: {error}")

    def _base(self, policy: GroupPolicy, needed: frozenset[str]) -> Path:
        mount, _ = own_hierarchy()
        if policy.base_path is None:
            base = self._top = delegated_group()
            if needed and (base / "cgroup.type").exists():  # not the root of all
                leaf = Group(base / SUPERVISOR)
                leaf.make()
                with suppress(OSError):  # enabling controllers reports it
                    for _ in range(_MOVES):
                        leaf.move_here(Group(base).residents())
            return base
        base, self._top = policy.base_path, mount
        if not base.is_relative_to(mount):
            raise GroupError(
                f"{base} is not in the hierarchy of cgroup v2, which is mounted at {mount}; "
                "fix: a base_path below that, or base_path: auto"
            )
        return base

    def member(
        self,
        full_name: str,
        limits: GroupLimits,
        *,
        has_nodes: bool = False,
        on_end: Callable[[Group], None] = lambda _: None,
    ) -> tuple[Group, str] | None:
        """Make the group of a member and the leaf of its process; None without groups.

        Returns the group, and the setting by which its process starts in it.
        """
        if self._session is None:
            return None
        group = leaf = Group(self._session.path / group_name(full_name), limits, on_end)
        group.kill()
        group.remove()  # of its predecessor
        self._make(full_name, group)
        self._with_nodes.discard(full_name)
        if has_nodes:
            self._with_nodes.add(full_name)
            leaf = Group(group.path / CONTAINER)
            self._make(full_name, leaf)
        return group, self._entry(full_name, leaf)

    def node(
        self,
        container: str,
        full_name: str,
        attempt: int,
        limits: GroupLimits,
        on_end: Callable[[Group], None] = lambda _: None,
    ) -> str | None:
        """Make the group of an isolated node; returns the setting by which it starts in it."""
        # The nodes of other containers have no processes, or were started before the groups.
        if self._session is None or container not in self._with_nodes:
            return None
        above = self._session.path / group_name(container)
        group = Group(above / f"{group_name(full_name)}.{attempt}", limits, on_end)
        self._nodes[attempt] = group
        self._make(full_name, group)
        return self._entry(full_name, group)

    def leave(self, attempt: int) -> str:
        """Kill the rest of an exited node; return why it was killed, empty if it was not."""
        group = self._nodes.pop(attempt, None)
        if group is None:
            return ""
        reason = why_killed(group)
        group.kill()
        group.retire()  # with processes still exiting, it is removed with the container's
        return reason

    def check(self, full_name: str, pid: int) -> None:
        """Report a running process that the kernel did not let into its group."""
        if self._session is None or full_name not in self._members or not pid:
            return
        if not self._session.holds(pid) and Path("/proc", str(pid)).exists():
            self._warn(
                f"{full_name} is not in its control group, so no limit holds for it: the kernel "
                f"refused the move; fix: check that {self._session.path}/cgroup.procs is writable"
            )

    def _entry(self, full_name: str, group: Group) -> str:
        self._members.add(full_name)
        return f"{'required_' if self._is_required else ''}cgroup {group.path}"

    def _make(self, full_name: str, group: Group) -> None:
        """Make a group with its limits, and the groups above it, which may have been removed."""
        try:
            group.make()
        except GroupError as error:
            self._report(f"{full_name}: {error}")
            return
        self._enable(Group(group.path.parent), group.limits.controllers())
        for problem in group.limit():
            self._report(f"{full_name}: {problem}")

    def _enable(self, group: Group, controllers: Iterable[str]) -> None:
        for problem in group.enable(controllers, top=self._top):
            self._report(problem)

    def _report(self, problem: str) -> None:
        if self._is_required:
            raise GroupError(problem)
        self._warn(problem)

    def _warn(self, problem: str) -> None:
        if problem not in self._reported:
            self._reported.add(problem)
            _log.warning("%s", problem)

    def end(self) -> None:
        """Remove the groups with the processes left in them; blocks for a moment."""
        session, self._session = self._session, None
        if session is not None and not session.clear(_END_LIMIT):
            _log.warning("the control group %s is left: its processes do not exit", session.path)


def sweep(base: Path, namespace: int) -> None:
    """Remove the groups of sessions of a PID namespace, ours, whose supervisor was killed."""
    for folder in base.iterdir() if base.is_dir() else ():
        name = SessionName.parsed(folder.name)
        if name is None or name.namespace != namespace:
            continue
        if not ProcessIdentity(name.pid, name.start_time).is_alive():
            Group(folder).clear(_END_LIMIT)

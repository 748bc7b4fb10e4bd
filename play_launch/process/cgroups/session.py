"""The groups of one session, from the first process to the last."""

from __future__ import annotations

import logging
import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

from play_launch.config.resources import NO_LIMITS
from play_launch.process.cgroups.base import (
    GroupError,
    Hierarchy,
    delegated_group,
    own_hierarchy,
)
from play_launch.process.cgroups.deaths import why_killed
from play_launch.process.cgroups.group import Group
from play_launch.process.cgroups.marks import is_ours, note_made
from play_launch.process.cgroups.names import (
    CONTAINER,
    SUPERVISOR,
    SessionName,
    group_name,
    node_group_name,
)
from play_launch.process.cgroups.refusals import no_entry, no_group
from play_launch.process.cgroups.sweep import sweep

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from play_launch.config.resources import GroupLimits, GroupPolicy

_END_LIMIT: Final = 10.0
"""Seconds for what is left of a session to die."""
_MOVES: Final = 20
"""Times to look for processes that were started while others were moved."""

_log = logging.getLogger(__name__)


class SessionGroups:
    """Makes the groups of members and nodes; there are none until `begin`.

    What the kernel refuses is logged once. Where groups are required, it raises GroupError.
    """

    def __init__(self, name: SessionName, lives: Callable[[int, int], bool]) -> None:
        """`lives`: whether a process of that pid and start time exists."""
        self._name = name
        self._lives = lives
        self._session: Group | None = None
        self._base = Path()
        self._top = Path()
        self._controllers: frozenset[str] = frozenset()
        self._is_open = False
        self._policy: GroupPolicy | None = None
        self._reported: set[str] = set()
        self._given: set[str] = set()
        """Names of members and nodes that were given one."""
        self._with_nodes: set[str] = set()
        """Names of members whose nodes have groups, too."""
        self._limits: dict[int, GroupLimits] = {}
        """Of the nodes that have a group, by their attempts."""

    @property
    def folder(self) -> Path | None:
        """Of the session's own group, with all others in it; None if processes get none."""
        return None if self._session is None else self._session.path

    def begin(self, policy: GroupPolicy, controllers: Iterable[str]) -> None:
        """Find the base, sweep it, and make the group of the session; raises GroupError.

        Args:
            policy: What the configuration says.
            controllers: What its limits need.
        """
        if self._session is not None:
            return
        self._policy = policy
        try:
            self._find(policy)
            self._open(frozenset(controllers))
        except GroupError as error:
            self.end()
            if policy.required:
                raise
            self._warn(f"processes run without control groups: {error}")

    def _find(self, policy: GroupPolicy) -> None:
        seen = own_hierarchy()
        if policy.base_path is None:
            self._base = self._top = delegated_group()
        else:
            self._base, self._top = policy.base_path, seen.mount
            _check_base(self._base, seen)
            _make_noted(self._base)
        self._is_open = True
        swept = sweep(self._base, self._name.namespace, self._lives)
        if swept:
            _log.info("removed the control groups of %d dead sessions", len(swept))
        _check_entry(self._base, seen.own)

    def _open(self, controllers: frozenset[str]) -> None:
        is_found = self._policy is not None and self._policy.base_path is None
        if is_found and controllers - Group(self._base).enabled:
            self._make_room()
        self._session = session = Group(self._base / str(self._name))
        self._controllers = controllers
        self._make_session(session)

    def _make_session(self, session: Group) -> None:
        _make_noted(self._base)  # another session may have ended meanwhile that had made it
        session.make()
        self._enable(session, self._controllers)

    def _restore(self, session: Group) -> None:
        """Make the group of the session again if it was removed."""
        if session.path.is_dir():
            return
        _log.warning("the control group %s was removed; it is made again", session.path)
        try:
            self._make_session(session)
        except GroupError as error:
            self._report(str(error))

    def _make_room(self) -> None:
        """Move the processes of our own group, which controllers do not permit, into a leaf."""
        base = Group(self._base)
        if not (self._base / "cgroup.type").exists():
            return  # the root of all groups may have them
        leaf = Group(self._base / SUPERVISOR)
        _make_noted(leaf.path)
        try:
            for _ in range(_MOVES):
                pids = base.residents()
                if not pids:
                    break
                leaf.move_here(pids)
        except OSError as error:
            raise GroupError(no_group(leaf.path, error)) from None

    def member(
        self,
        full_name: str,
        limits: GroupLimits,
        *,
        has_nodes: bool = False,
        on_end: Callable[[Group], None] = lambda _: None,
    ) -> tuple[Group, str] | None:
        """Make the group of a member and the leaf of its process; None without groups.

        Args:
            full_name: Of the member.
            limits: What is to hold in it.
            has_nodes: Whether its nodes are to have groups, too.
            on_end: Is called before it is retired.

        Returns:
            The group, and what its process asks of the kernel to be born in it.
        """
        if self._session is None:
            return None
        self._restore(self._session)
        group = Group(self._session.path / group_name(full_name), limits, on_end)
        self._given.add(full_name)
        group.kill()
        group.remove()  # of its predecessor
        self._make(full_name, group)
        if not has_nodes:
            self._with_nodes.discard(full_name)
            return group, self._entry(group)
        self._with_nodes.add(full_name)
        leaf = Group(group.path / CONTAINER)
        self._make(full_name, leaf)
        return group, self._entry(leaf)

    def node(self, container: str, full_name: str, attempt: int, limits: GroupLimits) -> str | None:
        """Make the group of a node of an isolated container; None without groups.

        Returns:
            What its process asks of the kernel to be born in it.
        """
        group = self._of_node(container, full_name, attempt, limits)
        if group is None:
            return None
        self._limits[attempt] = limits
        self._given.add(full_name)
        assert self._session is not None
        self._restore(self._session)
        self._make(full_name, group)
        return self._entry(group)

    def leave(
        self,
        container: str,
        full_name: str,
        attempt: int,
        on_end: Callable[[Group], None] = lambda _: None,
    ) -> str:
        """Kill the rest of an exited node; return why it was killed, empty if it was not."""
        group = self._of_node(container, full_name, attempt, self._limits.pop(attempt, NO_LIMITS))
        if group is None or not group.path.is_dir():
            return ""
        reason = why_killed(group)
        group.kill()
        on_end(group)
        group.remove()  # with processes still exiting, it is removed with the container's
        return reason

    def check(self, full_name: str, pid: int) -> None:
        """Report a process that runs although the kernel did not let it into its group."""
        if self._session is None or full_name not in self._given or not pid:
            return
        if not self._session.holds(pid) and Path("/proc", str(pid)).exists():
            self._warn(
                f"{full_name} is not in its control group, so no limit holds for it: the kernel "
                f"refused the move; fix: see what echo 0 > {self._session.path}/cgroup.procs says"
            )

    def _of_node(
        self, container: str, full_name: str, attempt: int, limits: GroupLimits
    ) -> Group | None:
        if self._session is None:
            return None
        # It may be no isolated one, or have been started before there were groups.
        if container not in self._with_nodes:
            return None
        above = self._session.path / group_name(container)
        return Group(above / node_group_name(full_name, attempt), limits)

    def _entry(self, group: Group) -> str:
        is_required = self._policy is not None and self._policy.required
        return f"{'required_' if is_required else ''}cgroup {group.path}"

    def _make(self, full_name: str, group: Group) -> None:
        above = Group(group.path.parent)
        try:
            above.make()  # that of a container may have been removed
            self._enable(above, group.limits.controllers())
            group.make()
        except GroupError as error:
            self._report(f"{full_name}: {error}")
            return
        for problem in group.limit():
            self._report(f"{full_name}: {problem}")

    def _enable(self, group: Group, controllers: Iterable[str]) -> None:
        for problem in group.enable(controllers, top=self._top):
            self._report(problem)

    def _report(self, problem: str) -> None:
        if self._policy is not None and self._policy.required:
            raise GroupError(problem)
        self._warn(problem)

    def _warn(self, problem: str) -> None:
        if problem not in self._reported:
            self._reported.add(problem)
            _log.warning("%s", problem)

    def end(self) -> None:
        """Remove the groups with whatever is left in them; blocks for a moment."""
        session, self._session = self._session, None
        if session is not None and not session.clear(_END_LIMIT):
            _log.warning("the control group %s is left: its processes do not die", session.path)
        if self._is_open:
            self._is_open = False
            self._leave_as_found()

    def _leave_as_found(self) -> None:
        """Undo what was done to the base, unless another session needs it."""
        base = Group(self._base)
        try:
            names = [each.name for each in self._base.iterdir() if each.is_dir()]
        except OSError:
            return
        if any(SessionName.parsed(name) for name in names):
            return
        base.disable_ours()
        leaf = Group(self._base / SUPERVISOR)
        if is_ours(leaf.path) and not base.enabled:
            with suppress(OSError):
                base.move_here(leaf.processes())
            leaf.remove()
        for folder in (self._base, *self._base.parents):
            if not is_ours(folder):
                break
            with suppress(OSError):  # in use
                folder.rmdir()


def needed_controllers(limits: Iterable[GroupLimits]) -> frozenset[str]:
    """Name the controllers that these limits need."""
    return frozenset().union(*(each.controllers() for each in limits))


def _check_base(base: Path, seen: Hierarchy) -> None:
    if not base.is_relative_to(seen.mount):
        raise GroupError(
            f"{base} is not in the hierarchy of cgroup v2, which is mounted at {seen.mount}; "
            "fix: a base_path below that, or base_path: auto"
        )


def _make_noted(group: Path) -> None:
    """Make a group and those above it, each with a note that it is ours; raises GroupError."""
    missing = [each for each in (group, *group.parents) if not each.exists()]
    try:
        group.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise GroupError(no_group(group, error)) from None
    for each in missing:
        note_made(each)


def _check_entry(base: Path, own: Path) -> None:
    """See to it that processes of ours may enter groups below the base; raises GroupError.

    The kernel asks for write access to the nearest group above both where they are and where they
    are to go.
    """
    above = Path(os.path.commonpath([base, own]))
    if not os.access(above / "cgroup.procs", os.W_OK):
        raise GroupError(no_entry(base, above))

"""Control groups for the members and nodes of a configuration."""

from __future__ import annotations

import logging
import time
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING

from play_launch.config.model import ContainerConfig
from play_launch.process.cgroups.group import Group, GroupError
from play_launch.process.cgroups.session import SessionGroups
from play_launch.process.cgroups.usage import usage_of
from play_launch.runtime.commands import StartError
from play_launch.supervisor.events import SubjectKind

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from play_launch.config.model import ComposableNodeConfig, ProcessConfig, ReplayConfig
    from play_launch.config.resources import GroupLimits
    from play_launch.process.guard import SessionGuard
    from play_launch.supervisor.events import GroupSample

_log = logging.getLogger(__name__)


class Groups:
    """Makes and removes the control groups of the session, and logs what was refused."""

    def __init__(self, publish: Callable[[GroupSample], None]) -> None:
        """Be the groups of the session of this process; there are none yet.

        ``publish`` takes the last numbers of each.
        """
        self._publish = publish
        self._groups = SessionGroups()
        self._entrusted: tuple[SessionGuard, int] | None = None

    def entrust(self, guard: SessionGuard) -> None:
        """Have the guard remove them if the supervisor dies; once for each guard and group."""
        folder = self._groups.folder
        if folder is None:
            return
        entrusted = guard, Group(folder).number  # it may have been removed, and made anew
        if entrusted != self._entrusted:
            self._entrusted = entrusted
            with suppress(OSError):  # removed by another process
                guard.entrust(folder)

    def begin(self, config: ReplayConfig) -> None:
        """Have groups, if the configuration asks for any; raises GroupError where it has to."""
        if wants_groups(config):
            controllers = (each.controllers() for each in group_limits(config))
            self._groups.begin(config.cgroups, frozenset().union(*controllers))

    def of_container(self, config: ContainerConfig) -> tuple[Group | None, tuple[str, ...]]:
        """Make that of a container; gives it and what its process asks for. Raises StartError."""
        has_nodes = config.container_type.is_isolated
        return self._member(config, has_nodes=has_nodes)

    def of_process(self, config: ProcessConfig) -> tuple[Group | None, tuple[str, ...]]:
        """Make that of a process, likewise."""
        return self._member(config, has_nodes=False)

    def _member(
        self, config: ContainerConfig | ProcessConfig, *, has_nodes: bool
    ) -> tuple[Group | None, tuple[str, ...]]:
        is_container = isinstance(config, ContainerConfig)
        kind = SubjectKind.CONTAINER if is_container else SubjectKind.PROCESS
        name = config.full_name
        used = partial(self._used, kind, name)
        limits = config.resources.group
        try:
            made = self._groups.member(name, limits, has_nodes=has_nodes, on_end=used)
        except GroupError as error:
            raise StartError(str(error), permanent=True) from error
        return (None, ()) if made is None else (made[0], (made[1],))

    def enter(self, config: ComposableNodeConfig, attempt: int) -> tuple[str, ...]:
        """Make that of a node; gives what its process asks for. Raises StartError."""
        key = config.key
        used = partial(self._used, SubjectKind.NODE, str(key))
        limits = config.resources.group
        try:
            entry = self._groups.node(key.container, key.name, attempt, limits, used)
        except GroupError as error:
            raise StartError(str(error), permanent=True) from error
        return () if entry is None else (entry,)

    def leave(self, attempt: int) -> str:
        """Kill the rest of an exited node; return why it was killed, empty if it was not."""
        return self._groups.leave(attempt)

    def _used(self, kind: SubjectKind, key: str, group: Group) -> None:
        """Report what a group used all in all."""
        usage = usage_of(group)
        _log.info("the control group %s used %s", group.path.name, usage)
        self._publish(usage.sample(time.time_ns(), kind, key, group.number))

    def check(self, full_name: str, pid: int) -> None:
        """Report a process that is not in the group that was made for it; it runs on."""
        self._groups.check(full_name, pid)

    def end(self) -> None:
        """Remove them all, with what is left in them; blocks for a moment."""
        self._groups.end()


def group_limits(config: ReplayConfig) -> Iterator[GroupLimits]:
    """Give what control groups are to limit, of all that is started here."""
    for container in config.containers:
        yield container.resources.group
        yield from (node.resources.group for node in container.composable_nodes)
    yield from (process.resources.group for process in config.nodes)


def wants_groups(config: ReplayConfig) -> bool:
    """Whether processes are to have control groups."""
    if config.cgroups.enabled is not None:
        return config.cgroups.enabled
    return any(group_limits(config))

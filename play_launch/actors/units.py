"""The units of a system: how conditions about them stand, and what they wait for."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from play_launch.core.dependency import Condition
from play_launch.core.events import ContainerState, ProcessEvent, ProcessEventKind
from play_launch.core.node_key import NodeKey
from play_launch.core.order import Look, Standing
from play_launch.core.outlook import (
    HOLDS,
    OPEN,
    MemberFacts,
    of_all_nodes,
    of_member,
    of_node,
    of_what_it_does,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.actors.members import Members
    from play_launch.actors.publisher import Publisher
    from play_launch.core.dependency import Dependency
    from play_launch.core.outlook import NodeFacts


class Units:
    """Belongs to the thread of the event loop."""

    def __init__(
        self,
        members: Members,
        publisher: Publisher,
        holds_outside: Callable[[Dependency], bool],
        look_at_managed: Callable[[str], Look],
    ) -> None:
        """Take the members, which may come and go, and what knows the rest."""
        self._look_at_managed = look_at_managed
        self._members = members
        self._publisher = publisher
        self._holds_outside = holds_outside

    def look(self, dependency: Dependency) -> Look:
        """Say how a condition stands."""
        condition, unit = dependency.condition, dependency.unit
        if not unit:
            return HOLDS if self._holds_outside(dependency) else OPEN
        if condition is Condition.ACTIVE:
            managed = self._look_at_managed(unit)
            if managed.standing is not Standing.OPEN:
                return managed
        if unit not in self._members.names:
            return self._look_at_node(dependency)
        member = self._member(unit)
        if condition in {Condition.STARTED, Condition.EXITED}:
            return of_member(condition, member)
        if unit in self._members.containers and condition is Condition.LOADED:
            nodes = self._members.containers[unit].nodes
            return of_all_nodes({each.name: self._node(each) for each in nodes}, member)
        return of_what_it_does(self._holds_outside(dependency), member)

    def report_wait(self, unit: str, text: str) -> None:
        """Publish what a unit waits for."""
        if unit in self._members.containers:
            self._publisher.publish_container(unit, ContainerState.STARTING, text, "")
        elif unit in self._members.processes:
            self._publisher.publish(
                ProcessEvent(
                    stamp_ns=self._publisher.stamp_ns(),
                    kind=ProcessEventKind.WAITING,
                    name=unit,
                    message=text,
                )
            )
        else:
            key = NodeKey.parsed(unit)
            container = self._members.containers[key.container]
            container.deliver(partial(container.nodes.report_wait, key, text))

    def _look_at_node(self, dependency: Dependency) -> Look:
        key = NodeKey.parsed(dependency.unit) if ":/" in dependency.unit else None
        there = None if key is None else self._members.containers.get(key.container)
        if key is None or there is None or key not in there.nodes:
            return Look(Standing.NEVER, "it is not in the configuration any more")
        container = self._member(key.container)
        if dependency.condition is Condition.ACTIVE:
            look = of_node(Condition.LOADED, self._node(key), container)
            return OPEN if look.standing is Standing.HOLDS else look
        return of_node(dependency.condition, self._node(key), container)

    def _member(self, name: str) -> MemberFacts:
        member, view = self._members[name], self._publisher.view
        if name in self._members.containers:
            container = view.containers[name]
            return MemberFacts(
                member.state, member.wanted, member.is_at_rest, reason=container.reason
            )
        process = view.processes.get(name)
        reason = process.message if process is not None else ""
        return MemberFacts(member.state, member.wanted, member.is_at_rest, process, reason)

    def _node(self, key: NodeKey) -> NodeFacts:
        reason = self._publisher.view.containers[key.container].nodes[key].reason
        return self._members.containers[key.container].nodes.facts(key, reason)

"""The machines of a system, and the part of each.

A part is the configuration without what runs elsewhere. Conditions on units elsewhere stay in it:
their machine is in them, and the coordinator reports when they are met.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from msgspec.structs import replace

from play_launch.config.dependency import (
    ABOUT_GRAPH,
    Condition,
    Dependency,
    DependencyGraph,
    StartRule,
)
from play_launch.config.model import DiscoveryBy, MachineConfig
from play_launch.config.problems import excerpt
from play_launch.config.section import validate_mapping
from play_launch.config.sections import MachineSection
from play_launch.config.source import path_from
from play_launch.config.text import similar
from play_launch.config.tree import Mapping as MappingNode
from play_launch.config.values import resolve_environment

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.config.model import ContainerConfig, ProcessConfig, ReplayConfig
    from play_launch.config.tree import Cursor

AWAITED_ELSEWHERE: Final = "(other machines)"
"""Key in the start rules of a part: the conditions that units on other machines wait for."""
_REMOTE_KEYS: Final = (
    "ssh",
    "setup",
    "play_launch",
    "service",
    "connect_timeout",
    "lost_after",
    "on_lost",
    "copy",
    "max_clock_offset",
)
_MOST_PROCESSES: Final = 32
"""Participants of a machine that peers of Fast DDS find; further ones are never found."""


def machines_at(at: Cursor | None) -> dict[str, MachineConfig]:
    """Return the machines that stand there; mistakes are reported."""
    found: dict[str, MachineConfig] = {}
    if at is None:
        return found
    if not isinstance(at.node, MappingNode):
        at.expected("a mapping of names of machines to their keys")
        return found
    for entry, value in at.entries():
        section = validate_mapping(MachineSection, value)
        variables = resolve_environment(value.value("environment"))
        if not (entry.key.isascii() and entry.key.isidentifier()):
            message = "a machine is named by letters, digits and _, not beginning with a digit"
            value.problem(message, entry.location)
        elif section is not None:
            found[entry.key] = _machine(entry.key, section, value, variables)
    local = [each.name for each in found.values() if each.local]
    if len(local) > 1:
        at.below(local[1]).problem(f"only one machine is local, and {local[0]} is")
    return found


def _machine(
    name: str, section: MachineSection, at: Cursor, variables: dict[str, str]
) -> MachineConfig:
    given: dict[str, Any] = {
        key: tuple(each) if isinstance(each, list) else each
        for key, each in section.given.items()
        if key in MachineConfig.__struct_fields__
    }
    if section.local:
        for key in _REMOTE_KEYS:
            if at.value(key) is not None:
                at.at_key(key).problem("is for machines that ssh reaches, not for the local one")
    if section.on_lost is not None and section.on_lost.stop_after is not None:
        given["stop_after"] = section.on_lost.stop_after
    at_copy = at.at_key("copy")
    given["copy"] = tuple(path_from(at_copy, each).absolute() for each in section.copy or ())
    given["environment"] = MappingProxyType(variables)
    return MachineConfig(name=name, **given)


class Placement:
    """Says on which machine each container and process runs."""

    def __init__(
        self, at_document: Cursor, machines: dict[str, MachineConfig], default: str | None
    ) -> None:
        self._at = at_document
        self._machines = machines
        self._default = next((name for name, each in machines.items() if each.local), "")
        if default is not None and self._known(default, at_document.at_key("machine")):
            self._default = default

    def environment(self, machine: str) -> Mapping[str, str]:
        """Return the variables of a machine."""
        known = self._machines.get(machine)
        return {} if known is None else known.environment

    def place(self, at: Cursor, machine: str | None) -> str:
        """Return the machine of an entry; one that cannot be known is reported."""
        if machine is not None:
            return machine if self._known(machine, at.at_key("machine")) else ""
        if self._machines and not self._default:
            at.problem(
                "the key machine is missing, because no machine is local; give it here or at the "
                f"top level: one of {', '.join(self._machines)}"
            )
        return self._default

    def _known(self, machine: str, at: Cursor) -> bool:
        if machine in self._machines:
            return True
        if not self._machines:
            at.problem(f"there is no machine {excerpt(machine)}; declare it in machines")
            return False
        close = similar(machine, list(self._machines))
        fix = f"did you mean {close}?" if close else f"declared are {', '.join(self._machines)}"
        at.problem(f"there is no machine {excerpt(machine)}; {fix}")
        return False


def part_of(config: ReplayConfig, machine: str) -> ReplayConfig:
    """Return the part of a machine; raises KeyError when there is no such machine."""
    own = config.machines[machine]
    places = _places(config)
    containers = tuple(each for each in config.containers if each.machine == machine)
    nodes = tuple(each for each in config.nodes if each.machine == machine)
    rules: dict[str, StartRule] = {}
    awaited: dict[Dependency, None] = {}
    for unit, rule in config.start_rules.items():
        dependencies = [_seen_from(places[unit], each, places) for each in rule.dependencies]
        if places[unit] == machine:
            rules[unit] = StartRule(dependencies=tuple(dependencies), delay=rule.delay)
        awaited |= {
            asked(each): None
            for each in dependencies
            if each.machine == machine and each.condition not in ABOUT_GRAPH
        }
    if awaited:
        rules[AWAITED_ELSEWHERE] = StartRule(dependencies=tuple(awaited))
    managed = {unit: each for unit, each in config.managed.items() if places.get(unit) == machine}
    return replace(
        config,
        machine=machine,
        containers=containers,
        nodes=nodes,
        environment=MappingProxyType({**config.environment, **own.environment}),
        start_rules=MappingProxyType(rules),
        managed=MappingProxyType(managed),
    )


def asked(dependency: Dependency) -> Dependency:
    """Return the bare condition: what the machine of its unit is asked for."""
    return Dependency(
        condition=dependency.condition, unit=dependency.unit, subject=dependency.subject
    )


def stopped_after(config: ReplayConfig) -> dict[str, frozenset[str]]:
    """Name for each machine those that are stopped before it, because they depend on it."""
    places = _places(config)
    rules = {}
    for machine in config.machines:
        rules[machine] = StartRule(
            dependencies=tuple(
                Dependency(condition=Condition.STARTED, unit=places[each.unit])
                for unit, rule in config.start_rules.items()
                if places.get(unit) == machine
                for each in rule.dependencies
                if each.unit in places and places[each.unit] != machine
            )
        )
    return DependencyGraph(rules, dict.fromkeys(config.machines, ())).stopped_after()


def used_machines(config: ReplayConfig) -> list[str]:
    """Name the machines that run anything."""
    used = {each.machine for each in config.members}
    return [name for name in config.machines if name in used]


def discovery_problems(config: ReplayConfig, environ: Mapping[str, str]) -> list[str]:
    """List, with their fixes, settings with which nodes of two machines do not find each other.

    None of them leads to an error of ROS.
    """
    parts = [part_of(config, name) for name in used_machines(config)]
    if len(parts) < 2:
        return []
    found = []
    for part in parts:
        variables = dict(part.environment)
        if config.machines[part.machine].local:
            variables = {**environ, **variables}
        if variables.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() in {"LOCALHOST", "OFF"} and (
            config.discovery is DiscoveryBy.MULTICAST
        ):
            value = variables["ROS_AUTOMATIC_DISCOVERY_RANGE"]
            found.append(
                f"{part.machine}: ROS_AUTOMATIC_DISCOVERY_RANGE is {value}, so its nodes find none "
                "of other machines; set SUBNET in environment, or discovery: {by: peers}"
            )
        processes = len(part.members)
        if config.discovery is DiscoveryBy.PEERS and processes > _MOST_PROCESSES:
            found.append(
                f"{part.machine}: it has {processes} processes, and peers find the first "
                f"{_MOST_PROCESSES} of a machine only; use discovery: {{by: multicast}}"
            )
    domains = {part.environment.get("ROS_DOMAIN_ID", "") for part in parts}
    if len(domains) > 1:
        found.append(
            "the machines have different ROS_DOMAIN_IDs, so their nodes do not find each other; "
            "set one for all in environment of the configuration"
        )
    return found


def _places(config: ReplayConfig) -> dict[str, str]:
    """Return the machine of each unit."""
    members: dict[str, ContainerConfig | ProcessConfig] = {
        each.full_name: each for each in config.members
    }
    return {
        unit: members[name].machine
        for name, nodes in config.units.items()
        for unit in (name, *nodes)
    }


def _seen_from(machine: str, dependency: Dependency, places: dict[str, str]) -> Dependency:
    """Return a dependency as a unit of a machine has it."""
    place = places.get(dependency.unit, machine)
    return dependency if place == machine else replace(dependency, machine=place)

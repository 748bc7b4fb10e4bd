"""The machines of a system, and the part of each.

A part is the configuration without what runs elsewhere. Conditions on units elsewhere stay in it:
their machine is in them, and the coordinator reports when they are met.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping  # noqa: TC003 - msgspec reads annotations
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from play_launch.config.dependency import (
    ABOUT_GRAPH,
    Condition,
    Dependency,
    DependencyGraph,
    StartRule,
)

if TYPE_CHECKING:
    from play_launch.config.model import ContainerConfig, ProcessConfig, ReplayConfig

AWAITED_ELSEWHERE: Final = "(other machines)"
"""Key in the start rules of a part: the conditions that units on other machines wait for."""
PARTS: Final = ".cache/play-launch/parts"
"""Below the home folder of a machine: copies of its part, each in a folder named by its content."""
_LOGS: Final = ".cache/play-launch/logs"
"""The same, for what is recorded: copies are removed after a while."""
_COPY: Final = re.compile(rf"/{re.escape(PARTS)}/([^/]+)-[0-9a-f]{{16}}/files/")
_MOST_PROCESSES: Final = 32
"""Participants of a machine that peers of Fast DDS find; further ones are never found."""


class Service(StrEnum):
    """What keeps a session running on another machine: systemd's manager, or nothing."""

    USER = "user"
    SYSTEM = "system"
    NONE = "none"


class MachineConfig(Struct, frozen=True, kw_only=True):
    """A computer that runs a part of the system: this one, or one that ssh reaches.

    `setup` are files that bash sources there, `copy` are absolute paths of files and folders here,
    times are seconds. Without the coordinator it stops itself after `stop_after`.
    """

    name: str
    local: bool = False
    ssh: str = ""
    setup: tuple[str, ...] = ()
    play_launch: str = "play-launch"
    environment: Mapping[str, str] = MappingProxyType({})
    service: Service = Service.USER
    connect_timeout: float = 10.0
    lost_after: float = 4.0
    stop_after: float = math.inf
    optional: bool = False
    copy: tuple[Path, ...] = ()
    max_clock_offset: float = 0.02


class DiscoveryBy(StrEnum):
    """How nodes of several machines find each other: by multicast, or by listed addresses."""

    MULTICAST = "multicast"
    PEERS = "peers"


def part_of(config: ReplayConfig, machine: str) -> ReplayConfig:
    """Return the part of a machine; raises KeyError when there is no such machine."""
    own = config.machines[machine]
    places = _places(config)
    containers = tuple(each for each in config.containers if each.machine == machine)
    nodes = tuple(each for each in config.nodes if each.machine == machine)
    rules: dict[str, StartRule] = {}
    awaited: dict[Dependency, None] = {}
    for unit, rule in config.start_rules.items():
        dependencies = [
            _seen_from(places[unit], each, places, config) for each in rule.dependencies
        ]
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
        web=None,
        containers=containers,
        nodes=nodes,
        environment=MappingProxyType({**config.environment, **own.environment}),
        start_rules=MappingProxyType(rules),
        managed=MappingProxyType(managed),
        expect=MappingProxyType(
            {topic: each for topic, each in config.expect.items() if each.machine == machine}
        ),
    )


def in_any_copy(value: object) -> str:
    """Describe a value of a part so that it is the same whichever copy of the part it is from."""
    return _COPY.sub(r"/\1/", repr(value))


def outside_copies(folder: Path) -> Path:
    """Give the place of a folder for recordings that the configuration has beside itself."""
    return Path(_COPY.sub(rf"/{_LOGS}/\1/", str(folder)))


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


def discovery_problems(
    config: ReplayConfig, environs: Mapping[str, Mapping[str, str]]
) -> list[str]:
    """List, with their fixes, settings with which nodes of two machines do not find each other.

    None of them leads to an error of ROS. `environs` are the environments of machines, as far as
    they are known, without that of the configuration.
    """
    parts = [part_of(config, name) for name in used_machines(config)]
    if len(parts) < 2:
        return []
    found = []
    domains = set()
    for part in parts:
        variables = {**environs.get(part.machine, {}), **part.environment}
        domains.add(variables.get("ROS_DOMAIN_ID") or "0")
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


def _seen_from(
    machine: str, dependency: Dependency, places: dict[str, str], config: ReplayConfig
) -> Dependency:
    """Return a dependency as a unit of a machine has it."""
    place = places.get(dependency.unit, machine)
    if dependency.condition is Condition.EXPECT:
        place = config.expect[dependency.subject].machine
    return dependency if place == machine else replace(dependency, machine=place)

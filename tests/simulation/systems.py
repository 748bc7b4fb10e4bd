"""Random configurations: containers, nodes, processes, dependencies, managed nodes."""

from __future__ import annotations

import random
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from msgspec.structs import replace

from play_launch.config.dependency import (
    Condition,
    Dependency,
    DependencyGraph,
    OnTimeout,
    StartRule,
)
from play_launch.config.model import (
    Autostart,
    ComposableNodeConfig,
    ContainerConfig,
    ContainerType,
    ManagedConfig,
    OnCrash,
    OnExit,
    ParameterConfig,
    ParameterType,
    ParameterValue,
    ProcessConfig,
    ReplayConfig,
    RestartLimits,
)
from play_launch.config.node_key import NodeKey

if TYPE_CHECKING:
    from collections.abc import Container

FILES = ("/calibration", "/map")
TOPICS = ("/scan", "/tf")
FAR = ("/far", "/farther")
"""Units of another machine."""
GOALS = (*Autostart, None)
FAR_KINDS = (Condition.STARTED, Condition.LOADED, Condition.ACTIVE, Condition.EXITED)


def restart(chance: random.Random) -> RestartLimits:
    return RestartLimits(
        max_restarts=chance.choice((0, 1, 3, 5)),
        within=chance.choice((5.0, 60.0)),
        initial=chance.choice((0.0, 0.1, 1.0)),
        maximum=10.0,
    )


def node(chance: random.Random, container: str, name: str) -> ComposableNodeConfig:
    return ComposableNodeConfig(
        package="demo",
        plugin="demo::Node",
        name=name,
        namespace="/",
        key=NodeKey(container, f"/{name}"),
        on_crash=chance.choice((OnCrash.RELOAD, OnCrash.RELOAD, OnCrash.RELOAD, *OnCrash)),
        restart=restart(chance),
    )


def container(chance: random.Random, name: str) -> ContainerConfig:
    full_name, attach = f"/{name}", chance.random() < 0.1
    kinds = (ContainerType.ISOLATED, ContainerType.ISOLATED, ContainerType.STOCK)
    return ContainerConfig(
        name=name,
        namespace="/",
        full_name=full_name,
        container_type=ContainerType.STOCK if attach else chance.choice(kinds),
        attach=attach,
        restart=restart(chance),
        on_exit=OnExit.SHUTDOWN if chance.random() < 0.05 else OnExit.RESTART,
        loading_timeout=chance.choice((5.0, 10.0)),
        composable_nodes=tuple(
            node(chance, full_name, f"{name}{index}") for index in range(chance.randrange(7))
        ),
    )


def process(chance: random.Random, name: str) -> ProcessConfig:
    shuts_down = chance.random() < 0.05
    return ProcessConfig(
        name=name,
        namespace="/",
        full_name=f"/{name}",
        command=(name,),
        on_exit=OnExit.SHUTDOWN if shuts_down else chance.choice((OnExit.IGNORE, OnExit.RESTART)),
        restart=restart(chance),
    )


def rule(
    chance: random.Random, others: list[str], managed: Container[str], containers: Container[str]
) -> StartRule:
    found = []
    for _ in range(chance.randrange(1, 3)):
        unit = chance.choice([*others, *FAR])
        is_far = unit in FAR
        timeout = chance.choice((float("inf"), 3.0, 20.0))
        on_timeout = chance.choice(list(OnTimeout))
        kinds = [*FAR_KINDS] if is_far else [Condition.FILE, Condition.TOPIC]
        if unit in managed:
            kinds += [Condition.ACTIVE]
        if ":" in unit:
            kinds += [Condition.LOADED]
        elif unit in containers:
            kinds += [Condition.STARTED, Condition.LOADED]
        elif unit and not is_far:
            kinds += [Condition.STARTED, Condition.LOG, Condition.EXITED]
        kind = chance.choice(kinds)
        subject = {
            Condition.FILE: chance.choice(FILES),
            Condition.TOPIC: chance.choice(TOPICS),
            Condition.LOG: "ready",
        }.get(kind, "")
        is_outside = kind in {Condition.FILE, Condition.TOPIC}
        found.append(
            Dependency(
                condition=kind,
                unit="" if is_outside else unit,
                subject=subject,
                timeout=timeout,
                on_timeout=on_timeout,
                machine="another" if is_far else "",
            )
        )
    return StartRule(dependencies=tuple(found), delay=chance.choice((0.0, 0.0, 2.0)))


def system(chance: random.Random) -> ReplayConfig:
    """Make a configuration whose dependencies have no cycle."""
    containers = tuple(container(chance, f"c{index}") for index in range(chance.randrange(5)))
    processes = tuple(process(chance, f"p{index}") for index in range(chance.randrange(5)))
    if not containers and not processes:
        processes = (process(chance, "p0"),)
    config = ReplayConfig(
        name="simulated",
        source=Path("simulated.yaml"),
        text=b"",
        containers=containers,
        nodes=processes,
    )
    units = [unit for name, nodes in config.units.items() for unit in (name, *nodes)]
    boxes = {each.full_name for each in containers}
    managed = {
        unit: ManagedConfig(
            name=unit.rpartition(":")[2], autostart=chance.choice(GOALS), timeout=5.0
        )
        for unit in units
        if chance.random() < 0.15 and unit not in boxes
    }
    rules: dict[str, StartRule] = {}
    for index, unit in enumerate(units):
        if chance.random() < 0.3:
            tried = {**rules, unit: rule(chance, units[:index], managed, boxes)}
            if not DependencyGraph(tried, config.units).cycles():
                rules = tried
    return replace(config, start_rules=MappingProxyType(rules), managed=MappingProxyType(managed))


def changed_node(chance: random.Random, node: ComposableNodeConfig) -> ComposableNodeConfig:
    how = chance.random()
    if how < 0.15:
        return replace(node, log_level=chance.choice(("warn", "info")))
    if how < 0.3:
        value = ParameterValue(ParameterType.INTEGER, chance.randrange(3))
        return replace(node, parameters=(ParameterConfig("rate", value),))
    if how < 0.35:
        return replace(node, on_crash=chance.choice(list(OnCrash)))
    return node


def changed(chance: random.Random, config: ReplayConfig) -> ReplayConfig:
    """Make a configuration that differs here and there."""
    containers = [each for each in config.containers if chance.random() < 0.9]
    processes = [each for each in config.nodes if chance.random() < 0.9]
    containers = [
        replace(
            each,
            log_level="debug" if chance.random() < 0.2 else each.log_level,
            composable_nodes=tuple(
                changed_node(chance, one) for one in each.composable_nodes if chance.random() < 0.9
            ),
        )
        for each in containers
    ]
    processes = [
        replace(each, log_level="debug") if chance.random() < 0.3 else each for each in processes
    ]
    name = f"n{chance.randrange(3)}"
    if chance.random() < 0.3 and all(each.full_name != f"/{name}" for each in processes):
        processes.append(process(chance, name))
    target = replace(config, containers=tuple(containers), nodes=tuple(processes))
    left = {unit for member, nodes in target.units.items() for unit in (member, *nodes)}
    rules = {
        unit: each
        for unit, each in config.start_rules.items()
        if unit in left and all(one.unit in {*left, "", *FAR} for one in each.dependencies)
    }
    managed = {
        unit: replace(each, autostart=chance.choice(GOALS)) if chance.random() < 0.1 else each
        for unit, each in config.managed.items()
        if unit in left
    }
    return replace(target, start_rules=MappingProxyType(rules), managed=MappingProxyType(managed))

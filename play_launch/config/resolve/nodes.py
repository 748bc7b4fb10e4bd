"""Containers, composable nodes and ordinary processes, and their names."""

from __future__ import annotations

import re
from collections import Counter
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct
from msgspec.structs import replace

from play_launch.config.model import (
    ComposableNodeConfig,
    ContainerConfig,
    ContainerType,
    OnExit,
    ProcessConfig,
    RestartLimits,
)
from play_launch.config.node_key import NodeKey
from play_launch.config.problems import excerpt
from play_launch.config.resolve.parameter_files import resolve_process_parameters
from play_launch.config.resolve.parameters import resolve_parameters
from play_launch.config.resolve.policy import (
    ISOLATED_KEYS,
    ProcessKind,
    refined_resources,
    refined_restart,
    refuse,
    refuse_inherited,
    refuse_unread,
)
from play_launch.config.resources import NO_RESOURCES
from play_launch.config.schema import ComposableNodeSection, ContainerSection, ProcessSection
from play_launch.config.section import items_of, validate_mapping
from play_launch.config.source import path_from
from play_launch.config.tree import Mapping, Sequence, describe_node
from play_launch.config.values import (
    LONGEST_FULL_NAME,
    check_namespace,
    check_node_name,
    check_topic,
    join_full_name,
    resolve_environment,
)

if TYPE_CHECKING:
    from collections.abc import Iterator
    from collections.abc import Mapping as Variables

    from play_launch.config.problems import Location
    from play_launch.config.resolve.expectations import ExpectedTopics
    from play_launch.config.resolve.machines import Placement
    from play_launch.config.resolve.order import StartRules
    from play_launch.config.resolve.parameter_files import ParameterFileReader
    from play_launch.config.resolve.policy import GroupRules, Policy
    from play_launch.config.section import ConfigSection
    from play_launch.config.tree import Cursor, Node

_COMMAND_OR_PACKAGE: Final = "give either command, or package and executable"
_NUMBERED: Final = re.compile(r":[0-9]+$")
_ISOLATED_NODE_KEYS: Final = ("auto_reload_on_crash", "on_crash", "restart", "resources")
_STOCK_PROGRAM: Final = {"package": "rclcpp_components", "executable": "component_container"}
_STOCK_KEYS: Final = (*_STOCK_PROGRAM, "arguments", "attach")
_START_KEYS: Final = (
    *_STOCK_PROGRAM,
    "arguments",
    "environment",
    "log_level",
    "ros_arguments",
    "process_parameters",
    "prefix",
    "cwd",
    "output",
    "on_exit",
    "resources",
)
"""Keys about starting a container; one that is attached to reads none of them."""
_REMAPPING: Final = (
    'expected a remapping such as "chatter:=/sensing/chatter" or {from: chatter, to: /chatter}'
)
_NOT_REMAPPED: Final = {"__node": "name", "__name": "name", "__ns": "namespace"}


class NodeNames:
    """Names of nodes, each once, and labels for nodes without a name.

    ROS lets two nodes share a name, and both then misbehave.
    """

    def __init__(self) -> None:
        self._locations: dict[str, Location] = {}
        self._labels: Counter[tuple[str, str]] = Counter()

    def __contains__(self, full_name: str) -> bool:
        return full_name in self._locations

    def declare(self, at: Cursor) -> str | None:
        """Return the full name that a node gives, None if it gives none; report a second owner.

        Reads the tree, so that two equal names are found even where other keys are wrong.
        """
        at_name = at.value("name")
        at_namespace = at.value("namespace")
        namespace = "/" if at_namespace is None else at_namespace.string
        if at_name is None or not at_name.string or not namespace:
            return None
        try:
            full_name = join_full_name(check_namespace(namespace), check_node_name(at_name.string))
        except ValueError:
            return None
        if len(full_name) > LONGEST_FULL_NAME:
            at_name.problem(
                f"namespace and name have {len(full_name)} characters; at most "
                f"{LONGEST_FULL_NAME}, because the names of the node's services are longer"
            )
        first = self._locations.setdefault(full_name, at_name.node.location)
        if first is not at_name.node.location:
            at_name.problem(f"the name {full_name} is given twice, first at {first}")
        return full_name

    def label(self, container: str, namespace: str, what: str) -> str:
        """Return a label for an unnamed node, `/[what]`, unique in its container.

        The second of its kind is `/[what:2]`, and so on; what is declared of another kind, or in
        another container, does not change it. `container` is empty for ordinary processes.
        """
        base = join_full_name(namespace or "/", what)
        self._labels[container, base] += 1
        count = self._labels[container, base]
        # What looks like such a number gets one, too: a program can be called `talker:2`.
        suffix = "" if count == 1 and not _NUMBERED.search(what) else f":{count}"
        return join_full_name(namespace or "/", f"[{what}{suffix}]")


class SharedContext(Struct, frozen=True):
    """What all nodes of one configuration share."""

    files: ParameterFileReader
    environment: Variables[str, str]
    start_rules: StartRules
    names: NodeNames
    groups: GroupRules
    placement: Placement
    expected: ExpectedTopics
    machine: str = ""
    """Where what is being read runs."""


def _own(section: ConfigSection, config: type[Struct], at: Cursor) -> dict[str, Any]:
    """Return the given keys that the model has, too, and the location."""
    given: dict[str, Any] = {"file": at.node.location.file, "line": at.node.location.line}
    for key, value in section.given.items():
        if key in config.__struct_fields__:
            given[key] = tuple(value) if isinstance(value, list) else value
    if "cwd" in given:
        given["cwd"] = path_from(at.at_key("cwd"), given["cwd"])
    return given


def resolve_container(at: Cursor, shared: SharedContext, policy: Policy) -> ContainerConfig | None:
    """Return the container at `at`, None after problems; `policy` is that of all containers."""
    section = validate_mapping(ContainerSection, at)
    if not isinstance(at.node, Mapping):
        return None
    shared.names.declare(at)
    own_variables = resolve_environment(at.value("environment"))
    sections = resolve_process_parameters(at.value("process_parameters"), shared.files)
    if section is None:
        _composable_nodes(at, shared, policy, "", None)
        return None
    machine = shared.placement.place(at, section.machine)
    variables = {**shared.placement.environment(machine), **own_variables}
    policy = policy.refined(section, at)
    kind = policy.container_type
    refuse_unread(ISOLATED_KEYS, kind, at)
    namespace = section.namespace or "/"
    full_name = join_full_name(namespace, section.name)
    shared = replace(shared, machine=machine)
    nodes = _composable_nodes(at, shared, policy, full_name, kind)
    if not kind.is_multi_threaded:
        policy = replace(policy, given=policy.given | {"thread_num": None})
        why = f"is for container_type mt and isolated_mt, this container is {kind}"
        refuse(("thread_num",), why, at)
    if section.on_exit is OnExit.IGNORE:
        fix = "for a container that does not come back: restart: {max_restarts: 0}"
        at.at_key("on_exit").problem(f"containers have restart and shutdown; {fix}")
    is_stock = kind is ContainerType.STOCK
    process = ProcessKind.PROGRAM if is_stock else ProcessKind.CONTAINER
    program: dict[str, str] = {}
    if not is_stock:
        refuse(_STOCK_KEYS, f"is for container_type stock, this container is {kind}", at)
    else:
        why = "is not for container_type stock, whose libraries are not probed"
        refuse(("probe_timeout",), why, at)
        if section.attach:
            why = "is for a container that is started here, not for attach: true"
            refuse(_START_KEYS, why, at)
        else:
            program = _STOCK_PROGRAM
    shared.start_rules.declare(full_name, at, section.start_delay)
    values = {
        **policy.given,
        **program,
        **_own(section, ContainerConfig, at),
        "machine": machine,
        "thread_num": policy.given.get("thread_num"),
        "namespace": namespace,
        "full_name": full_name,
        "process_parameters": sections,
        "environment": MappingProxyType({**shared.environment, **variables}),
        "restart": policy.restart,
        "resources": refined_resources(NO_RESOURCES, section.resources, at, process),
        "composable_nodes": nodes,
    }
    return ContainerConfig(**values)


def _composable_nodes(
    at: Cursor, shared: SharedContext, policy: Policy, container: str, kind: ContainerType | None
) -> tuple[ComposableNodeConfig, ...]:
    items = items_of(at.value("composable_nodes"), "composable nodes")
    nodes = [_composable_node(item, shared, policy, container, kind) for item in items]
    return tuple(node for node in nodes if node is not None)


def _composable_node(
    at: Cursor, shared: SharedContext, policy: Policy, container: str, kind: ContainerType | None
) -> ComposableNodeConfig | None:
    """Return the composable node at `at`, None after problems; `policy` is its container's.

    Of a container that could not be read, the name is empty and the kind None.
    """
    section = validate_mapping(ComposableNodeSection, at)
    if not isinstance(at.node, Mapping):
        return None
    full_name = shared.names.declare(at)
    extra_arguments = at.value("extra_arguments")
    values: dict[str, Any] = {
        "parameters": resolve_parameters(
            at.value("parameters"), full_name=full_name, files=shared.files
        ),
        "extra_arguments": resolve_parameters(extra_arguments, full_name=full_name, files=None),
        "remappings": resolve_remappings(at.value("remappings")),
    }
    if section is None:
        return None
    if kind is not None:
        refuse_unread(_ISOLATED_NODE_KEYS, kind, at)
    policy = policy.refined(section, at)
    resources = NO_RESOURCES
    if kind is None or kind.is_isolated:
        process = policy.node_process
        refuse_inherited(policy.resources, at, process)
        names = dict.fromkeys(name for name in (section.name, full_name) if name)
        resources = shared.groups.of_node(policy.resources, names, process)
        resources = refined_resources(resources, section.resources, at, process)
    name = full_name or shared.names.label(container, section.namespace or "", section.plugin)
    key = NodeKey(container, name)
    shared.start_rules.declare(str(key), at, section.start_delay)
    shared.start_rules.declare_managed(str(key), full_name, at, section)
    _expect(at, shared, section, full_name, values["remappings"])
    values = {
        **_own(section, ComposableNodeConfig, at),
        **values,
        "key": key,
        "on_crash": policy.on_crash,
        "restart": policy.restart,
        "resources": resources,
    }
    return ComposableNodeConfig(**values)


def resolve_process(at: Cursor, shared: SharedContext) -> ProcessConfig | None:
    section = validate_mapping(ProcessSection, at)
    if not isinstance(at.node, Mapping):
        return None
    _check_combinations(at)
    given_name = shared.names.declare(at)
    variables = resolve_environment(at.value("environment"))
    values: dict[str, Any] = {
        "parameters": resolve_parameters(
            at.value("parameters"), full_name=given_name, files=shared.files
        ),
        "process_parameters": resolve_process_parameters(
            at.value("process_parameters"), shared.files
        ),
        "remappings": resolve_remappings(at.value("remappings")),
    }
    if section is None:
        return None
    machine = shared.placement.place(at, section.machine)
    variables = {**shared.placement.environment(machine), **variables}
    shared = replace(shared, machine=machine)
    program = section.executable or (section.command[0] if section.command else "")
    program = program.rpartition("/")[2]
    full_name = given_name or shared.names.label("", section.namespace or "", program)
    values = {
        **_own(section, ProcessConfig, at),
        **values,
        "machine": machine,
        "environment": MappingProxyType({**shared.environment, **variables}),
        "full_name": full_name,
        "restart": refined_restart(RestartLimits(), section.restart, at),
        "resources": refined_resources(NO_RESOURCES, section.resources, at, ProcessKind.PROGRAM),
    }
    config = ProcessConfig(**values)
    if section.restart is not None and config.on_exit is not OnExit.RESTART:
        at.at_key("restart").problem("only read with on_exit: restart; add that")
    shared.start_rules.declare(full_name, at, section.start_delay)
    shared.start_rules.declare_managed(full_name, given_name, at, section)
    _expect(at, shared, section, given_name, config.remappings)
    return config


def _expect(
    at: Cursor,
    shared: SharedContext,
    section: ComposableNodeSection | ProcessSection,
    node: str | None,
    remappings: tuple[tuple[str, str], ...],
) -> None:
    shared.expected.add(
        at.value("expect"),
        namespace=section.namespace or "/",
        node=node,
        remappings=remappings,
        machine=shared.machine,
    )


def _check_combinations(at: Cursor) -> None:
    given = {entry.key: (entry, value) for entry, value in at.entries()}
    if "command" not in given:
        if "package" not in given and "executable" not in given:
            at.problem(f"nothing to run; {_COMMAND_OR_PACKAGE}")
        elif "executable" not in given:
            at.problem('the key "executable" is missing, which goes with package')
        elif "package" not in given:
            at.problem('the key "package" is missing, which goes with executable')
        return
    for key, message in (
        ("package", _COMMAND_OR_PACKAGE),
        ("executable", _COMMAND_OR_PACKAGE),
        ("arguments", "put the arguments into command, after the program"),
    ):
        if key in given:
            entry, value = given[key]
            value.problem(message, entry.location)


def resolve_remappings(at: Cursor | None) -> tuple[tuple[str, str], ...]:
    """Return the pairs (from, to) in their order.

    The forms are a mapping `{from: to}`, and a list of `from:=to`, `[from, to]` or
    `{from: ..., to: ...}`.
    """
    if at is None:
        return ()
    pairs: list[tuple[str, str]] = []
    first: dict[str, Location] = {}
    for value, source, target in _remapping_sides(at):
        before = len(at.report)
        name, location = source
        if name in _NOT_REMAPPED:
            fix = f"use the key {_NOT_REMAPPED[name]}"
            value.problem(f"{name} cannot be remapped here; {fix}", location)
            continue
        for side, side_location in (source, target):
            try:
                check_topic(side)
            except ValueError as error:
                value.problem(str(error), side_location)
        if name in first:
            value.problem(f"{excerpt(name)} is remapped twice, first at {first[name]}", location)
        first.setdefault(name, location)
        if len(at.report) == before:
            pairs.append((name, target[0]))
    return tuple(pairs)


def _remapping_sides(
    at: Cursor,
) -> Iterator[tuple[Cursor, tuple[str, Location], tuple[str, Location]]]:
    if isinstance(at.node, Mapping):
        for entry, value in at.entries():
            if (target := _name(value)) is not None:
                location = value.node.location
                yield value, (entry.key, entry.location), (target, location)
        return
    if not at.is_plain_list:
        if not at.is_invalid:
            at.problem(f"{_REMAPPING}, in a list, given {describe_node(at.node)}")
        return
    for item in at.elements():
        node = item.node
        sides: tuple[Node, ...] = ()
        if isinstance(node, Mapping) and node.by_key.keys() == {"from", "to"}:
            sides = (node.by_key["from"].value, node.by_key["to"].value)
        elif isinstance(node, Sequence) and node.array_tag is None and len(node.items) == 2:
            sides = node.items
        if sides:
            names = [_name(replace(item, node=side)) for side in sides]
            if names[0] is not None and names[1] is not None:
                yield item, (names[0], sides[0].location), (names[1], sides[1].location)
            continue
        source, separator, target = (item.string or "").partition(":=")
        if separator:
            yield item, (source.strip(), node.location), (target.strip(), node.location)
        elif not item.is_invalid:
            item.problem(f"{_REMAPPING}, given {describe_node(node)}")


def _name(at: Cursor) -> str | None:
    if at.string is None:
        at.expected("a topic or service name")
    return at.string

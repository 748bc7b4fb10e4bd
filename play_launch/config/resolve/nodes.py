"""Containers, composable nodes and ordinary processes, and their names."""

from __future__ import annotations

import re
from collections import Counter
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from play_launch.config.model import (
    ComposableNodeConfig,
    ContainerConfig,
    ContainerType,
    OnExit,
    Output,
    ProcessConfig,
    RestartLimits,
)
from play_launch.config.node_key import NodeKey
from play_launch.config.problems import excerpt
from play_launch.config.resolve.parameter_files import resolve_process_parameters
from play_launch.config.resolve.parameters import resolve_parameters
from play_launch.config.resolve.policy import (
    ISOLATED_KEYS,
    Process,
    node_process,
    refined_resources,
    refined_restart,
    refuse,
    refuse_inherited,
    refuse_unread,
)
from play_launch.config.resources import Resources
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
    from collections.abc import Mapping as Variables

    from play_launch.config.problems import Place, Report
    from play_launch.config.resolve.order import StartRules
    from play_launch.config.resolve.parameter_files import ParameterFiles
    from play_launch.config.resolve.policy import GroupRules, Policy
    from play_launch.config.tree import At, Node


_COMMAND_OR_PACKAGE = "give either command, or package and executable"
_NUMBERED: Final = re.compile(r":[0-9]+$")
_ISOLATED_KEYS: Final = ("auto_reload_on_crash", "on_crash", "restart", "resources")


class NodeNames:
    """Every name in the system once, and labels for nodes whose name is their own affair.

    ROS lets two nodes share a name, and both then misbehave.
    """

    def __init__(self) -> None:
        self._places: dict[str, Place] = {}
        self._labels: Counter[tuple[str, str]] = Counter()

    def __contains__(self, full_name: str) -> bool:
        """Whether some node gives this name."""
        return full_name in self._places

    def declare(self, at: At) -> str | None:
        """Return the full name that a node gives, None if it gives none; report a second owner.

        Looks at the tree, so that two equal names are found even where other keys are wrong.
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
        first = self._places.setdefault(full_name, at_name.node.place)
        if first is not at_name.node.place:
            at_name.problem(f"the name {full_name} is given twice, first at {first}")
        return full_name

    def label(self, container: str, namespace: str, what: str) -> str:
        """Return a label for an unnamed node, `/[what]`, that no other node of the container has.

        The second of its kind is `/[what:2]`, and so on; what is declared of another kind, or in
        another container, does not change it. `container` is empty for ordinary processes.
        """
        base = join_full_name(namespace or "/", what)
        self._labels[container, base] += 1
        count = self._labels[container, base]
        # What looks like a number of ours gets one, too: a program can be called `talker:2`.
        suffix = "" if count == 1 and not _NUMBERED.search(what) else f":{count}"
        return join_full_name(namespace or "/", f"[{what}{suffix}]")


class Shared(Struct, frozen=True):
    """What all nodes of one configuration share."""

    files: ParameterFiles
    environment: Variables[str, str]
    start_rules: StartRules
    names: NodeNames
    groups: GroupRules


def resolve_composable_node(
    at: At, shared: Shared, policy: Policy, container: str, kind: ContainerType | None
) -> ComposableNodeConfig | None:
    """Return the composable node at `at`, or None after problems were reported.

    `policy` is that of its container. Where the container could not be read, its full name
    `container` is empty and `kind` is None.
    """
    section = validate_mapping(ComposableNodeSection, at)
    if not isinstance(at.node, Mapping):
        return None
    full_name = shared.names.declare(at)
    parameters = resolve_parameters(at.value("parameters"), full_name=full_name, files=shared.files)
    extra_arguments = resolve_parameters(
        at.value("extra_arguments"), full_name=full_name, files=None
    )
    remappings = resolve_remappings(at.value("remappings"))
    if section is None:
        return None
    if kind is not None:
        refuse_unread(_ISOLATED_KEYS, kind, at)
    policy = policy.refined(section, at)
    resources = Resources()
    if kind is None or kind.is_isolated:
        process = node_process(policy.isolation)
        refuse_inherited(policy.resources, at, process)
        resources = shared.groups.of_node(policy.resources, section.name or "", full_name, process)
        resources = refined_resources(resources, section.resources, at, process)
    namespace = section.namespace or ""
    key = NodeKey(container, full_name or shared.names.label(container, namespace, section.plugin))
    shared.start_rules.declare(str(key), at, section.start_delay)
    shared.start_rules.declare_managed(str(key), full_name, at, section)
    return ComposableNodeConfig(
        package=section.package,
        plugin=section.plugin,
        name=section.name or "",
        namespace=namespace,
        key=key,
        parameters=parameters,
        remappings=remappings,
        extra_arguments=extra_arguments,
        log_level=section.log_level,
        on_crash=policy.on_crash,
        restart=policy.restart,
        resources=resources,
        line=at.node.place.line,
        file=at.node.place.file,
    )


def resolve_process(at: At, shared: Shared) -> ProcessConfig | None:
    """Return the process at `at`, or None after problems were reported."""
    section = validate_mapping(ProcessSection, at)
    if not isinstance(at.node, Mapping):
        return None
    _check_combinations(at)
    full_name = shared.names.declare(at)
    variables = resolve_environment(at.value("environment"))
    parameters = resolve_parameters(at.value("parameters"), full_name=full_name, files=shared.files)
    sections = resolve_process_parameters(at.value("process_parameters"), shared.files)
    remappings = resolve_remappings(at.value("remappings"))
    if section is None:
        return None
    restart = refined_restart(RestartLimits(), section.restart, at)
    resources = refined_resources(Resources(), section.resources, at, Process.PROGRAM)
    on_exit = section.on_exit or OnExit.IGNORE
    if section.restart is not None and on_exit is not OnExit.RESTART:
        at.blame("restart").problem("only read with on_exit: restart; add that")
    namespace = section.namespace or ""
    program = section.executable or (section.command[0] if section.command else "")
    given_name = full_name
    if full_name is None:
        full_name = shared.names.label("", namespace, program.rpartition("/")[2])
    shared.start_rules.declare(full_name, at, section.start_delay)
    shared.start_rules.declare_managed(full_name, given_name, at, section)
    return ProcessConfig(
        name=section.name or "",
        namespace=namespace,
        full_name=full_name,
        command=None if section.command is None else tuple(section.command),
        package=section.package,
        executable=section.executable,
        arguments=tuple(section.arguments or ()),
        parameters=parameters,
        process_parameters=sections,
        remappings=remappings,
        environment=MappingProxyType({**shared.environment, **variables}),
        ros_arguments=tuple(section.ros_arguments or ()),
        prefix=tuple(section.prefix or ()),
        cwd=None if section.cwd is None else path_from(at.blame("cwd"), section.cwd),
        emulate_tty=bool(section.emulate_tty),
        output=section.output or Output.BOTH,
        on_exit=on_exit,
        restart=restart,
        resources=resources,
        log_level=section.log_level,
        line=at.node.place.line,
        file=at.node.place.file,
    )


def _check_combinations(at: At) -> None:
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
            value.problem(message, entry.place)


STOCK_PACKAGE: Final = "rclcpp_components"
STOCK_EXECUTABLE: Final = "component_container"
_KEYS: Final = ("package", "executable", "arguments", "attach")
_OUR_KEYS: Final = ("probe_timeout",)
"""Keys that say something for play-launch's own containers only."""
_FOR_STARTING: Final = (
    "package",
    "executable",
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
"""Keys about starting a container; one that runs already reads none of them."""


def resolve_container(at: At, shared: Shared, policy: Policy) -> ContainerConfig | None:
    """Return the container at `at`, None after problems; `policy` is that of all containers."""
    section = validate_mapping(ContainerSection, at)
    if not isinstance(at.node, Mapping):
        return None
    shared.names.declare(at)
    variables = resolve_environment(at.value("environment"))
    sections = resolve_process_parameters(at.value("process_parameters"), shared.files)
    if section is None:
        _composable_nodes(at, shared, policy, "", None)
        return None
    policy = policy.refined(section, at)
    kind = policy.container_type
    refuse_unread(ISOLATED_KEYS, kind, at)
    namespace = section.namespace or "/"
    full_name = join_full_name(namespace, section.name)
    composable_nodes = _composable_nodes(at, shared, policy, full_name, kind)
    if not kind.is_multi_threaded:
        policy = replace(policy, thread_num=None)
        why = f"is for container_type mt and isolated_mt, this container is {kind}"
        refuse(("thread_num",), why, at)
    if section.on_exit is OnExit.IGNORE:
        fix = "for a container that does not come back: restart: {max_restarts: 0}"
        at.blame("on_exit").problem(f"containers have restart and shutdown; {fix}")
    stock = _stock_program(section, kind, at)
    process = Process.PROGRAM if kind is ContainerType.STOCK else Process.CONTAINER
    shared.start_rules.declare(full_name, at, section.start_delay)
    return ContainerConfig(
        name=section.name,
        namespace=namespace,
        full_name=full_name,
        container_type=kind,
        thread_num=policy.thread_num,
        isolation=policy.isolation,
        memory_domains=policy.memory_domains,
        core_dumps=policy.core_dumps,
        package=stock.package,
        executable=stock.executable,
        arguments=stock.arguments,
        attach=stock.attach,
        process_parameters=sections,
        prefix=tuple(section.prefix or ()),
        cwd=None if section.cwd is None else path_from(at.blame("cwd"), section.cwd),
        output=section.output or Output.BOTH,
        on_exit=section.on_exit or OnExit.RESTART,
        log_level=section.log_level,
        environment=MappingProxyType({**shared.environment, **variables}),
        ros_arguments=tuple(section.ros_arguments or ()),
        restart=policy.restart,
        resources=refined_resources(Resources(), section.resources, at, process),
        loading_timeout=policy.loading_timeout,
        probe_timeout=policy.probe_timeout,
        composable_nodes=composable_nodes,
        line=at.node.place.line,
        file=at.node.place.file,
    )


def _composable_nodes(
    at: At, shared: Shared, policy: Policy, container: str, kind: ContainerType | None
) -> tuple[ComposableNodeConfig, ...]:
    items = items_of(at.value("composable_nodes"), "composable nodes")
    resolved = [resolve_composable_node(item, shared, policy, container, kind) for item in items]
    return tuple(one for one in resolved if one is not None)


class _StockProgram(Struct, frozen=True, kw_only=True):
    """What a stock container is; all empty for one of play-launch's own."""

    package: str = ""
    executable: str = ""
    arguments: tuple[str, ...] = ()
    attach: bool = False


def _stock_program(section: ContainerSection, kind: ContainerType, at: At) -> _StockProgram:
    """Return what `section` says; report keys that nothing would read."""
    if kind is not ContainerType.STOCK:
        refuse(_KEYS, f"is for container_type stock, this container is {kind}", at)
        return _StockProgram()
    refuse(_OUR_KEYS, "is not for container_type stock, whose libraries are not probed", at)
    if section.attach:
        why = "is for a container that is started here, not for attach: true"
        refuse(_FOR_STARTING, why, at)
        return _StockProgram(attach=True)
    return _StockProgram(
        package=section.package or STOCK_PACKAGE,
        executable=section.executable or STOCK_EXECUTABLE,
        arguments=tuple(section.arguments or ()),
    )


_FORMS = 'expected a remapping such as "chatter:=/sensing/chatter" or {from: chatter, to: /chatter}'
_SPECIAL = {"__node": "name", "__name": "name", "__ns": "namespace"}


def resolve_remappings(at: At | None) -> tuple[tuple[str, str], ...]:
    """Return the (from, to) pairs that stand there, in their order.

    Taken are a mapping `{from: to}`, and a list of `from:=to`, `[from, to]` or
    `{from: ..., to: ...}`.
    """
    if at is None:
        return ()
    collected = _Collected(at.report)
    if isinstance(at.node, Mapping):
        for entry, value in at.entries():
            target = _string(value)
            if target is not None:
                collected.add(value, (entry.key, entry.place), (target, entry.value.place))
    elif isinstance(at.node, Sequence) and at.node.array_tag is None:
        for item in at.elements():
            _add_item(item, collected)
    elif not at.is_invalid:
        at.problem(f"{_FORMS}, in a list, given {describe_node(at.node)}")
    return tuple(collected.pairs)


class _Collected:
    def __init__(self, report: Report) -> None:
        self.pairs: list[tuple[str, str]] = []
        self._report = report
        self._places: dict[str, Place] = {}

    def add(self, at: At, source: tuple[str, Place], target: tuple[str, Place]) -> None:
        before = len(self._report)
        name, place = source
        if name in _SPECIAL:
            at.problem(f"{name} cannot be remapped here; use the key {_SPECIAL[name]}", place)
            return
        for side, side_place in (source, target):
            try:
                check_topic(side)
            except ValueError as error:
                at.problem(str(error), side_place)
        if name in self._places:
            first = self._places[name]
            at.problem(f"{excerpt(name)} is remapped twice, first at {first}", place)
        self._places.setdefault(name, place)
        if len(self._report) == before:
            self.pairs.append((name, target[0]))


def _add_item(at: At, collected: _Collected) -> None:
    item = at.node
    sides: tuple[Node, ...] = ()
    if isinstance(item, Mapping) and item.by_key.keys() == {"from", "to"}:
        sides = (item.by_key["from"].value, item.by_key["to"].value)
    elif isinstance(item, Sequence) and item.array_tag is None and len(item.items) == 2:
        sides = item.items
    if not sides:
        source, separator, target = (at.string or "").partition(":=")
        if separator:
            collected.add(at, (source.strip(), item.place), (target.strip(), item.place))
        elif not at.is_invalid:
            at.problem(f"{_FORMS}, given {describe_node(item)}")
        return
    names = [_string(replace(at, node=side)) for side in sides]
    if names[0] is not None and names[1] is not None:
        collected.add(at, (names[0], sides[0].place), (names[1], sides[1].place))


def _string(at: At) -> str | None:
    if at.string is None:
        at.expected("a topic or service name")
    return at.string

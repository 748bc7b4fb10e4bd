"""Containers and their nodes."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from play_launch.config.model import ContainerConfig, ContainerType, Output
from play_launch.config.policies import OnExit
from play_launch.config.resolve.nodes import resolve_composable_node
from play_launch.config.resolve.policy import ISOLATED_KEYS, refuse, refuse_unread
from play_launch.config.resolve.process_parameters import resolve_process_parameters
from play_launch.config.resolve.resources import Process, refined_resources
from play_launch.config.resources import Resources
from play_launch.config.schema import ContainerSection
from play_launch.config.source import path_from
from play_launch.config.validation import items_of, validate_mapping
from play_launch.config.values import join_full_name, resolve_environment
from play_launch.config.yaml.tree import Mapping

if TYPE_CHECKING:
    from play_launch.config.model import ComposableNodeConfig
    from play_launch.config.resolve.nodes import Shared
    from play_launch.config.resolve.policy import Policy
    from play_launch.config.yaml.tree import At

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

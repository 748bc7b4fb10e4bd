"""Composable nodes and ordinary processes, from the YAML tree to the resolved configuration."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

from play_launch.config.crash import merge_node
from play_launch.config.environment import resolve_environment
from play_launch.config.model import ComposableNodeConfig, ProcessConfig
from play_launch.config.parameters import resolve_parameters
from play_launch.config.remappings import resolve_remappings
from play_launch.config.restart import merge_restart
from play_launch.config.schema import ComposableNodeSection, ProcessSection
from play_launch.config.validation import validate_mapping
from play_launch.config.yaml_tree import Mapping, Node
from play_launch.core.restart import RestartLimits

if TYPE_CHECKING:
    from collections.abc import Mapping as Variables

    from play_launch.config.crash import CrashRules
    from play_launch.config.node_names import NodeNames
    from play_launch.config.parameter_files import ParameterFiles
    from play_launch.config.report import Report

_COMMAND_OR_PACKAGE = "give either command, or package and executable"


def resolve_composable_node(
    node: Node,
    path: str,
    report: Report,
    names: NodeNames,
    files: ParameterFiles,
    *,
    rules: CrashRules,
) -> ComposableNodeConfig | None:
    """Return the composable node at `node`, None if it is none; problems go to `report`.

    `rules` are those of its container.
    """
    section = validate_mapping(ComposableNodeSection, node, path, report)
    if not isinstance(node, Mapping):
        return None
    full_name = names.declare(node, path)
    parameters = resolve_parameters(
        node.value("parameters"), f"{path}.parameters", report, full_name=full_name, files=files
    )
    extra_arguments = resolve_parameters(
        node.value("extra_arguments"),
        f"{path}.extra_arguments",
        report,
        full_name=full_name,
        files=None,
    )
    remappings = resolve_remappings(node.value("remappings"), f"{path}.remappings", report)
    if section is None:
        return None
    on_crash, restart = merge_node(rules, section, node, path, report)
    namespace = section.namespace or ""
    return ComposableNodeConfig(
        package=section.package,
        plugin=section.plugin,
        name=section.name or "",
        namespace=namespace,
        declared_full_name=full_name or names.label(namespace, section.plugin),
        parameters=parameters,
        remappings=remappings,
        extra_arguments=extra_arguments,
        log_level=section.log_level,
        on_crash=on_crash,
        restart=restart,
        line=node.place.line,
    )


def resolve_process(
    node: Node,
    path: str,
    report: Report,
    names: NodeNames,
    files: ParameterFiles,
    *,
    environment: Variables[str, str],
) -> ProcessConfig | None:
    """Return the process at `node`, None if it is none; problems go to `report`.

    `environment` holds the variables of the whole system.
    """
    section = validate_mapping(ProcessSection, node, path, report)
    if not isinstance(node, Mapping):
        return None
    _check_combinations(node, path, report)
    full_name = names.declare(node, path)
    variables = resolve_environment(node.value("environment"), f"{path}.environment", report)
    parameters = resolve_parameters(
        node.value("parameters"), f"{path}.parameters", report, full_name=full_name, files=files
    )
    remappings = resolve_remappings(node.value("remappings"), f"{path}.remappings", report)
    if section is None:
        return None
    restart = merge_restart(RestartLimits(), section.restart, node, path, report)
    if section.restart is not None and not section.respawn:
        place = (node.value("restart") or node).place
        report.add(place, f"{path}.restart", "only read with respawn: true; add that")
    namespace = section.namespace or ""
    program = section.executable or (section.command[0] if section.command else "")
    return ProcessConfig(
        name=section.name or "",
        namespace=namespace,
        full_name=full_name or names.label(namespace, program.rpartition("/")[2]),
        command=None if section.command is None else tuple(section.command),
        package=section.package,
        executable=section.executable,
        arguments=tuple(section.arguments or ()),
        parameters=parameters,
        remappings=remappings,
        environment=MappingProxyType({**environment, **variables}),
        ros_arguments=tuple(section.ros_arguments or ()),
        respawn=section.respawn or False,
        restart=restart,
        log_level=section.log_level,
        line=node.place.line,
    )


def _check_combinations(node: Mapping, path: str, report: Report) -> None:
    command = node.entry("command")
    package = node.entry("package")
    executable = node.entry("executable")
    if command is None:
        if package is None and executable is None:
            report.add(node.place, path, f"nothing to run; {_COMMAND_OR_PACKAGE}")
        elif executable is None:
            report.add(node.place, path, 'the key "executable" is missing, which goes with package')
        elif package is None:
            report.add(node.place, path, 'the key "package" is missing, which goes with executable')
        return
    for other in (package, executable):
        if other is not None:
            report.add(other.place, f"{path}.{other.key}", _COMMAND_OR_PACKAGE)
    arguments = node.entry("arguments")
    if arguments is not None:
        message = "put the arguments into command, after the program"
        report.add(arguments.place, f"{path}.arguments", message)

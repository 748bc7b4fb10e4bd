"""A configuration as plain values for JSON, for `check --json` and the recording."""

from __future__ import annotations

import base64
import math
from typing import TYPE_CHECKING

from play_launch.config.model import ParameterType

if TYPE_CHECKING:
    from play_launch.config.dependency import StartRule
    from play_launch.config.model import (
        ComposableNodeConfig,
        ContainerConfig,
        ParameterConfig,
        ParameterPayload,
        ParameterSection,
        ProcessConfig,
        RecordConfig,
        ReplayConfig,
    )
    from play_launch.config.policies import RestartLimits


def describe(config: ReplayConfig) -> dict[str, object]:
    """Return what `config` says, resolved, in values that `json.dumps` takes.

    Durations are seconds and sizes bytes, or "never". A parameter is `{"type": ..., "value": ...}`;
    a byte array is base64, and the doubles that JSON does not know are the strings `.inf`, `-.inf`
    and `.nan`.
    """
    return {
        "version": 1,
        "name": config.name,
        "source": str(config.source),
        "included_files": [str(file.path) for file in config.included_files],
        "parameter_files": [str(file.path) for file in config.parameter_files],
        "taken": {
            "arguments": dict(config.taken.arguments),
            "variables": dict(config.taken.variables),
            "packages": dict(config.taken.packages),
        },
        "duration": config.duration,
        "log_dir": None if config.log_dir is None else str(config.log_dir),
        "graph_daemon": config.graph_daemon,
        "environment": dict(config.environment),
        "stop": {
            "ask": config.stop.ask,
            "sigint": config.stop.sigint,
            "sigterm": config.stop.sigterm,
        },
        "record": _record(config.record),
        "cgroups": config.cgroups.described(),
        "containers": [_container(one) for one in config.containers],
        "nodes": [_process(one) for one in config.nodes],
        "start_rules": {unit: _start_rule(rule) for unit, rule in config.start_rules.items()},
        "managed": {
            unit: {
                "name": managed.name,
                "autostart": managed.autostart and str(managed.autostart),
                "transition_timeout": _or_never(managed.timeout),
            }
            for unit, managed in config.managed.items()
        },
    }


def _start_rule(rule: StartRule) -> dict[str, object]:
    return {
        "delay": rule.delay,
        "dependencies": [
            {
                "condition": str(each.condition),
                "unit": each.unit,
                "subject": each.subject,
                "timeout": _or_never(each.timeout),
                "on_timeout": str(each.on_timeout),
            }
            for each in rule.dependencies
        ],
    }


def _record(record: RecordConfig) -> dict[str, object]:
    before_crash = record.before_crash
    return {
        "sync": _or_never(record.sync),
        "rotate": {
            "size": _or_never(record.rotate.size),
            "duration": _or_never(record.rotate.duration),
        },
        "keep": {"sessions": record.keep.sessions, "size": record.keep.size},
        "sampling": {"period": _or_never(record.sampling.period)},
        "ros": record.ros,
        "topics": list(record.topics),
        "exclude": list(record.exclude),
        "budget": {topic: _or_never(size) for topic, size in record.topic_budgets} or record.budget,
        "before_crash": before_crash
        and {
            "topics": list(before_crash.topics),
            "seconds": before_crash.seconds,
            "megabytes": before_crash.megabytes,
        },
    }


def _or_never(number: float) -> float | str:
    return number if math.isfinite(number) else "never"


def _container(container: ContainerConfig) -> dict[str, object]:
    return {
        "full_name": container.full_name,
        "line": container.line,
        "file": container.file,
        "container_type": str(container.container_type),
        "thread_num": container.thread_num,
        "isolation": str(container.isolation),
        "memory_domains": str(container.memory_domains),
        "core_dumps": container.core_dumps,
        "package": container.package,
        "executable": container.executable,
        "arguments": list(container.arguments),
        "attach": container.attach,
        "process_parameters": _sections(container.process_parameters),
        "prefix": list(container.prefix),
        "cwd": None if container.cwd is None else str(container.cwd),
        "output": str(container.output),
        "on_exit": str(container.on_exit),
        "log_level": container.log_level,
        "environment": dict(container.environment),
        "ros_arguments": list(container.ros_arguments),
        "resources": container.resources.described(),
        "restart": _restart(container.restart),
        "loading_timeout": container.loading_timeout,
        "probe_timeout": container.probe_timeout,
        "composable_nodes": [_composable_node(one) for one in container.composable_nodes],
    }


def _composable_node(node: ComposableNodeConfig) -> dict[str, object]:
    return {
        "key": str(node.key),
        "package": node.package,
        "plugin": node.plugin,
        "name": node.name,
        "namespace": node.namespace,
        "full_name": node.declared_full_name,
        "line": node.line,
        "file": node.file,
        "parameters": _parameters(node.parameters),
        "remappings": [list(pair) for pair in node.remappings],
        "extra_arguments": _parameters(node.extra_arguments),
        "log_level": node.log_level,
        "on_crash": str(node.on_crash),
        "resources": node.resources.described(),
        "restart": _restart(node.restart),
    }


def _process(process: ProcessConfig) -> dict[str, object]:
    return {
        "name": process.name,
        "namespace": process.namespace,
        "full_name": process.full_name,
        "line": process.line,
        "file": process.file,
        "command": None if process.command is None else list(process.command),
        "package": process.package,
        "executable": process.executable,
        "arguments": list(process.arguments),
        "parameters": _parameters(process.parameters),
        "process_parameters": _sections(process.process_parameters),
        "remappings": [list(pair) for pair in process.remappings],
        "environment": dict(process.environment),
        "ros_arguments": list(process.ros_arguments),
        "prefix": list(process.prefix),
        "cwd": None if process.cwd is None else str(process.cwd),
        "emulate_tty": process.emulate_tty,
        "output": str(process.output),
        "on_exit": str(process.on_exit),
        "resources": process.resources.described(),
        "restart": _restart(process.restart),
        "log_level": process.log_level,
    }


def _restart(limits: RestartLimits) -> dict[str, object]:
    return {
        "max_restarts": limits.max_restarts,
        "within": limits.within,
        "backoff": {"initial": limits.initial, "maximum": limits.maximum},
    }


def _sections(sections: tuple[ParameterSection, ...]) -> dict[str, object]:
    return {section.pattern: _parameters(section.parameters) for section in sections}


def _parameters(parameters: tuple[ParameterConfig, ...]) -> dict[str, object]:
    return {
        parameter.name: {
            "type": ParameterType(parameter.value.type).name.lower(),
            "value": _plain(parameter.value.value),
        }
        for parameter in parameters
    }


def _plain(value: ParameterPayload) -> object:
    if isinstance(value, bytes):
        return base64.b64encode(value).decode("ascii")
    if isinstance(value, tuple):
        return [_plain(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return ".nan" if math.isnan(value) else ".inf" if value > 0 else "-.inf"
    return value

"""A configuration as plain values for JSON, for `check --json`, `apply` and the recording."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec import Struct

from play_launch.config.model import (
    ComposableNodeConfig,
    ContainerConfig,
    ManagedConfig,
    ParameterConfig,
    RecordConfig,
    ReplayConfig,
    RestartLimits,
    SourceFile,
)
from play_launch.config.node_key import NodeKey
from play_launch.config.resources import Resources

if TYPE_CHECKING:
    from play_launch.config.model import ParameterPayload


def describe(config: ReplayConfig) -> dict[str, object]:
    """Return the resolved configuration in values that `json.dumps` takes.

    Durations are seconds and sizes bytes, or "never". A parameter is `{"type": ..., "value": ...}`;
    a byte array is base64, and the doubles that JSON does not know are the strings `.inf`, `-.inf`
    and `.nan`.
    """
    return {"version": 1, **_fields(config, "text")}


def _fields(struct: Struct, *without: str) -> dict[str, Any]:
    names = [name for name in struct.__struct_fields__ if name not in without]
    return {name: described(name, getattr(struct, name)) for name in names}


def described(name: str, value: Any) -> Any:
    """Return the value of one field of a configuration, as in `describe`."""
    if name in {"parameters", "extra_arguments"}:
        return _parameters(value)
    if name == "process_parameters":
        return {section.pattern: _parameters(section.parameters) for section in value}
    match value:
        case Struct():
            return _struct(value)
        case Path() | StrEnum():
            return str(value)
        case tuple():
            return [described("", each) for each in value]
        case Mapping():
            return {key: described("", each) for key, each in value.items()}
        case float() if not math.isfinite(value):
            return "never"
    return value


def _struct(struct: Struct) -> Any:
    match struct:
        case SourceFile():
            return str(struct.path)
        case NodeKey():
            return str(struct)
        case Resources():
            return struct.described()
        case RestartLimits():
            backoff = {"initial": struct.initial, "maximum": struct.maximum}
            limits = {"max_restarts": struct.max_restarts, "within": struct.within}
            return {**limits, "backoff": backoff}
        case ManagedConfig():
            timeout = described("", struct.timeout)
            return {**_fields(struct, "timeout"), "transition_timeout": timeout}
        case RecordConfig():
            budgets = {topic: described("", size) for topic, size in struct.topic_budgets}
            return {**_fields(struct, "topic_budgets"), "budget": budgets or struct.budget}
        case ContainerConfig():
            return _fields(struct, "name", "namespace")
        case ComposableNodeConfig():
            return {**_fields(struct), "full_name": struct.declared_full_name}
    return _fields(struct)


def _parameters(parameters: tuple[ParameterConfig, ...]) -> dict[str, object]:
    return {
        each.name: {"type": each.value.type.name.lower(), "value": _payload(each.value.value)}
        for each in parameters
    }


def _payload(value: ParameterPayload) -> object:
    if isinstance(value, bytes):
        return base64.b64encode(value).decode("ascii")
    if isinstance(value, tuple):
        return [_payload(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return ".nan" if math.isnan(value) else ".inf" if value > 0 else "-.inf"
    return value

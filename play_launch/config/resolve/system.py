"""The whole system, from the tree of its file."""

from __future__ import annotations

import os
from types import MappingProxyType
from typing import TYPE_CHECKING

from msgspec.structs import replace

from play_launch.config.model import ContainerType, ReplayConfig, StopLimits
from play_launch.config.resolve.containers import resolve_container
from play_launch.config.resolve.nodes import Shared, resolve_process
from play_launch.config.resolve.parameter_files import ParameterFiles
from play_launch.config.resolve.policy import ISOLATED_KEYS, Policy
from play_launch.config.schema import DocumentSection, LoadingSection
from play_launch.config.validation import items_of, validate_mapping
from play_launch.config.values import resolve_environment
from play_launch.config.yaml.tree import At, Mapping, Sequence

if TYPE_CHECKING:
    from pathlib import Path

    from play_launch.config.model import ContainerConfig, ProcessConfig
    from play_launch.config.problems import Report
    from play_launch.config.yaml.tree import Node

_LOADING = "composable_node_loading"


def resolve_document(
    root: Node, source: Path, content: bytes, report: Report
) -> ReplayConfig | None:
    """Return the configuration in `root`; None, or nothing to rely on, if `report` got problems."""
    at = At(root, "", report)
    document = validate_mapping(DocumentSection, at)
    if not isinstance(root, Mapping):
        return None
    environment = resolve_environment(at.value("environment"))
    shared = Shared(ParameterFiles(source.parent, report), environment)
    given = None if document is None else document.composable_node_loading
    containers = _containers(at, shared, given or LoadingSection())
    nodes = _processes(at, shared)
    _refuse_nothing(at)
    if document is None:
        return None
    stop = {} if document.stop is None else document.stop.given
    log_dir = None
    if document.log_dir is not None:
        log_dir = source.parent / os.path.expanduser(document.log_dir)  # noqa: PTH111 - never raises
    return ReplayConfig(
        name=source.stem if document.name is None else document.name,
        source=source,
        text=content,
        parameter_files=shared.files.read,
        duration=document.duration,
        log_dir=log_dir,
        graph_daemon=bool(document.graph_daemon),
        environment=MappingProxyType(environment),
        stop=replace(StopLimits(), **stop),
        containers=containers,
        nodes=nodes,
    )


def _containers(at: At, shared: Shared, loading: LoadingSection) -> tuple[ContainerConfig, ...]:
    at_loading = at.blame(_LOADING)
    policy = Policy().refined(loading, at_loading)
    items = items_of(at.value("containers"), "containers")
    resolved = [resolve_container(item, shared, policy) for item in items]
    complete = tuple(one for one in resolved if one is not None)
    if len(complete) == len(resolved):
        _refuse_unread(at_loading, loading, {one.container_type for one in complete})
    return complete


def _refuse_unread(at: At, loading: LoadingSection, kinds: set[ContainerType]) -> None:
    """Report keys of `composable_node_loading` that no container reads."""
    unread: dict[str, str] = {}
    if not any(kind.is_multi_threaded for kind in kinds):
        unread["thread_num"] = "mt or isolated_mt"
    if not any(kind.is_isolated for kind in kinds):
        unread |= dict.fromkeys(ISOLATED_KEYS, "isolated or isolated_mt")
    if kinds <= {ContainerType.STOCK}:
        unread["probe_timeout"] = "standard, mt, isolated or isolated_mt"
    for key, readers in unread.items():
        value = at.value(key)
        if value is not None and getattr(loading, key) is not None:
            message = f"no container has container_type {readers}, so nothing reads {key}"
            value.problem(message)


def _processes(at: At, shared: Shared) -> tuple[ProcessConfig, ...]:
    resolved = [resolve_process(item, shared) for item in items_of(at.value("nodes"), "nodes")]
    return tuple(one for one in resolved if one is not None)


def _refuse_nothing(at: At) -> None:
    lists = [at.value("containers"), at.value("nodes")]
    if all(one is None or (isinstance(one.node, Sequence) and not one.node.items) for one in lists):
        at.problem("nothing to start; give containers or nodes")

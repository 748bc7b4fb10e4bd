"""From the YAML tree to the resolved configuration: defaults, full names, one owner per name."""

from __future__ import annotations

import os
from types import MappingProxyType
from typing import TYPE_CHECKING

from play_launch.config.crash import (
    ISOLATED_KEYS,
    CrashRules,
    merge_on_crash,
    refuse_unread,
)
from play_launch.config.environment import resolve_environment
from play_launch.config.model import (
    ContainerConfig,
    ContainerType,
    Isolation,
    ProcessConfig,
    ReplayConfig,
    StopLimits,
)
from play_launch.config.names import join_full_name
from play_launch.config.node_names import NodeNames
from play_launch.config.parameter_files import ParameterFiles
from play_launch.config.resolve_nodes import resolve_composable_node, resolve_process
from play_launch.config.restart import merge_restart
from play_launch.config.schema import ContainerSection, DocumentSection, LoadingSection
from play_launch.config.stock import resolve_stock
from play_launch.config.validation import items_of, validate_mapping
from play_launch.config.yaml_tree import Mapping, Node, Sequence
from play_launch.core.crash import OnCrash
from play_launch.core.restart import RestartLimits

if TYPE_CHECKING:
    from pathlib import Path

    from play_launch.config.model import ComposableNodeConfig, ParameterFile
    from play_launch.config.report import Report

_LOADING_TIMEOUT = 10.0  # seconds
_PROBE_TIMEOUT = 60.0  # seconds
_LOADING = "composable_node_loading"


def resolve_document(
    root: Node, source: Path, content: bytes, report: Report
) -> ReplayConfig | None:
    """Return the configuration in `root`; None, or nothing to rely on, if `report` got problems."""
    document = validate_mapping(DocumentSection, root, "", report)
    if not isinstance(root, Mapping):
        return None
    environment = resolve_environment(root.value("environment"), "environment", report)
    resolver = _Resolver(source, document, root, environment, report)
    containers = resolver.containers()
    nodes = resolver.processes()
    _refuse_nothing(root, report)
    if document is None:
        return None
    stop = StopLimits()
    if document.stop is not None:
        given = document.stop
        stop = StopLimits(
            ask=stop.ask if given.ask is None else given.ask,
            sigint=stop.sigint if given.sigint is None else given.sigint,
            sigterm=stop.sigterm if given.sigterm is None else given.sigterm,
        )
    log_dir = None
    if document.log_dir is not None:
        log_dir = source.parent / os.path.expanduser(document.log_dir)  # noqa: PTH111 - never raises
    return ReplayConfig(
        name=source.stem if document.name is None else document.name,
        source=source,
        text=content,
        parameter_files=resolver.parameter_files,
        duration=document.duration,
        log_dir=log_dir,
        graph_daemon=bool(document.graph_daemon),
        environment=MappingProxyType(environment),
        stop=stop,
        containers=containers,
        nodes=nodes,
    )


def _refuse_nothing(root: Mapping, report: Report) -> None:
    lists = [root.value("containers"), root.value("nodes")]
    if all(one is None or (isinstance(one, Sequence) and not one.items) for one in lists):
        report.add(root.place, "(top level)", "nothing to start; give containers or nodes")


class _Resolver:
    def __init__(
        self,
        source: Path,
        document: DocumentSection | None,
        root: Mapping,
        environment: dict[str, str],
        report: Report,
    ) -> None:
        self._root = root
        self._environment = environment
        self._report = report
        self._names = NodeNames(report)
        self._files = ParameterFiles(source.parent, report)
        loading = document.composable_node_loading if document is not None else None
        self._loading = loading if loading is not None else LoadingSection()
        loading_node = root.value(_LOADING)
        self._restart = merge_restart(
            RestartLimits(),
            self._loading.restart,
            loading_node if isinstance(loading_node, Mapping) else root,
            _LOADING,
            report,
        )
        self._on_crash = merge_on_crash(
            OnCrash.RELOAD,
            self._loading,
            loading_node if isinstance(loading_node, Mapping) else root,
            _LOADING,
            report,
        )

    @property
    def parameter_files(self) -> tuple[ParameterFile, ...]:
        return self._files.read

    def containers(self) -> tuple[ContainerConfig, ...]:
        resolved: list[ContainerConfig] = []
        complete = True
        listed = self._root.value("containers")
        for item, path in items_of(listed, "containers", "containers", self._report):
            container = self._container(item, path)
            if container is not None:
                resolved.append(container)
            complete &= container is not None
        if complete:
            kinds = {one.container_type for one in resolved}
            if not any(kind.is_multi_threaded for kind in kinds):
                self._refuse_unread("thread_num", "mt or isolated_mt")
            if not any(kind.is_isolated for kind in kinds):
                for key in ISOLATED_KEYS:
                    self._refuse_unread(key, "isolated or isolated_mt")
            if kinds <= {ContainerType.STOCK}:
                self._refuse_unread("probe_timeout", "standard, mt, isolated or isolated_mt")
        return tuple(resolved)

    def _refuse_unread(self, key: str, kinds: str) -> None:
        """Report a key of `composable_node_loading` that no container reads."""
        loading = self._root.value(_LOADING)
        value = loading.value(key) if isinstance(loading, Mapping) else None
        if value is not None and getattr(self._loading, key) is not None:
            message = f"no container has container_type {kinds}, so nothing reads {key}"
            self._report.add(value.place, f"{_LOADING}.{key}", message)

    def processes(self) -> tuple[ProcessConfig, ...]:
        resolved: list[ProcessConfig] = []
        for item, path in items_of(self._root.value("nodes"), "nodes", "nodes", self._report):
            process = resolve_process(
                item, path, self._report, self._names, self._files, environment=self._environment
            )
            if process is not None:
                resolved.append(process)
        return tuple(resolved)

    def _container(self, node: Node, path: str) -> ContainerConfig | None:
        section = validate_mapping(ContainerSection, node, path, self._report)
        if not isinstance(node, Mapping):
            return None
        self._names.declare(node, path)
        variables = resolve_environment(
            node.value("environment"), f"{path}.environment", self._report
        )
        if section is None:
            self._composable_nodes(node, path, CrashRules(None, self._on_crash, self._restart))
            return None
        restart = merge_restart(self._restart, section.restart, node, path, self._report)
        kind = section.container_type or self._loading.container_type or ContainerType.STANDARD
        refuse_unread(ISOLATED_KEYS, kind, node, path, self._report)
        on_crash = merge_on_crash(self._on_crash, section, node, path, self._report)
        composable_nodes = self._composable_nodes(node, path, CrashRules(kind, on_crash, restart))
        thread_num = section.thread_num
        if kind.is_multi_threaded:
            thread_num = self._loading.thread_num if thread_num is None else thread_num
        elif thread_num is not None:
            place = (node.value("thread_num") or node).place
            message = (
                f"thread_num is for container_type mt and isolated_mt, this container is {kind}"
            )
            self._report.add(place, f"{path}.thread_num", message)
        stock = resolve_stock(section, kind, node, path, self._report)
        namespace = section.namespace or "/"
        timeout = section.loading_timeout or self._loading.loading_timeout or _LOADING_TIMEOUT
        probe_timeout = section.probe_timeout or self._loading.probe_timeout or _PROBE_TIMEOUT
        return ContainerConfig(
            name=section.name,
            namespace=namespace,
            full_name=join_full_name(namespace, section.name),
            container_type=kind,
            thread_num=thread_num,
            isolation=section.isolation or self._loading.isolation or Isolation.AUTO,
            core_dumps=bool(
                self._loading.core_dumps if section.core_dumps is None else section.core_dumps
            ),
            package=stock.package,
            executable=stock.executable,
            arguments=stock.arguments,
            attach=stock.attach,
            log_level=section.log_level,
            environment=MappingProxyType(self._environment | variables),
            ros_arguments=tuple(section.ros_arguments or ()),
            restart=restart,
            loading_timeout=timeout,
            probe_timeout=probe_timeout,
            composable_nodes=composable_nodes,
            line=node.place.line,
        )

    def _composable_nodes(
        self, node: Mapping, path: str, rules: CrashRules
    ) -> tuple[ComposableNodeConfig, ...]:
        listed = node.value("composable_nodes")
        where = f"{path}.composable_nodes"
        resolved: list[ComposableNodeConfig] = []
        for item, item_path in items_of(listed, where, "composable nodes", self._report):
            one = resolve_composable_node(
                item, item_path, self._report, self._names, self._files, rules=rules
            )
            if one is not None:
                resolved.append(one)
        return tuple(resolved)

"""Load a configuration file: read it, check it, and resolve it into the model."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

from msgspec.structs import replace

from play_launch.config.includes import Documents
from play_launch.config.machines import DiscoveryBy, outside_copies
from play_launch.config.model import (
    DEFAULT_TOPICS,
    BeforeCrashConfig,
    ContainerType,
    KeepConfig,
    RecordConfig,
    ReplayConfig,
    RotateConfig,
    SamplingConfig,
    SourceFile,
    StopLimits,
    WebConfig,
)
from play_launch.config.problems import ConfigError, Problem, Report
from play_launch.config.resolve.expectations import ExpectedTopics
from play_launch.config.resolve.machines import Placement, machines_at
from play_launch.config.resolve.nodes import (
    NodeNames,
    SharedContext,
    resolve_container,
    resolve_process,
)
from play_launch.config.resolve.order import StartRules
from play_launch.config.resolve.parameter_files import ParameterFileReader
from play_launch.config.resolve.policy import (
    ISOLATED_KEYS,
    GroupRules,
    Policy,
    refined_resources,
)
from play_launch.config.schema import DocumentSection, LoadingSection
from play_launch.config.section import items_of, validate_mapping, well_formed
from play_launch.config.source import Refused, path_from, read_bytes
from play_launch.config.substitutions import Inputs, InputsUsed
from play_launch.config.tree import Cursor, Mapping, Sequence, scalars_of
from play_launch.config.values import resolve_environment

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from play_launch.config.model import ContainerConfig
    from play_launch.config.sections import RecordSection, WebSection

_LOADING = "composable_node_loading"


def load_config(
    path: Path,
    inputs: Inputs | None = None,
    read: Callable[[Path], bytes | Refused] = read_bytes,
    machine: str = "",
) -> ReplayConfig:
    """Read and validate the configuration at `path`, and the files it includes and names.

    Packages that only other machines than `machine`, by default the local one, need may be missing.
    Raises ConfigError with every problem found. Reading files, by `read`, is the only effect.
    """
    content = read(path)
    if isinstance(content, Refused):
        raise ConfigError((Problem.at(content.location, "(file)", content.message),))
    return parse_config(content, path, read, inputs, machine)


def parse_config(
    content: bytes,
    source: Path,
    read: Callable[[Path], bytes | Refused] = read_bytes,
    inputs: Inputs | None = None,
    machine: str = "",
) -> ReplayConfig:
    """Validate `content` as if it had been read from `source`; raise ConfigError as above.

    `read` reads the other files.
    """
    report = Report()
    used = InputsUsed(inputs or Inputs())
    documents = Documents(report, read, used)
    root = documents.read(content, source)
    files = ParameterFileReader(report, read)
    config = (
        None
        if root is None
        else _resolve(Cursor(root, "", report), source, content, files, machine)
    )
    report.raise_if_any(str(source))
    assert config is not None
    included = tuple(SourceFile(path, text) for path, text in documents.included.items())
    return replace(config, included_files=included, taken=used.values())


def _resolve(
    at: Cursor, source: Path, content: bytes, files: ParameterFileReader, machine: str
) -> ReplayConfig | None:
    """Return the configuration; None, or nothing to rely on, if problems were reported."""
    document = validate_mapping(DocumentSection, at)
    if not isinstance(at.node, Mapping):
        return None
    environment = resolve_environment(at.value("environment"))
    names = NodeNames()
    start_rules = StartRules(names.__contains__)
    if document is None:
        loading = well_formed(LoadingSection, at.value(_LOADING))
    else:
        loading = document.composable_node_loading
    loading = loading or LoadingSection()
    groups = GroupRules(loading.cgroups, at.at_key(_LOADING).value("cgroups"))
    machines = machines_at(at.value("machines"))
    placement = Placement(at, machines, None if document is None else document.machine)
    expected = ExpectedTopics(placement)
    expected.add(at.value("expect"))
    _report_missing_packages(at, placement, machine)
    shared = SharedContext(files, environment, start_rules, names, groups, placement, expected)
    containers = _containers(at, shared, loading)
    processes = [resolve_process(item, shared) for item in items_of(at.value("nodes"), "nodes")]
    nodes = tuple(process for process in processes if process is not None)
    rules = start_rules.resolved(containers, nodes, expected.found)
    lists = [at.value("containers"), at.value("nodes")]
    if all(one is None or (isinstance(one.node, Sequence) and not one.node.items) for one in lists):
        at.problem("nothing to start; give containers or nodes")
    if document is None:
        return None
    given = document.log_dir
    log_dir = None if given is None else outside_copies(path_from(at.at_key("log_dir"), given))
    return ReplayConfig(
        name=source.stem if document.name is None else document.name,
        source=source,
        text=content,
        parameter_files=tuple(files.read),
        duration=document.duration,
        log_dir=log_dir,
        graph_daemon=bool(document.graph_daemon),
        environment=MappingProxyType(environment),
        stop=StopLimits(**document.stop.given) if document.stop else StopLimits(),
        record=_record(document.record),
        cgroups=groups.policy,
        containers=containers,
        nodes=nodes,
        start_rules=MappingProxyType(rules),
        managed=MappingProxyType(start_rules.managed(rules)),
        expect=MappingProxyType(expected.found),
        machines=MappingProxyType(machines),
        web=_web(document.web, at.at_key("web")),
        discovery=document.discovery.by if document.discovery else DiscoveryBy.MULTICAST,
    )


def _report_missing_packages(at: Cursor, placement: Placement, machine: str) -> None:
    """Report them, but for those that only entries of other machines name."""
    missing = dict(at.report.missing_packages)
    for key in ("containers", "nodes"):
        at_list = at.value(key)
        for item in () if at_list is None or not missing else at_list.elements():
            if placement.is_elsewhere(item, machine):
                for scalar in scalars_of(item.node):
                    missing.pop(scalar.location, None)
    for problem in missing.values():
        at.report.add_missing(problem)


def _containers(
    at: Cursor, shared: SharedContext, loading: LoadingSection
) -> tuple[ContainerConfig, ...]:
    at_loading = at.at_key(_LOADING)
    policy = Policy().refined(loading, at_loading)
    resources = shared.groups.defaults(policy.resources, policy.node_process)
    resources = refined_resources(resources, loading.resources, at_loading, policy.node_process)
    policy = replace(policy, resources=resources)
    items = items_of(at.value("containers"), "containers")
    resolved = [resolve_container(item, shared, policy) for item in items]
    complete = tuple(one for one in resolved if one is not None)
    if len(complete) == len(resolved):
        shared.groups.refuse_unused()
        _refuse_unread(at_loading, loading, {one.container_type for one in complete})
    return complete


def _refuse_unread(at: Cursor, loading: LoadingSection, kinds: set[ContainerType]) -> None:
    """Report keys of `composable_node_loading` that no container reads."""
    unread: dict[str, str] = {}
    if not any(kind.is_multi_threaded for kind in kinds):
        unread["thread_num"] = "mt or isolated_mt"
    if not any(kind.is_isolated for kind in kinds):
        unread |= dict.fromkeys((*ISOLATED_KEYS, "resources"), "isolated or isolated_mt")
    if kinds <= {ContainerType.STOCK}:
        unread["probe_timeout"] = "standard, mt, isolated or isolated_mt"
    for key, readers in unread.items():
        value = at.value(key)
        if value is not None and getattr(loading, key) is not None:
            message = f"no container has container_type {readers}, so nothing reads {key}"
            value.problem(message)


def _web(section: WebSection | None, at: Cursor) -> WebConfig | None:
    if section is None:
        return None
    given = section.given
    if "token_file" in given:
        given["token_file"] = path_from(at.at_key("token_file"), given["token_file"])
    return WebConfig(**{**given, "allow_host": tuple(section.allow_host or ())})


def _record(section: RecordSection | None) -> RecordConfig:
    if section is None:
        return RecordConfig()
    given = section.given
    parts = {"rotate": RotateConfig, "keep": KeepConfig, "sampling": SamplingConfig}
    for name in parts.keys() & given.keys():
        given[name] = parts[name](**given[name].given)
    given["topics"] = tuple(dict.fromkeys((*DEFAULT_TOPICS, *(section.topics or ()))))
    given["exclude"] = tuple(section.exclude or ())
    if isinstance(section.budget, dict):
        given["budget"], given["topic_budgets"] = None, tuple(section.budget.items())
    if section.before_crash is not None:
        before_crash = section.before_crash.given
        topics = tuple(before_crash.pop("topics"))
        given["before_crash"] = BeforeCrashConfig(topics, **before_crash)
    return RecordConfig(**given)

"""The keys of the configuration file: one section for each kind of mapping in it.

Raw keys get the YAML node instead of a value, because what stands there (parameters,
remappings, environment, nested lists) is looked at elsewhere, with places at hand.
Absent keys are None here; defaults are filled in when the section is resolved.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from play_launch.config import kinds
from play_launch.config.dependency import OnTimeout, UnitCondition
from play_launch.config.model import ContainerType, Isolation, MemoryDomains, Output
from play_launch.config.policies import Autostart, OnCrash, OnExit
from play_launch.config.resource_values import LIMIT_FORMS
from play_launch.config.resources import SchedulerPolicy
from play_launch.config.section import Section, merging, nested, optional, raw, required

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.config.group_limits import CpuMax
    from play_launch.config.resources import IoPriority


class DependencySection(Section):
    """One entry of `depends_on`; a string there is the `name`."""

    advice: ClassVar[Mapping[str, str]] = {
        "otherwise": "on_timeout",
        "regex": "log",
        "matches": "log",
        "path": "file",
    }

    name: str | None = optional(kinds.FILLED_TEXT)
    condition: UnitCondition | None = optional(kinds.choice(UnitCondition))
    log: str | None = optional(kinds.PATTERN)
    node: str | None = optional(kinds.GRAPH_NAME)
    topic: str | None = optional(kinds.GRAPH_NAME)
    service: str | None = optional(kinds.GRAPH_NAME)
    file: str | None = optional(kinds.FILLED_TEXT)
    timeout: float | None = optional(kinds.POSITIVE_DURATION_OR_NEVER)
    on_timeout: OnTimeout | None = optional(kinds.choice(OnTimeout))


class BackoffSection(Section):
    """`backoff`: the pause before a restart grows from `initial` to `maximum`."""

    initial: float | None = optional(kinds.POSITIVE_DURATION)
    maximum: float | None = optional(kinds.POSITIVE_DURATION)


class RestartSection(Section):
    """`restart`: at most `max_restarts` times `within` a duration."""

    max_restarts: int | None = optional(kinds.integer(0, 1_000_000))
    within: float | None = optional(kinds.POSITIVE_DURATION)
    backoff: BackoffSection | None = nested(BackoffSection)


class StopSection(Section):
    """`stop`: how long each step of stopping may take."""

    ask: float | None = optional(kinds.DURATION)
    sigint: float | None = optional(kinds.DURATION)
    sigterm: float | None = optional(kinds.DURATION)


class SchedulerSection(Section):
    """`resources.scheduler`: the policy of the kernel's scheduler."""

    policy: SchedulerPolicy = required(kinds.choice(SchedulerPolicy))
    priority: int | None = optional(kinds.integer(1, 99))


RlimitsSection: type[Section] = type(
    "RlimitsSection",
    (Section,),
    # One of them is a keyword of Python.
    {
        "__doc__": "`resources.rlimits`: limits of setrlimit(2), by their names.",
        **{name: optional(kinds.resource_limit(name)) for name in LIMIT_FORMS},
    },
)


class LimitsSection(Section):
    """Limits of a control group, wherever they stand."""

    advice: ClassVar[Mapping[str, str]] = {
        "cpu_quota": "cpu_max",
        "cpu_shares": "cpu_weight",
        "pids_limit": "pids_max",
        "memory_limit": "memory_max",
    }

    cpu_max: CpuMax | None = optional(kinds.CPU_MAX)
    cpu_weight: int | None = optional(kinds.WEIGHT)
    cpuset: tuple[int, ...] | None = optional(kinds.CPUS)
    io_weight: int | None = optional(kinds.WEIGHT)
    pids_max: float | None = optional(kinds.PIDS_MAX)
    memory_high: float | None = optional(kinds.MEMORY_LIMIT)
    memory_max: float | None = optional(kinds.MEMORY_LIMIT)


class GroupLimitsSection(LimitsSection):
    """`defaults` and entries of `per_node` of `cgroups`."""

    advice: ClassVar[Mapping[str, str]] = {**LimitsSection.advice, "cpus": "cpuset"}

    cpuset_cpus: tuple[int, ...] | None = optional(kinds.CPUS)


class ResourcesSection(LimitsSection):
    """`resources`: what a process asks of the kernel for itself."""

    advice: ClassVar[Mapping[str, str]] = {
        **LimitsSection.advice,
        "priority": "scheduler",
        "policy": "scheduler",
        "cpus": "cpu_affinity",
        "affinity": "cpu_affinity",
        "ionice": "io_priority",
        "mlockall": "lock_memory",
        "limits": "rlimits",
        "ulimit": "rlimits",
        "ulimits": "rlimits",
        "cpuset_cpus": "cpuset",
        "memory": "memory_max",
    }

    nice: int | None = optional(kinds.integer(-20, 19))
    scheduler: SchedulerSection | None = nested(SchedulerSection)
    cpu_affinity: tuple[int, ...] | None = optional(kinds.CPUS)
    io_priority: IoPriority | None = optional(kinds.IO_PRIORITY)
    oom_score_adj: int | None = optional(kinds.integer(-1000, 1000))
    lock_memory: bool | None = optional(kinds.BOOLEAN)
    rlimits: Section | None = nested(RlimitsSection)


class CgroupsSection(Section):
    """`composable_node_loading.cgroups`: whether there are control groups, and where."""

    advice: ClassVar[Mapping[str, str]] = {"path": "base_path", "nodes": "per_node"}

    enabled: bool | None = optional(kinds.BOOLEAN)
    required: bool | None = optional(kinds.BOOLEAN)
    base_path: str | None = optional(kinds.GROUP_PATH)
    defaults: GroupLimitsSection | None = nested(GroupLimitsSection)
    per_node: Any = raw()


class RotateSection(Section):
    """`record.rotate`: when the recording goes on in a new file."""

    size: float | None = optional(kinds.SIZE_OR_NEVER)
    duration: float | None = optional(kinds.POSITIVE_DURATION_OR_NEVER)


class KeepSection(Section):
    """`record.keep`: what is kept of earlier sessions."""

    sessions: int | None = optional(kinds.integer(1, 1_000_000))
    size: int | None = optional(kinds.SIZE)


class SamplingSection(Section):
    """`record.sampling`: how often processes and the machine are measured."""

    period: float | None = optional(kinds.SAMPLING_PERIOD)


class BeforeCrashSection(Section):
    """`record.before_crash`: what is kept in memory until something fails."""

    topics: list[str] = required(kinds.TOPIC_PATTERNS)
    seconds: float | None = optional(kinds.POSITIVE_DURATION)
    megabytes: int | None = optional(kinds.integer(1, 1_000_000))


class RecordSection(Section):
    """`record`: how the session is recorded."""

    sync: float | None = optional(kinds.POSITIVE_DURATION_OR_NEVER)
    rotate: RotateSection | None = nested(RotateSection)
    keep: KeepSection | None = nested(KeepSection)
    sampling: SamplingSection | None = nested(SamplingSection)
    ros: bool | None = optional(kinds.BOOLEAN)
    topics: list[str] | None = optional(kinds.list_of(kinds.TOPIC_PATTERN))
    exclude: list[str] | None = optional(kinds.list_of(kinds.TOPIC_PATTERN))
    budget: int | dict[str, float] | None = optional(kinds.BUDGET)
    before_crash: BeforeCrashSection | None = nested(BeforeCrashSection)


class LoadingSection(Section):
    """`composable_node_loading`: what holds for every container that says nothing else."""

    container_type: ContainerType | None = optional(kinds.choice(ContainerType))
    thread_num: int | None = optional(kinds.THREADS)
    isolation: Isolation | None = optional(kinds.choice(Isolation))
    memory_domains: MemoryDomains | None = optional(kinds.choice(MemoryDomains))
    core_dumps: bool | None = optional(kinds.BOOLEAN)
    auto_reload_on_crash: bool | None = optional(kinds.BOOLEAN)
    on_crash: OnCrash | None = optional(kinds.choice(OnCrash))
    loading_timeout: float | None = optional(kinds.POSITIVE_DURATION)
    probe_timeout: float | None = optional(kinds.POSITIVE_DURATION)
    resources: ResourcesSection | None = nested(ResourcesSection)
    cgroups: CgroupsSection | None = nested(CgroupsSection)
    restart: RestartSection | None = nested(RestartSection)


class DocumentSection(Section):
    """The top level of the file."""

    advice: ClassVar[Mapping[str, str]] = {
        "recording": "record",
        "env": "environment",
        "load_node": "containers",
        "composable_nodes": "they belong into an entry of containers",
    }

    version: int = required(kinds.VERSION)
    name: str | None = optional(kinds.RUN_NAME)
    duration: float | None = optional(kinds.POSITIVE_DURATION)
    log_dir: str | None = optional(kinds.FILLED_TEXT)
    graph_daemon: bool | None = optional(kinds.BOOLEAN)
    environment: Any = raw()
    stop: StopSection | None = nested(StopSection)
    record: RecordSection | None = nested(RecordSection)
    composable_node_loading: LoadingSection | None = nested(LoadingSection)
    containers: Any = raw()
    nodes: Any = raw()
    include: Any = merging()
    remove: Any = merging()


_SAME_FOR_ALL = {
    "ns": "namespace",
    "node_name": "name",
    "node_namespace": "namespace",
    "pkg": "package",
    "param": "parameters",
    "params": "parameters",
    "remap": "remappings",
    "remaps": "remappings",
    "env": "environment",
    "additional_env": "environment",
    "ros_args": "ros_arguments",
    "ros_arg": "ros_arguments",
    "exec": "executable",
    "condition": "conditions are not evaluated here; leave the entry out instead",
    "launch_prefix": "prefix",
    "launch-prefix": "prefix",
    "working_directory": "cwd",
    "workdir": "cwd",
    "delay": "start_delay",
    "nice": "resources: {nice: ...}",
    "cpu_affinity": "resources: {cpu_affinity: ...}",
    "rlimits": "resources: {rlimits: ...}",
    "cpu_max": "resources: {cpu_max: ...}",
    "cpuset": "resources: {cpuset: ...}",
    "memory_max": "resources: {memory_max: ...}",
    "cgroups": "resources: {cpu_max: ...}; cgroups belongs into composable_node_loading",
}


class ContainerSection(Section):
    """One entry of `containers`."""

    advice: ClassVar[Mapping[str, str]] = _SAME_FOR_ALL | {
        "composable_node_descriptions": "composable_nodes",
        "nodes": "composable_nodes",
        "args": "arguments",
        "parameters": "give parameters to the composable nodes; those of other nodes that are made "
        "in the process are process_parameters",
        "remappings": "give remappings to the composable nodes",
        "respawn": "containers always come back; see restart.max_restarts",
    }

    name: str = required(kinds.NODE_NAME)
    namespace: str | None = optional(kinds.NAMESPACE)
    container_type: ContainerType | None = optional(kinds.choice(ContainerType))
    thread_num: int | None = optional(kinds.THREADS)
    isolation: Isolation | None = optional(kinds.choice(Isolation))
    memory_domains: MemoryDomains | None = optional(kinds.choice(MemoryDomains))
    core_dumps: bool | None = optional(kinds.BOOLEAN)
    package: str | None = optional(kinds.PACKAGE)
    executable: str | None = optional(kinds.EXECUTABLE)
    arguments: list[str] | None = optional(kinds.list_of(kinds.TEXT))
    attach: bool | None = optional(kinds.BOOLEAN)
    process_parameters: Any = raw()
    prefix: list[str] | None = optional(kinds.PREFIX)
    cwd: str | None = optional(kinds.FILLED_TEXT)
    output: Output | None = optional(kinds.choice(Output))
    on_exit: OnExit | None = optional(kinds.choice(OnExit))
    depends_on: Any = raw()
    start_delay: float | None = optional(kinds.DURATION)
    auto_reload_on_crash: bool | None = optional(kinds.BOOLEAN)
    on_crash: OnCrash | None = optional(kinds.choice(OnCrash))
    log_level: str | None = optional(kinds.LOG_LEVEL)
    environment: Any = raw()
    ros_arguments: list[str] | None = optional(kinds.ROS_ARGUMENTS)
    resources: ResourcesSection | None = nested(ResourcesSection)
    restart: RestartSection | None = nested(RestartSection)
    loading_timeout: float | None = optional(kinds.POSITIVE_DURATION)
    probe_timeout: float | None = optional(kinds.POSITIVE_DURATION)
    composable_nodes: Any = raw()
    remove: Any = merging()


class ComposableNodeSection(Section):
    """One entry of `composable_nodes`."""

    advice: ClassVar[Mapping[str, str]] = _SAME_FOR_ALL | {
        "node_plugin": "plugin",
        "class": "plugin",
        "extra_args": "extra_arguments",
        "extra_arg": "extra_arguments",
        "environment": "nodes in one container share its environment; set it there",
        "executable": "a composable node is a class: plugin",
    }

    package: str = required(kinds.PACKAGE)
    plugin: str = required(kinds.PLUGIN)
    name: str | None = optional(kinds.OWN_NODE_NAME)
    namespace: str | None = optional(kinds.NAMESPACE)
    depends_on: Any = raw()
    start_delay: float | None = optional(kinds.DURATION)
    autostart: Autostart | None = optional(kinds.choice(Autostart))
    transition_timeout: float | None = optional(kinds.POSITIVE_DURATION_OR_NEVER)
    parameters: Any = raw()
    remappings: Any = raw()
    extra_arguments: Any = raw()
    log_level: str | None = optional(kinds.LOG_LEVEL)
    auto_reload_on_crash: bool | None = optional(kinds.BOOLEAN)
    on_crash: OnCrash | None = optional(kinds.choice(OnCrash))
    resources: ResourcesSection | None = nested(ResourcesSection)
    restart: RestartSection | None = nested(RestartSection)
    remove: Any = merging()


class ProcessSection(Section):
    """One entry of `nodes`."""

    advice: ClassVar[Mapping[str, str]] = _SAME_FOR_ALL | {
        "cmd": "command",
        "args": "arguments",
        "plugin": "a node with a plugin belongs into composable_nodes of a container",
        "respawn_delay": "restart: {backoff: {initial: ...}}",
        "respawn_max_retries": "restart: {max_restarts: ...}",
    }

    command: list[str] | None = optional(kinds.COMMAND)
    package: str | None = optional(kinds.PACKAGE)
    executable: str | None = optional(kinds.EXECUTABLE)
    name: str | None = optional(kinds.OWN_NODE_NAME)
    namespace: str | None = optional(kinds.NAMESPACE)
    parameters: Any = raw()
    process_parameters: Any = raw()
    remappings: Any = raw()
    arguments: list[str] | None = optional(kinds.list_of(kinds.TEXT))
    ros_arguments: list[str] | None = optional(kinds.ROS_ARGUMENTS)
    environment: Any = raw()
    prefix: list[str] | None = optional(kinds.PREFIX)
    depends_on: Any = raw()
    start_delay: float | None = optional(kinds.DURATION)
    autostart: Autostart | None = optional(kinds.choice(Autostart))
    transition_timeout: float | None = optional(kinds.POSITIVE_DURATION_OR_NEVER)
    cwd: str | None = optional(kinds.FILLED_TEXT)
    emulate_tty: bool | None = optional(kinds.BOOLEAN)
    output: Output | None = optional(kinds.choice(Output))
    on_exit: OnExit | None = optional(kinds.choice(OnExit))
    respawn: bool | None = optional(kinds.BOOLEAN)
    resources: ResourcesSection | None = nested(ResourcesSection)
    restart: RestartSection | None = nested(RestartSection)
    log_level: str | None = optional(kinds.LOG_LEVEL)
    remove: Any = merging()

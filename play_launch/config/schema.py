"""The keys of the configuration file: one section for each kind of mapping in it.

A key is declared once, with what checks it, its description and examples: the JSON Schema and the
checks follow from that. Raw keys get the YAML node instead of a value: parameters, remappings,
environment and nested lists are checked where their locations are known. Absent keys are None here;
defaults are filled in when the section is resolved.
"""

from __future__ import annotations

from typing import Any

from play_launch.config import kinds
from play_launch.config.dependency import OnTimeout, UnitCondition
from play_launch.config.model import (
    Autostart,
    ContainerType,
    Isolation,
    MemoryDomains,
    OnCrash,
    OnExit,
    Output,
)
from play_launch.config.resolve.record import RecordSection
from play_launch.config.resource_schema import CgroupsSection, ResourcesSection
from play_launch.config.section import Section, merging, nested, optional, raw, required


class DependencySection(Section):
    """One entry of `depends_on`; a string there is the `name`."""

    name: str | None = optional(
        kinds.FILLED_TEXT, "Full name of a container, node or process of this file.", "driver"
    )
    condition: UnitCondition | None = optional(
        kinds.choice(UnitCondition), "With name: started, loaded, active or exited.", "loaded"
    )
    log: str | None = optional(
        kinds.PATTERN,
        "With name: a line of its output matches this regular expression.",
        "streaming at",
    )
    node: str | None = optional(kinds.GRAPH_NAME, "This node is in the ROS graph.", "/map_server")
    topic: str | None = optional(kinds.GRAPH_NAME, "This topic has a publisher.", "/scan")
    service: str | None = optional(
        kinds.GRAPH_NAME, "This service is offered.", "/map_server/load_map"
    )
    file: str | None = optional(kinds.FILLED_TEXT, "This file exists.", "/dev/ttyUSB0")
    timeout: float | None = optional(
        kinds.POSITIVE_DURATION_OR_NEVER,
        "Duration to wait for it, or never. By default never.",
        "10 s",
    )
    on_timeout: OnTimeout | None = optional(
        kinds.choice(OnTimeout),
        "What follows if it does not come in time: fail or start. By default fail.",
        "start",
    )


class BackoffSection(Section):
    """`backoff`: the pause before a restart grows from `initial` to `maximum`."""

    initial: float | None = optional(
        kinds.POSITIVE_DURATION, "Duration of the first pause. By default 100 ms.", "100 ms"
    )
    maximum: float | None = optional(
        kinds.POSITIVE_DURATION, "Duration of the longest pause. By default 30 s.", "30 s"
    )


class RestartSection(Section):
    """`restart`: at most `max_restarts` times `within` a duration."""

    max_restarts: int | None = optional(
        kinds.integer(0, 1_000_000),
        "How often it is brought back within the time; 0 is never. By default 5.",
        5,
    )
    within: float | None = optional(
        kinds.POSITIVE_DURATION, "Duration in which restarts are counted. By default 60 s.", "60 s"
    )
    backoff: BackoffSection | None = nested(
        BackoffSection,
        "The pause before a restart, which grows.",
        {"initial": "100 ms", "maximum": "30 s"},
    )


class StopSection(Section):
    """`stop`: how long each step of stopping may take."""

    ask: float | None = optional(
        kinds.DURATION, "Duration after it was asked, before SIGINT. By default 3 s.", "3 s"
    )
    sigint: float | None = optional(
        kinds.DURATION, "Duration after SIGINT, before SIGTERM. By default 2 s.", "2 s"
    )
    sigterm: float | None = optional(
        kinds.DURATION, "Duration after SIGTERM, before SIGKILL. By default 2 s.", "2 s"
    )


_CONTAINER_TYPE = optional(
    kinds.choice(ContainerType),
    "standard: all nodes in one process, one thread. mt: several threads. isolated, "
    "isolated_mt: each node a process of its own in shared memory. stock: another program with "
    "ROS's composition services.",
    "isolated",
)
_THREAD_NUM = optional(
    kinds.THREADS, "Threads of the executor, 1 to 1024; for mt and isolated_mt.", 4
)
_ISOLATION = optional(
    kinds.choice(Isolation),
    "How isolated nodes become processes: auto, shared_memory or process.",
    "auto",
)
_MEMORY_DOMAINS = optional(
    kinds.choice(MemoryDomains),
    "Whether what isolated nodes have in play_launch::private_memory() is protected from their "
    "neighbours: off, auto (as far as the machine can) or required.",
    "auto",
)
_CORE_DUMPS = optional(kinds.BOOLEAN, "Whether isolated nodes that crash dump core.", True)
_AUTO_RELOAD_ON_CRASH = optional(
    kinds.BOOLEAN, "true is short for on_crash: reload, false for on_crash: ignore.", True
)
_ON_CRASH = optional(
    kinds.choice(OnCrash),
    "What follows when an isolated node crashes alone: reload, ignore, stop_container or shutdown.",
    "reload",
)
_LOADING_TIMEOUT = optional(
    kinds.POSITIVE_DURATION,
    "Duration after which a node that is still loading is asked about. By default 10 s.",
    "10 s",
)
_PROBE_TIMEOUT = optional(
    kinds.POSITIVE_DURATION,
    "Longest duration for which a scratch process may load a library. By default 60 s.",
    "60 s",
)
_RESTART = nested(
    RestartSection,
    "How often it is brought back, and after which pauses.",
    {"max_restarts": 5, "within": "60 s"},
)
_NAMESPACE = optional(
    kinds.NAMESPACE,
    "Namespace, made of names with / between them. By default the root, or the component's own.",
    "/sensing",
    "/sensing/lidar",
)
_PROCESS_PARAMETERS = raw(
    "Parameters for all nodes of the process, by their full names or patterns: parameter files, "
    "and mappings of such names to parameters, of which later ones win.",
    {"/local_costmap/local_costmap": {"width": 3}},
    ["params/nav2.yaml", {"/**": {"use_sim_time": True}}],
)
_PREFIX = optional(
    kinds.PREFIX,
    "Words before the program in the command line, split as a shell does.",
    "gdb -ex run --args",
)
_CWD = optional(
    kinds.FILLED_TEXT,
    "Working directory; a relative path starts at the folder of this file.",
    "data",
)
_OUTPUT = optional(
    kinds.choice(Output), "Where what it writes goes: screen, log or both. By default both.", "log"
)
_DEPENDS_ON = raw(
    "What it waits for: names of containers, nodes and processes, or mappings with a condition.",
    ["driver"],
    [{"topic": "/scan", "timeout": "10 s"}],
)
_START_DELAY = optional(
    kinds.DURATION, "Duration to wait once everything is there that it depends on.", "500 ms"
)
_LOG_LEVEL = optional(
    kinds.LOG_LEVEL, "Logging severity: debug, info, warn, error or fatal.", "warn"
)
_ENVIRONMENT = raw(
    "Environment variables, names to strings.",
    {"ROS_DOMAIN_ID": "5", "RCUTILS_COLORIZED_OUTPUT": "1"},
)
_ROS_ARGUMENTS = optional(
    kinds.ROS_ARGUMENTS, "Strings that are put after --ros-args.", ["--log-level", "rcl:=warn"]
)
_RESOURCES = nested(
    ResourcesSection,
    "What its process asks of the kernel: scheduling, CPUs, I/O priority, limits, control group.",
    {"nice": 5},
    {"scheduler": {"policy": "fifo", "priority": 50}, "cpu_affinity": [2, 3]},
)
_AUTOSTART = optional(
    kinds.choice(Autostart),
    "How far a managed (lifecycle) node is brought: configure or activate.",
    "activate",
)
_TRANSITION_TIMEOUT = optional(
    kinds.POSITIVE_DURATION_OR_NEVER,
    "Duration for each transition of autostart, or never. By default 1 min.",
    "30 s",
)
_PARAMETERS = raw(
    "Parameters: a mapping, or a list of mappings and parameter files, of which later ones win.",
    {"rate": 10.0},
    ["params/common.yaml", {"rate": 20.0}],
)
_REMAPPINGS = raw(
    "Remappings of topics and services: a mapping, or a list of from:=to.",
    {"chatter": "/sensing/chatter"},
    ["image:=~/image"],
)


class LoadingSection(Section):
    """`composable_node_loading`: defaults for all containers."""

    container_type: ContainerType | None = _CONTAINER_TYPE
    thread_num: int | None = _THREAD_NUM
    isolation: Isolation | None = _ISOLATION
    memory_domains: MemoryDomains | None = _MEMORY_DOMAINS
    core_dumps: bool | None = _CORE_DUMPS
    auto_reload_on_crash: bool | None = _AUTO_RELOAD_ON_CRASH
    on_crash: OnCrash | None = _ON_CRASH
    loading_timeout: float | None = _LOADING_TIMEOUT
    probe_timeout: float | None = _PROBE_TIMEOUT
    resources: ResourcesSection | None = nested(
        ResourcesSection, "Defaults for the resources of isolated nodes.", {"nice": 5}
    )
    cgroups: CgroupsSection | None = nested(
        CgroupsSection,
        "Control groups (cgroup v2): whether there are any, where, and limits of nodes.",
        {"enabled": True},
        {"base_path": "/sys/fs/cgroup/play_launch", "required": True},
    )
    restart: RestartSection | None = _RESTART


class DocumentSection(Section):
    """The top level of the file."""

    version: int = required(kinds.VERSION, "Version of this format.", 1)
    name: str | None = optional(
        kinds.RUN_NAME,
        "Name of the run; its recording is named after it. By default the name of the file.",
        "robot",
    )
    duration: float | None = optional(
        kinds.POSITIVE_DURATION,
        "Duration after which the system is stopped. By default it runs until Ctrl-C.",
        "10 s",
        "2 min",
    )
    log_dir: str | None = optional(
        kinds.FILLED_TEXT,
        "Folder for recordings; a relative path starts at the folder of this file.",
        "~/recordings",
    )
    graph_daemon: bool | None = optional(
        kinds.BOOLEAN,
        "Whether the graph daemon runs beside the nodes, and what it sees is recorded.",
        True,
    )
    environment: Any = raw(
        "Environment variables for every container and process, names to strings.",
        {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
    )
    stop: StopSection | None = nested(
        StopSection,
        "How long each step of stopping may take before the next one is taken.",
        {"ask": "3 s", "sigint": "2 s", "sigterm": "2 s"},
    )
    record: RecordSection | None = nested(
        RecordSection, "How the session is recorded.", {"topics": ["/tf", "/lidar/*"]}
    )
    composable_node_loading: LoadingSection | None = nested(
        LoadingSection,
        "Defaults for all containers.",
        {"container_type": "isolated"},
    )
    containers: Any = raw(
        "Component containers and their nodes. In a file that includes others, an entry is "
        "merged with the included one of the same name.",
        [{"name": "sensing"}],
    )
    nodes: Any = raw(
        "Ordinary processes: package and executable, or a command. Merged by name, too.",
        [{"package": "demo_nodes_py", "executable": "listener", "name": "listener"}],
    )
    include: Any = merging(
        "Other configuration files, which this one is merged over. Relative paths start at the "
        "folder of this file.",
        "base.yaml",
        [{"file": "camera.yaml", "arguments": {"side": "left"}}],
    )


class ContainerSection(Section):
    """One entry of `containers`."""

    name: str = required(
        kinds.NODE_NAME,
        "A node name: letters, digits and _, not beginning with a digit. Containers are merged "
        "by it.",
        "sensing",
    )
    namespace: str | None = _NAMESPACE
    container_type: ContainerType | None = _CONTAINER_TYPE
    thread_num: int | None = _THREAD_NUM
    isolation: Isolation | None = _ISOLATION
    memory_domains: MemoryDomains | None = _MEMORY_DOMAINS
    core_dumps: bool | None = _CORE_DUMPS
    package: str | None = optional(
        kinds.PACKAGE,
        "Package with the program of a stock container. By default rclcpp_components.",
        "rclcpp_components",
    )
    executable: str | None = optional(
        kinds.EXECUTABLE,
        "Program of a stock container. By default component_container.",
        "component_container_mt",
    )
    arguments: list[str] | None = optional(
        kinds.list_of(kinds.TEXT), "Strings for the program of a stock container.", ["--verbose"]
    )
    attach: bool | None = optional(
        kinds.BOOLEAN, "Whether to attach to a stock container that is already running.", True
    )
    process_parameters: Any = _PROCESS_PARAMETERS
    prefix: list[str] | None = _PREFIX
    cwd: str | None = _CWD
    output: Output | None = _OUTPUT
    on_exit: OnExit | None = optional(
        kinds.choice(OnExit),
        "Reaction when it exits unasked: restart or shutdown. By default restart.",
        "shutdown",
    )
    depends_on: Any = _DEPENDS_ON
    start_delay: float | None = _START_DELAY
    auto_reload_on_crash: bool | None = _AUTO_RELOAD_ON_CRASH
    on_crash: OnCrash | None = _ON_CRASH
    log_level: str | None = _LOG_LEVEL
    environment: Any = _ENVIRONMENT
    ros_arguments: list[str] | None = _ROS_ARGUMENTS
    resources: ResourcesSection | None = _RESOURCES
    restart: RestartSection | None = _RESTART
    loading_timeout: float | None = _LOADING_TIMEOUT
    probe_timeout: float | None = _PROBE_TIMEOUT
    composable_nodes: Any = raw(
        "Nodes that are loaded into the container. Merged by name with included ones.",
        [{"package": "demo", "plugin": "demo::Talker", "name": "talker"}],
    )


class ComposableNodeSection(Section):
    """One entry of `composable_nodes`."""

    package: str = required(kinds.PACKAGE, "Package that has the component.", "play_launch_demo")
    plugin: str = required(kinds.PLUGIN, "Class of the component.", "play_launch_demo::Talker")
    name: str | None = optional(
        kinds.OWN_NODE_NAME,
        "A node name: letters, digits and _, not beginning with a digit. Without it, the "
        "component keeps its own.",
        "talker",
    )
    namespace: str | None = _NAMESPACE
    depends_on: Any = _DEPENDS_ON
    start_delay: float | None = _START_DELAY
    autostart: Autostart | None = _AUTOSTART
    transition_timeout: float | None = _TRANSITION_TIMEOUT
    parameters: Any = _PARAMETERS
    remappings: Any = _REMAPPINGS
    extra_arguments: Any = raw(
        "Parameters for the container; no files.", {"use_intra_process_comms": True}
    )
    log_level: str | None = _LOG_LEVEL
    auto_reload_on_crash: bool | None = _AUTO_RELOAD_ON_CRASH
    on_crash: OnCrash | None = _ON_CRASH
    resources: ResourcesSection | None = _RESOURCES
    restart: RestartSection | None = _RESTART


class ProcessSection(Section):
    """One entry of `nodes`."""

    command: list[str] | None = optional(
        kinds.COMMAND, "The program and its arguments.", ["python3", "my_node.py"]
    )
    package: str | None = optional(kinds.PACKAGE, "Package with the executable.", "demo_nodes_py")
    executable: str | None = optional(
        kinds.EXECUTABLE, "Name of the executable, without folders.", "listener"
    )
    name: str | None = optional(
        kinds.OWN_NODE_NAME,
        "A node name: letters, digits and _, not beginning with a digit. With command only a "
        "label.",
        "listener",
    )
    namespace: str | None = _NAMESPACE
    parameters: Any = _PARAMETERS
    process_parameters: Any = _PROCESS_PARAMETERS
    remappings: Any = _REMAPPINGS
    arguments: list[str] | None = optional(
        kinds.list_of(kinds.TEXT), "Strings for the executable; not with command.", ["--fast"]
    )
    ros_arguments: list[str] | None = _ROS_ARGUMENTS
    environment: Any = _ENVIRONMENT
    prefix: list[str] | None = _PREFIX
    depends_on: Any = _DEPENDS_ON
    start_delay: float | None = _START_DELAY
    autostart: Autostart | None = _AUTOSTART
    transition_timeout: float | None = _TRANSITION_TIMEOUT
    cwd: str | None = _CWD
    emulate_tty: bool | None = optional(
        kinds.BOOLEAN, "Whether its output goes to a terminal. By default false.", True
    )
    output: Output | None = _OUTPUT
    on_exit: OnExit | None = optional(
        kinds.choice(OnExit),
        "Reaction when it exits unasked: ignore, restart or shutdown. By default ignore.",
        "restart",
    )
    resources: ResourcesSection | None = _RESOURCES
    restart: RestartSection | None = nested(
        RestartSection, "Restart limits; only with on_exit: restart.", {"max_restarts": 5}
    )
    log_level: str | None = _LOG_LEVEL

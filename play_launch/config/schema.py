"""The keys of the configuration file: one section for each kind of mapping in it.

A key is declared once, with what checks it, its description and examples: the JSON Schema and the
checks follow from that. Raw keys get the YAML node instead of a value: parameters, remappings,
environment and lists of sections are checked where their locations are known. Absent keys are None
here; defaults are filled in when the section is resolved.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.config import kinds
from play_launch.config.kinds import STRING_FORM, any_of, list_form, mapping_form
from play_launch.config.model import (
    Autostart,
    ContainerType,
    Isolation,
    MemoryDomains,
    OnCrash,
    OnExit,
    Output,
)
from play_launch.config.section import (
    ConfigSection,
    listed,
    mapped,
    nested,
    optional,
    raw,
    required,
)
from play_launch.config.sections import (
    CgroupsSection,
    DependencySection,
    DiscoverySection,
    ExpectationSection,
    MachineSection,
    RecordSection,
    ResourcesSection,
    RestartSection,
    StopSection,
    WebSection,
)

if TYPE_CHECKING:
    from play_launch.config.section import JsonSchema

_VARIABLES: Final = mapping_form(STRING_FORM)
_VALUES: Final[JsonSchema] = {"type": "object"}
_OF_NODES: Final = mapping_form(_VALUES)
_REMAPPING: Final = any_of(
    STRING_FORM,
    list_form(STRING_FORM, least=2),
    {"type": "object", "required": ["from", "to"]},
)
_INCLUSION: Final[JsonSchema] = {
    "type": "object",
    "required": ["file"],
    "properties": {
        "file": STRING_FORM,
        "arguments": mapping_form(kinds.SCALAR_FORM),
        "machine": STRING_FORM,
    },
    "additionalProperties": False,
}
_FILE: Final = any_of(STRING_FORM, _INCLUSION)


class UnitSection(ConfigSection):
    """Keys of all that is started or loaded."""

    namespace = optional(
        kinds.NAMESPACE,
        "Namespace: names with / between them. By default the root, or the component's own.",
        "/sensing",
        "/sensing/lidar",
    )
    depends_on = listed(
        DependencySection,
        "What it waits for: names of containers, nodes and processes, or mappings with conditions.",
        ["driver"],
        [{"topic": "/scan", "timeout": "10 s"}],
        or_name=True,
    )
    start_delay = optional(
        kinds.DURATION, "Duration to wait once everything is there that it depends on.", "500 ms"
    )
    log_level = optional(
        kinds.LOG_LEVEL,
        "Logging severity: debug, info, warn, error or fatal. By default that of the container, "
        "else ROS's own.",
        "warn",
    )
    resources = nested(
        ResourcesSection,
        "What its process requests: scheduling, CPUs, I/O priority, limits, control group.",
        {"nice": 5},
        {"scheduler": {"policy": "fifo", "priority": 50}, "cpu_affinity": [2, 3]},
    )


class NodeSection(ConfigSection):
    """Keys of what is one node."""

    autostart = optional(
        kinds.choice(Autostart),
        "How far a managed (lifecycle) node is brought: configure or activate. By default it is "
        "left alone.",
        "activate",
    )
    transition_timeout = optional(
        kinds.POSITIVE_DURATION_OR_NEVER,
        "Duration for each transition of autostart, or never. By default 1 min.",
        "30 s",
    )
    parameters = raw(
        any_of(_VALUES, list_form(any_of(STRING_FORM, _VALUES))),
        "Parameters: a mapping, or a list of mappings and parameter files; later ones win.",
        {"rate": 10.0},
        ["params/common.yaml", {"rate": 20.0}],
    )
    remappings = raw(
        any_of(_VARIABLES, list_form(_REMAPPING)),
        "Remappings of topics and services: a mapping, or a list of from:=to.",
        {"chatter": "/sensing/chatter"},
        ["image:=~/image"],
    )
    expect = mapped(
        ExpectationSection,
        "What is expected of topics, named as by the node.",
        {"scan": {"min_rate": "8 Hz"}},
    )


class MemberSection(UnitSection):
    """Keys of what has a process of its own."""

    machine = optional(
        kinds.FILLED_TEXT,
        "The one of machines that it runs on. By default that of the file.",
        "vision",
    )
    process_parameters = raw(
        any_of(_OF_NODES, list_form(any_of(STRING_FORM, _OF_NODES))),
        "Parameters for all nodes of the process, by their full names or patterns: parameter "
        "files, and mappings of such names to parameters, of which later ones win.",
        {"/local_costmap/local_costmap": {"width": 3}},
        ["params/nav2.yaml", {"/**": {"use_sim_time": True}}],
    )
    prefix = optional(
        kinds.PREFIX,
        "Words before the program in the command line, split as a shell does.",
        "gdb -ex run --args",
    )
    cwd = optional(
        kinds.FILLED_TEXT,
        "Working directory; a relative path starts at the folder of this file. By default that of "
        "play-launch.",
        "data",
    )
    output = optional(
        kinds.choice(Output),
        "Where what it writes goes: screen, log or both. By default both.",
        "log",
    )
    environment = raw(
        _VARIABLES,
        "Environment variables, names to strings, over those at the top.",
        {"ROS_DOMAIN_ID": "5", "RCUTILS_COLORIZED_OUTPUT": "1"},
    )
    ros_arguments = optional(
        kinds.ROS_ARGUMENTS, "Strings that are put after --ros-args.", ["--log-level", "rcl:=warn"]
    )


class CrashSection(ConfigSection):
    """Keys about nodes that crash."""

    auto_reload_on_crash = optional(
        kinds.BOOLEAN, "true is short for on_crash: reload, false for on_crash: ignore.", True
    )
    on_crash = optional(
        kinds.choice(OnCrash),
        "Reaction when an isolated node crashes alone: reload, ignore, stop_container or shutdown. "
        "By default reload.",
        "reload",
    )
    restart = nested(
        RestartSection,
        "How often it is brought back, and after which pauses.",
        {"max_restarts": 5, "within": "60 s"},
    )


class ContainersSection(CrashSection):
    """Keys of containers that have defaults for all of them."""

    container_type = optional(
        kinds.choice(ContainerType),
        "standard: all nodes in one process, one thread. mt: several threads. isolated, "
        "isolated_mt: each node a process of its own in shared memory. stock: another program with "
        "ROS's composition services. By default standard.",
        "isolated",
    )
    thread_num = optional(
        kinds.THREADS,
        "Threads of the executor, 1 to 1024; for mt and isolated_mt, there of each node.",
        4,
    )
    isolation = optional(
        kinds.choice(Isolation),
        "How isolated nodes become processes: auto, shared_memory or process. By default auto.",
        "auto",
    )
    memory_domains = optional(
        kinds.choice(MemoryDomains),
        "Whether what isolated nodes have in play_launch::private_memory() is protected from their "
        "neighbours: off, auto (as far as the machine can) or required. By default off.",
        "auto",
    )
    core_dumps = optional(
        kinds.BOOLEAN, "Whether isolated nodes that crash dump core. By default false.", True
    )
    consolidate = optional(
        kinds.BOOLEAN,
        "Whether isolated containers whose processes would be alike have one together. By default "
        "false.",
        True,
    )
    loading_timeout = optional(
        kinds.POSITIVE_DURATION,
        "Duration after which a node that is still loading is asked about. By default 10 s.",
        "10 s",
    )
    probe_timeout = optional(
        kinds.POSITIVE_DURATION,
        "Longest duration for which a scratch process may load a library. By default 60 s.",
        "60 s",
    )


class LoadingSection(ContainersSection):
    """`composable_node_loading`: defaults for all containers."""

    resources = nested(
        ResourcesSection, "Defaults for the resources of isolated nodes.", {"nice": 5}
    )
    cgroups = nested(
        CgroupsSection,
        "Control groups (cgroup v2): whether there are any, where, and limits of nodes.",
        {"enabled": True},
        {"base_path": "/sys/fs/cgroup/play_launch", "required": True},
    )


class ComposableNodeSection(UnitSection, NodeSection, CrashSection):
    """One entry of `composable_nodes`."""

    package = required(kinds.PACKAGE, "Package that has the component.", "play_launch_demo")
    plugin = required(kinds.PLUGIN, "Class of the component.", "play_launch_demo::Talker")
    name = optional(
        kinds.OWN_NODE_NAME,
        "A node name: letters, digits and _, not beginning with a digit. Without it, the "
        "component keeps its own.",
        "talker",
    )
    extra_arguments = raw(
        any_of(_VALUES, list_form(_VALUES)),
        "Parameters for the container; no files.",
        {"use_intra_process_comms": True},
    )


class ContainerSection(MemberSection, ContainersSection):
    """One entry of `containers`."""

    name = required(
        kinds.NODE_NAME,
        "A node name: letters, digits and _, not beginning with a digit. Containers are merged "
        "by it.",
        "sensing",
    )
    package = optional(
        kinds.PACKAGE,
        "Package with the program of a stock container. By default rclcpp_components.",
        "rclcpp_components",
    )
    executable = optional(
        kinds.EXECUTABLE,
        "Program of a stock container. By default component_container.",
        "component_container_mt",
    )
    arguments = optional(
        kinds.list_of(kinds.TEXT), "Strings for the program of a stock container.", ["--verbose"]
    )
    attach = optional(
        kinds.BOOLEAN,
        "Whether to attach to a stock container that is already running. By default false.",
        True,
    )
    on_exit = optional(
        kinds.choice(OnExit),
        "Reaction when it exits unasked: restart or shutdown. By default restart.",
        "shutdown",
    )
    composable_nodes = listed(
        ComposableNodeSection,
        "Nodes that are loaded into the container. Merged by name with included ones.",
        [{"package": "demo", "plugin": "demo::Talker", "name": "talker"}],
    )


class ProcessSection(MemberSection, NodeSection):
    """One entry of `nodes`."""

    command = optional(kinds.COMMAND, "The program and its arguments.", ["python3", "my_node.py"])
    package = optional(kinds.PACKAGE, "Package with the executable.", "demo_nodes_py")
    executable = optional(kinds.EXECUTABLE, "Name of the executable, without folders.", "listener")
    name = optional(
        kinds.OWN_NODE_NAME,
        "A node name: letters, digits and _, not beginning with a digit. With command only a "
        "label.",
        "listener",
    )
    arguments = optional(
        kinds.list_of(kinds.TEXT), "Strings for the executable; not with command.", ["--fast"]
    )
    emulate_tty = optional(
        kinds.BOOLEAN, "Whether its output goes to a terminal. By default false.", True
    )
    on_exit = optional(
        kinds.choice(OnExit),
        "Reaction when it exits unasked: ignore, restart or shutdown. By default ignore.",
        "restart",
    )
    restart = nested(
        RestartSection, "Restart limits; only with on_exit: restart.", {"max_restarts": 5}
    )


class DocumentSection(ConfigSection):
    """The top level of the file."""

    version = required(kinds.VERSION, "Version of this format.", 1)
    name = optional(
        kinds.RUN_NAME,
        "Name of the run; its recording is named after it. By default the name of the file.",
        "robot",
    )
    duration = optional(
        kinds.POSITIVE_DURATION,
        "Duration after which the system is stopped. By default it runs until Ctrl-C.",
        "10 s",
        "2 min",
    )
    log_dir = optional(
        kinds.FILLED_TEXT,
        "Folder for recordings; a relative path starts at the folder of this file.",
        "~/recordings",
    )
    graph_daemon = optional(
        kinds.BOOLEAN,
        "Whether the graph daemon runs beside the nodes, and what it sees is recorded. By default "
        "false.",
        True,
    )
    web = nested(WebSection, "The page that runs beside the system.", {"port": 8081})
    environment = raw(
        _VARIABLES,
        "Environment variables for every container and process, names to strings.",
        {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
    )
    stop = nested(
        StopSection,
        "How long each step of stopping may take before the next one is taken.",
        {"ask": "3 s", "sigint": "2 s", "sigterm": "2 s"},
    )
    record = nested(RecordSection, "How the session is recorded.", {"topics": ["/tf", "/lidar/*"]})
    expect = mapped(
        ExpectationSection,
        "What is expected of topics, by name: measured, reported when it breaks, and waited for.",
        {"/scan": {"min_rate": "8 Hz", "max_gap": "500 ms", "publishers": 1}},
    )
    composable_node_loading = nested(
        LoadingSection,
        "Defaults for all containers.",
        {"container_type": "isolated"},
    )
    machines = mapped(
        MachineSection,
        "Computers that run the system together, by name.",
        {"main": {"local": True}, "vision": {"ssh": "vision"}},
    )
    machine = optional(
        kinds.FILLED_TEXT,
        "The one of machines for entries without machine. By default the local one.",
        "main",
    )
    discovery = nested(
        DiscoverySection,
        "How nodes of several machines find each other. By default by multicast.",
        {"by": "peers"},
    )
    containers = listed(
        ContainerSection,
        "Component containers and their nodes. In a file that includes others, an entry is "
        "merged with the included one of the same name.",
        [{"name": "sensing"}],
    )
    nodes = listed(
        ProcessSection,
        "Ordinary processes: package and executable, or a command. Merged by name, too.",
        [{"package": "demo_nodes_py", "executable": "listener", "name": "listener"}],
    )
    include = raw(
        any_of(STRING_FORM, _INCLUSION, list_form(_FILE)),
        "Other configuration files, which this one is merged over. Relative paths start at the "
        "folder of this file.",
        "base.yaml",
        [{"file": "camera.yaml", "arguments": {"side": "left"}}],
        merging=True,
    )

"""What each key is, in the words that an editor shows, with examples.

A key of `schema` that has no entry here fails a test, as does an entry without its key, and an
example that the key refuses.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

from play_launch.config.resource_values import LIMIT_FORMS

if TYPE_CHECKING:
    from collections.abc import Mapping


class About(NamedTuple):
    """One or two sentences, and values as they are written in the file."""

    description: str
    examples: tuple[Any, ...] = ()


_DEFAULT_OF_ALL: Final = "By default that of composable_node_loading."
_NAME: Final = "A node name: letters, digits and _, not beginning with a digit."
_NAMESPACE: Final = About(
    "Namespace, made of names with / between them. By default the root, or the component's own.",
    ("/sensing", "/sensing/lidar"),
)
_LOG_LEVEL: Final = About("Logging severity: debug, info, warn, error or fatal.", ("warn",))
_ENVIRONMENT: Final = About(
    "Environment variables, names to strings.",
    ({"ROS_DOMAIN_ID": "5", "RCUTILS_COLORIZED_OUTPUT": "1"},),
)
_ROS_ARGUMENTS: Final = About(
    "Strings that are put after --ros-args.", (["--log-level", "rcl:=warn"],)
)
_PARAMETERS: Final = About(
    "Parameters: a mapping, or a list of mappings and parameter files, of which later ones win.",
    ({"rate": 10.0}, ["params/common.yaml", {"rate": 20.0}]),
)
_PROCESS_PARAMETERS: Final = About(
    "Parameters for all nodes of the process, by their full names or patterns: parameter files, "
    "and mappings of such names to parameters, of which later ones win.",
    (
        {"/local_costmap/local_costmap": {"width": 3}},
        ["params/nav2.yaml", {"/**": {"use_sim_time": True}}],
    ),
)
_REMAPPINGS: Final = About(
    "Remappings of topics and services: a mapping, or a list of from:=to.",
    ({"chatter": "/sensing/chatter"}, ["image:=~/image"]),
)
_REMOVE: Final = About(
    "In a file that includes others: true takes this included entry out, a list only some of its "
    "keys.",
    (True, ["parameters", "environment.DEBUG"]),
)
_RESTART: Final = About(
    "How often it is brought back, and after which pauses.",
    ({"max_restarts": 5, "within": "60 s"},),
)
_CONTAINER_TYPE: Final = (
    "standard: all nodes in one process, one thread. mt: several threads. isolated, isolated_mt: "
    "each node a process of its own in shared memory. stock: another program with ROS's "
    "composition services."
)
_THREADS: Final = "Threads of the executor, 1 to 1024; for mt and isolated_mt."
_ISOLATION: Final = "How isolated nodes become processes: auto, shared_memory or process."
_MEMORY_DOMAINS: Final = (
    "Whether what isolated nodes have in play_launch::private_memory() is protected from their "
    "neighbours: off, auto (as far as the machine can) or required."
)
_CORE_DUMPS: Final = "Whether isolated nodes that crash dump core."
_PREFIX: Final = About(
    "Words before the program in the command line, split as a shell does.", ("gdb -ex run --args",)
)
_CWD: Final = About(
    "Working directory; a relative path starts at the folder of this file.", ("data",)
)
_OUTPUT: Final = About("Where what it writes goes: screen, log or both. By default both.", ("log",))
_DEPENDS_ON: Final = About(
    "What it waits for: names of containers, nodes and processes, or mappings with a condition.",
    (["driver"], [{"topic": "/scan", "timeout": "10 s"}]),
)
_START_DELAY: Final = About(
    "Duration to wait once everything is there that it depends on.", ("500 ms",)
)
_AUTOSTART: Final = About(
    "How far a managed (lifecycle) node is brought: configure or activate.", ("activate",)
)
_TRANSITION_TIMEOUT: Final = About(
    "Duration for each transition of autostart, or never. By default 1 min.", ("30 s",)
)
_AUTO_RELOAD: Final = "true is short for on_crash: reload, false for on_crash: ignore."
_ON_CRASH: Final = (
    "What follows when an isolated node crashes alone: reload, ignore, stop_container or shutdown."
)
_LOADING_TIMEOUT: Final = "Duration after which a node that is still loading is asked about."
_PROBE_TIMEOUT: Final = "Longest duration for which a scratch process may load a library."

_RESOURCES: Final = About(
    "What its process asks of the kernel: scheduling, CPUs, I/O priority, limits, control group.",
    ({"nice": 5}, {"scheduler": {"policy": "fifo", "priority": 50}, "cpu_affinity": [2, 3]}),
)

_GROUP_LIMITS: Final = {
    "cpu_max": About(
        "CPU time of its control group: a share of one CPU, a quota and a period in microseconds, "
        "or max.",
        ("50 %", "200 %", "5000 10000"),
    ),
    "cpu_weight": About(
        "Share of the CPU time where several control groups want it, 1 to 10000; others have 100.",
        (200,),
    ),
    "cpuset": About("CPUs of its control group.", ("0-3", [2, 3])),
    "io_weight": About(
        "Share of the disk accesses where several control groups want them, 1 to 10000.", (50,)
    ),
    "pids_max": About("Processes and threads in its control group, or max.", (64,)),
    "memory_high": About(
        "Memory from which on its control group is slowed down; not for a node that shares memory.",
        ("400 MB",),
    ),
    "memory_max": About(
        "Memory at which its control group is killed; not for a node that shares memory.",
        ("512 MB", "max"),
    ),
}

TEXTS: Final[Mapping[str, Mapping[str, About]]] = {
    "DocumentSection": {
        "version": About("Version of this format.", (1,)),
        "name": About(
            "Name of the run; its recording is named after it. By default the name of the file.",
            ("robot",),
        ),
        "duration": About(
            "Duration after which the system is stopped. By default it runs until Ctrl-C.",
            ("10 s", "2 min"),
        ),
        "graph_daemon": About(
            "Whether the graph daemon runs beside the nodes, and what it sees is recorded.", (True,)
        ),
        "log_dir": About(
            "Folder for recordings; a relative path starts at the folder of this file.",
            ("~/recordings",),
        ),
        "environment": About(
            "Environment variables for every container and process, names to strings.",
            ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},),
        ),
        "stop": About(
            "How long each step of stopping may take before the next one is taken.",
            ({"ask": "3 s", "sigint": "2 s", "sigterm": "2 s"},),
        ),
        "record": About("How the session is recorded.", ({"topics": ["/tf", "/lidar/*"]},)),
        "composable_node_loading": About(
            "What holds for every container that says nothing else.",
            ({"container_type": "isolated"},),
        ),
        "containers": About(
            "Component containers and their nodes. In a file that includes others, an entry is "
            "merged with the included one of the same name.",
            ([{"name": "sensing"}],),
        ),
        "nodes": About(
            "Ordinary processes: package and executable, or a command. Merged by name, too.",
            ([{"package": "demo_nodes_py", "executable": "listener", "name": "listener"}],),
        ),
        "include": About(
            "Other configuration files, which this one is merged over. Relative paths start at the "
            "folder of this file.",
            ("base.yaml", [{"file": "camera.yaml", "arguments": {"side": "left"}}]),
        ),
        "remove": About(
            "Keys of included files that do not hold here.", (["duration", "environment.DEBUG"],)
        ),
    },
    "StopSection": {
        "ask": About("Duration after it was asked, before SIGINT. By default 3 s.", ("3 s",)),
        "sigint": About("Duration after SIGINT, before SIGTERM. By default 2 s.", ("2 s",)),
        "sigterm": About("Duration after SIGTERM, before SIGKILL. By default 2 s.", ("2 s",)),
    },
    "RecordSection": {
        "sync": About(
            "Duration after which what was recorded is forced to the disk, or never.",
            ("1 s", "never"),
        ),
        "rotate": About("When the recording goes on in a new file.", ({"size": "500 MB"},)),
        "keep": About("What is kept of earlier sessions.", ({"sessions": 20},)),
        "sampling": About(
            "How often processes and the machine are measured.", ({"period": "5 s"},)
        ),
        "ros": About("Whether topics of ROS are recorded. By default true.", (False,)),
        "topics": About(
            "Topics to record beside /rosout, /diagnostics and /parameter_events; * is any text.",
            (["/tf", "/lidar/*"],),
        ),
        "exclude": About("Topics that are not recorded.", (["*/compressed"],)),
        "budget": About("Size that is recorded of each topic in a second at most.", ("50 MB",)),
        "before_crash": About(
            "What is kept in memory until something fails.",
            ({"topics": ["/camera/*"], "seconds": "10 s"},),
        ),
    },
    "RotateSection": {
        "size": About("Size of the file, or never. By default 1 GB.", ("500 MB",)),
        "duration": About("Duration since it was begun, or never. By default 1 h.", ("24 h",)),
    },
    "KeepSection": {
        "sessions": About("Number of sessions. By default all.", (20,)),
        "size": About("Size of the sessions together. By default unlimited.", ("10 GB",)),
    },
    "SamplingSection": {
        "period": About(
            "Duration from one sample to the next, at least 100 ms, or never. By default 1 s.",
            ("5 s",),
        ),
    },
    "BeforeCrashSection": {
        "topics": About("Topics that are kept in memory; * is any text.", (["/camera/*"],)),
        "seconds": About("Duration that is kept. By default 10 s.", ("10 s",)),
        "megabytes": About("Memory for them, in 1,000,000 bytes. By default 256.", (512,)),
    },
    "LoadingSection": {
        "container_type": About(_CONTAINER_TYPE, ("isolated",)),
        "thread_num": About(_THREADS, (4,)),
        "isolation": About(_ISOLATION, ("auto",)),
        "memory_domains": About(_MEMORY_DOMAINS, ("auto",)),
        "core_dumps": About(_CORE_DUMPS, (True,)),
        "auto_reload_on_crash": About(_AUTO_RELOAD, (True,)),
        "on_crash": About(_ON_CRASH, ("reload",)),
        "loading_timeout": About(f"{_LOADING_TIMEOUT} By default 10 s.", ("10 s",)),
        "probe_timeout": About(f"{_PROBE_TIMEOUT} By default 60 s.", ("60 s",)),
        "resources": About("Defaults for the resources of isolated nodes.", ({"nice": 5},)),
        "cgroups": About(
            "Control groups (cgroup v2): whether there are any, where, and limits of nodes.",
            ({"enabled": True}, {"base_path": "/sys/fs/cgroup/play_launch", "required": True}),
        ),
        "restart": _RESTART,
    },
    "ResourcesSection": {
        "nice": About("Nice value, -20 (first) to 19.", (5, -5)),
        "scheduler": About(
            "Policy of the scheduler, with the priority of a real-time one.",
            ({"policy": "fifo", "priority": 50}, {"policy": "batch"}),
        ),
        "cpu_affinity": About("CPUs that it may run on.", ([2, 3], "0-3,6", 2)),
        "io_priority": About(
            "Priority of its disk accesses: idle, best_effort or realtime, with a level from 0 "
            "(first) to 7.",
            ("best_effort:2", "idle"),
        ),
        "oom_score_adj": About(
            "Whom the kernel kills first when memory runs out: -1000 (never this one) to 1000.",
            (500,),
        ),
        "lock_memory": About(
            "Whether its memory stays in RAM; for containers and isolation: process.", (True,)
        ),
        "rlimits": About(
            "Limits of setrlimit(2): one value, or soft:hard.",
            ({"nofile": 65536, "core": "unlimited"}, {"nofile": "1024:65536"}),
        ),
        **_GROUP_LIMITS,
    },
    "GroupLimitsSection": {
        **_GROUP_LIMITS,
        "cpuset_cpus": About("Another name of cpuset.", ("0-3",)),
    },
    "CgroupsSection": {
        "enabled": About(
            "Whether processes have control groups. By default where limits are asked for.", (True,)
        ),
        "required": About(
            "Whether nothing starts without its control group and its limits. By default false.",
            (True,),
        ),
        "base_path": About(
            "Control group below which those of the session are made. By default auto: the one "
            "that play-launch runs in, where that is delegated.",
            ("auto", "/sys/fs/cgroup/play_launch"),
        ),
        "defaults": About("Limits of isolated nodes.", ({"cpu_weight": 100},)),
        "per_node": About(
            "Limits by the name, or full name, of isolated nodes.",
            ({"pointcloud_filter": {"cpu_max": "50000 100000", "cpuset_cpus": "0-3"}},),
        ),
    },
    "SchedulerSection": {
        "policy": About("Policy: other, batch, idle, fifo or rr; see sched(7).", ("fifo",)),
        "priority": About("Priority from 1 to 99 (first); for fifo and rr.", (50,)),
    },
    "RlimitsSection": {
        name: About(form.meaning, (form.example,)) for name, form in LIMIT_FORMS.items()
    },
    "RestartSection": {
        "max_restarts": About(
            "How often it is brought back within the time; 0 is never. By default 5.", (5,)
        ),
        "within": About("Duration in which restarts are counted. By default 60 s.", ("60 s",)),
        "backoff": About(
            "The pause before a restart, which grows.", ({"initial": "100 ms", "maximum": "30 s"},)
        ),
    },
    "BackoffSection": {
        "initial": About("Duration of the first pause. By default 100 ms.", ("100 ms",)),
        "maximum": About("Duration of the longest pause. By default 30 s.", ("30 s",)),
    },
    "ContainerSection": {
        "name": About(f"{_NAME} Containers are merged by it.", ("sensing",)),
        "namespace": _NAMESPACE,
        "container_type": About(f"{_CONTAINER_TYPE} {_DEFAULT_OF_ALL}", ("mt",)),
        "thread_num": About(f"{_THREADS} {_DEFAULT_OF_ALL}", (4,)),
        "isolation": About(f"{_ISOLATION} {_DEFAULT_OF_ALL}", ("auto",)),
        "memory_domains": About(f"{_MEMORY_DOMAINS} {_DEFAULT_OF_ALL}", ("auto",)),
        "core_dumps": About(f"{_CORE_DUMPS} {_DEFAULT_OF_ALL}", (True,)),
        "package": About(
            "Package with the program of a stock container. By default rclcpp_components.",
            ("rclcpp_components",),
        ),
        "executable": About(
            "Program of a stock container. By default component_container.",
            ("component_container_mt",),
        ),
        "arguments": About("Strings for the program of a stock container.", (["--verbose"],)),
        "depends_on": _DEPENDS_ON,
        "start_delay": _START_DELAY,
        "prefix": _PREFIX,
        "cwd": _CWD,
        "output": _OUTPUT,
        "on_exit": About(
            "What follows when it ends by itself: restart or shutdown. By default restart.",
            ("shutdown",),
        ),
        "process_parameters": _PROCESS_PARAMETERS,
        "attach": About("Whether a stock container was started by somebody else.", (True,)),
        "auto_reload_on_crash": About(f"{_AUTO_RELOAD} {_DEFAULT_OF_ALL}", (True,)),
        "on_crash": About(f"{_ON_CRASH} {_DEFAULT_OF_ALL}", ("reload",)),
        "log_level": _LOG_LEVEL,
        "environment": _ENVIRONMENT,
        "ros_arguments": _ROS_ARGUMENTS,
        "resources": _RESOURCES,
        "restart": _RESTART,
        "loading_timeout": About(f"{_LOADING_TIMEOUT} {_DEFAULT_OF_ALL}", ("10 s",)),
        "probe_timeout": About(f"{_PROBE_TIMEOUT} {_DEFAULT_OF_ALL}", ("60 s",)),
        "composable_nodes": About(
            "Nodes that are loaded into the container. Merged by name with included ones.",
            ([{"package": "demo", "plugin": "demo::Talker", "name": "talker"}],),
        ),
        "remove": _REMOVE,
    },
    "ComposableNodeSection": {
        "package": About("Package that has the component.", ("play_launch_demo",)),
        "plugin": About("Class of the component.", ("play_launch_demo::Talker",)),
        "name": About(f"{_NAME} Without it, the component keeps its own.", ("talker",)),
        "namespace": _NAMESPACE,
        "depends_on": _DEPENDS_ON,
        "start_delay": _START_DELAY,
        "autostart": _AUTOSTART,
        "transition_timeout": _TRANSITION_TIMEOUT,
        "parameters": _PARAMETERS,
        "remappings": _REMAPPINGS,
        "extra_arguments": About(
            "Parameters for the container; no files.", ({"use_intra_process_comms": True},)
        ),
        "log_level": _LOG_LEVEL,
        "auto_reload_on_crash": About(f"{_AUTO_RELOAD} By default the container's.", (True,)),
        "on_crash": About(f"{_ON_CRASH} By default the container's.", ("reload",)),
        "resources": _RESOURCES,
        "restart": _RESTART,
        "remove": _REMOVE,
    },
    "ProcessSection": {
        "command": About("The program and its arguments.", (["python3", "my_node.py"],)),
        "package": About("Package with the executable.", ("demo_nodes_py",)),
        "executable": About("Name of the executable, without folders.", ("listener",)),
        "name": About(f"{_NAME} With command only a label.", ("listener",)),
        "namespace": _NAMESPACE,
        "parameters": _PARAMETERS,
        "process_parameters": _PROCESS_PARAMETERS,
        "remappings": _REMAPPINGS,
        "arguments": About("Strings for the executable; not with command.", (["--fast"],)),
        "ros_arguments": _ROS_ARGUMENTS,
        "environment": _ENVIRONMENT,
        "depends_on": _DEPENDS_ON,
        "start_delay": _START_DELAY,
        "prefix": _PREFIX,
        "autostart": _AUTOSTART,
        "transition_timeout": _TRANSITION_TIMEOUT,
        "cwd": _CWD,
        "emulate_tty": About("Whether its output goes to a terminal. By default false.", (True,)),
        "output": _OUTPUT,
        "on_exit": About(
            "What follows when it ends by itself: ignore, restart or shutdown. By default ignore.",
            ("restart",),
        ),
        "respawn": About("true is short for on_exit: restart, false for ignore.", (True,)),
        "resources": _RESOURCES,
        "restart": About("Restart limits; only with on_exit: restart.", ({"max_restarts": 5},)),
        "log_level": _LOG_LEVEL,
        "remove": _REMOVE,
    },
    "DependencySection": {
        "name": About("Full name of a container, node or process of this file.", ("driver",)),
        "condition": About("With name: started, loaded, active or exited.", ("loaded",)),
        "log": About(
            "With name: a line of its output matches this regular expression.", ("streaming at",)
        ),
        "node": About("This node is in the ROS graph, whoever started it.", ("/map_server",)),
        "topic": About("This topic has a publisher.", ("/scan",)),
        "service": About("This service is offered.", ("/map_server/load_map",)),
        "file": About("This file exists.", ("/dev/ttyUSB0",)),
        "timeout": About("Duration to wait for it, or never. By default never.", ("10 s",)),
        "on_timeout": About(
            "What follows if it does not come in time: fail or start. By default fail.", ("start",)
        ),
    },
}

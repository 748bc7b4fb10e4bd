"""Sections inside the main ones: conditions, restarts, stopping, recording, resources, groups."""

from __future__ import annotations

from play_launch.config import kinds
from play_launch.config.dependency import OF_UNITS, OnTimeout
from play_launch.config.expectations import Durability, Reliability
from play_launch.config.machines import DiscoveryBy, Service
from play_launch.config.resources import SchedulerPolicy
from play_launch.config.section import ConfigSection, mapped, nested, optional, raw, required


class DependencySection(ConfigSection):
    """One entry of `depends_on`; a string there is the `name`."""

    name = optional(
        kinds.FILLED_TEXT, "Full name of a container, node or process of this file.", "driver"
    )
    condition = optional(
        kinds.choice(OF_UNITS), "With name: started, loaded, active or exited.", "loaded"
    )
    log = optional(
        kinds.REGULAR_EXPRESSION,
        "With name: a line of its output matches this regular expression.",
        "streaming at",
    )
    node = optional(
        kinds.GRAPH_NAME, "This node is in the ROS graph, however it was started.", "/map_server"
    )
    topic = optional(kinds.GRAPH_NAME, "This topic has a publisher.", "/scan")
    service = optional(kinds.GRAPH_NAME, "This service is offered.", "/map_server/load_map")
    file = optional(
        kinds.FILLED_TEXT,
        "This file exists; a relative path starts at the folder of this one.",
        "/dev/ttyUSB0",
    )
    expect = optional(kinds.GRAPH_NAME, "This topic is as expect of the file says.", "/scan")
    timeout = optional(
        kinds.POSITIVE_DURATION_OR_NEVER,
        "Duration to wait for it, or never. By default never.",
        "10 s",
    )
    on_timeout = optional(
        kinds.choice(OnTimeout),
        "What follows if it does not come in time: fail or start. By default fail.",
        "start",
    )


class BackoffSection(ConfigSection):
    """`backoff`: the pause before a restart grows from `initial` to `maximum`."""

    initial = optional(
        kinds.POSITIVE_DURATION, "Duration of the first pause. By default 100 ms.", "100 ms"
    )
    maximum = optional(
        kinds.POSITIVE_DURATION, "Duration of the longest pause. By default 30 s.", "30 s"
    )


class RestartSection(ConfigSection):
    """`restart`: at most `max_restarts` times `within` a duration."""

    max_restarts = optional(
        kinds.integer(0, 1_000_000),
        "How often it is brought back within the time; 0 is never. By default 5.",
        5,
    )
    within = optional(
        kinds.POSITIVE_DURATION, "Duration in which restarts are counted. By default 60 s.", "60 s"
    )
    backoff = nested(
        BackoffSection,
        "The pause before a restart, which grows.",
        {"initial": "100 ms", "maximum": "30 s"},
    )


class StopSection(ConfigSection):
    """`stop`: how long each step of stopping may take."""

    ask = optional(
        kinds.DURATION, "Duration after it was asked, before SIGINT. By default 3 s.", "3 s"
    )
    sigint = optional(
        kinds.DURATION, "Duration after SIGINT, before SIGTERM. By default 2 s.", "2 s"
    )
    sigterm = optional(
        kinds.DURATION, "Duration after SIGTERM, before SIGKILL. By default 2 s.", "2 s"
    )


class RotateSection(ConfigSection):
    """`record.rotate`: when the recording goes on in a new file."""

    size = optional(kinds.SIZE_OR_NEVER, "Size of the file, or never. By default 1 GB.", "500 MB")
    duration = optional(
        kinds.POSITIVE_DURATION_OR_NEVER, "Its duration, or never. By default 1 h.", "24 h"
    )


class KeepSection(ConfigSection):
    """`record.keep`: what is kept of recordings."""

    sessions = optional(kinds.integer(1, 1_000_000), "Number of sessions. By default all.", 20)
    size = optional(kinds.SIZE, "Size of all sessions together, by default unlimited.", "10 GB")


class SamplingSection(ConfigSection):
    """`record.sampling`: how often processes and the machine are measured."""

    period = optional(
        kinds.SAMPLING_PERIOD, "Time between samples, from 100 ms, or never. By default 1 s.", "5 s"
    )


class BeforeCrashSection(ConfigSection):
    """`record.before_crash`: what is kept in memory until something fails."""

    topics = required(
        kinds.list_of(kinds.TOPIC_PATTERN, least=1),
        "Topics that are kept in memory; * is any text.",
        ["/camera/*"],
    )
    seconds = optional(kinds.POSITIVE_DURATION, "Duration that is kept. By default 10 s.", "10 s")
    megabytes = optional(
        kinds.integer(1, 1_000_000), "Memory for them, in 1,000,000 bytes. By default 256.", 512
    )


class RecordSection(ConfigSection):
    """`record`: how the session is recorded."""

    sync = optional(
        kinds.POSITIVE_DURATION_OR_NEVER,
        "Duration after which what was recorded is forced to the disk, or never. By default 1 s.",
        "1 s",
        "never",
    )
    rotate = nested(RotateSection, "When the recording goes on in a new file.", {"size": "500 MB"})
    keep = nested(KeepSection, "What is kept of recordings.", {"sessions": 20})
    sampling = nested(
        SamplingSection, "How often processes and the machine are measured.", {"period": "5 s"}
    )
    ros = optional(kinds.BOOLEAN, "Whether topics of ROS are recorded. By default true.", False)
    topics = optional(
        kinds.list_of(kinds.TOPIC_PATTERN),
        "Topics to record beside /rosout, /diagnostics and /parameter_events; * is any text.",
        ["/tf", "/lidar/*"],
    )
    exclude = optional(
        kinds.list_of(kinds.TOPIC_PATTERN),
        "Topics that are not recorded; /play_launch/parameters is for those of nodes.",
        ["*/compressed"],
    )
    budget = optional(
        kinds.BUDGET,
        "Size that is recorded of each topic in a second at most, or a mapping from topics to "
        "sizes. By default unlimited.",
        "50 MB",
    )
    before_crash = nested(
        BeforeCrashSection,
        "What is kept in memory until something fails.",
        {"topics": ["/camera/*"], "seconds": "10 s"},
    )
    stale_after = optional(
        kinds.POSITIVE_DURATION,
        "Silence after which a status on /diagnostics counts as STALE. By default 30 s.",
        "2min",
    )


class ExpectationSection(ConfigSection):
    """One entry of `expect`: what is expected of a topic, which is measured while all runs."""

    type = optional(kinds.FILLED_TEXT, "Type of its messages.", "sensor_msgs/msg/LaserScan")
    min_rate = optional(kinds.RATE, "Least messages per second, of all publishers.", "8 Hz")
    max_rate = optional(kinds.RATE, "Most messages per second, of all publishers.", "12 Hz")
    max_gap = optional(kinds.POSITIVE_DURATION, "Longest duration between two messages.", "500 ms")
    publishers = optional(
        kinds.integer(0, 1000), "Number of its publishers. By default at least 1.", 1
    )
    reliability = optional(
        kinds.choice(Reliability),
        "What each publisher offers: reliable or best_effort.",
        "reliable",
    )
    durability = optional(
        kinds.choice(Durability),
        "What each publisher offers: transient_local or volatile.",
        "transient_local",
    )
    machine = optional(
        kinds.FILLED_TEXT,
        "The one of machines where it is measured. By default that of the node, or of the file.",
        "vision",
    )


class WebSection(ConfigSection):
    """`web`: the page that runs beside the system; see `play-launch web --help`."""

    bind = optional(
        kinds.ADDRESS,
        "Address to listen on. By default 127.0.0.1; any other demands tokens.",
        "192.0.2.7",
    )
    port = optional(kinds.integer(0, 65535), "Its port; 0 takes a free one. By default 8080.", 80)
    allow_control = optional(
        kinds.BOOLEAN, "Whether visitors may stop, restart and reload. By default they look.", True
    )
    token_file = optional(
        kinds.FILLED_TEXT, "Where tokens are kept. By default new ones are printed.", "~/tokens"
    )
    allow_host = optional(
        kinds.list_of(kinds.FILLED_TEXT),
        "Other names under which browsers may call it.",
        ["robot.example"],
    )


class OnLostSection(ConfigSection):
    """`machines.*.on_lost`: what a machine does that hears nothing of the coordinator any more."""

    stop_after = optional(
        kinds.POSITIVE_DURATION_OR_NEVER,
        "Duration after which it stops its part of the system, or never. By default never.",
        "30 s",
    )


class MachineSection(ConfigSection):
    """An entry of `machines`: a computer that runs a part of the system."""

    local = optional(
        kinds.BOOLEAN,
        "Whether it is the machine on which replay is called; at most one. By default false.",
        True,
    )
    ssh = optional(
        kinds.FILLED_TEXT, "Host or alias of ~/.ssh/config. By default the name.", "robot@vision"
    )
    setup = optional(
        kinds.list_of(kinds.FILLED_TEXT),
        "Files that bash sources there first, in this order; a login's .bashrc is not read.",
        ["/opt/ros/jazzy/setup.bash", "~/ws/install/setup.bash"],
    )
    play_launch = optional(
        kinds.FILLED_TEXT,
        "The program there; ~ is the home folder. By default play-launch of PATH.",
        "~/venv/bin/play-launch",
    )
    environment = raw(
        kinds.mapping_form(kinds.STRING_FORM),
        "Environment variables of its part, names to strings, over those at the top.",
        {"ROS_DOMAIN_ID": "5"},
    )
    service = optional(
        kinds.choice(Service),
        "What keeps its session running: user or system (a systemd unit), or none. "
        "By default user.",
        "none",
    )
    connect_timeout = optional(
        kinds.POSITIVE_DURATION, "Duration in which it tries to connect. By default 10 s.", "3 min"
    )
    lost_after = optional(
        kinds.POSITIVE_DURATION,
        "Duration of silence after which the connection counts as lost. By default 4 s.",
        "4 s",
    )
    on_lost = nested(
        OnLostSection,
        "After which silence of the coordinator it stops (stop_after). By default it continues.",
        {"stop_after": "30 s"},
    )
    copy = optional(
        kinds.list_of(kinds.FILLED_TEXT),
        "Files and folders to copy there, beside the configuration, from whose folder relative "
        "paths start. The files that the configuration names are copied in any case.",
        ["maps/"],
    )
    max_clock_offset = optional(
        kinds.POSITIVE_DURATION_OR_NEVER,
        "Difference of the clocks that is warned of, or never. By default 20 ms.",
        "20 ms",
    )
    optional = optional(
        kinds.BOOLEAN, "The others start without it, and it joins later. By default false.", True
    )


class DiscoverySection(ConfigSection):
    """`discovery`: how nodes of several machines find each other."""

    by = required(
        kinds.choice(DiscoveryBy),
        "multicast, or peers: the addresses of all machines go into ROS_STATIC_PEERS.",
        "peers",
    )


class SchedulerSection(ConfigSection):
    """`resources.scheduler`: the policy of the kernel's scheduler."""

    policy = required(
        kinds.choice(SchedulerPolicy),
        "Policy: other, batch, idle, fifo or rr; see sched(7).",
        "fifo",
    )
    priority = optional(kinds.integer(1, 99), "Priority from 1 to 99 (first); for fifo and rr.", 50)


# One of them is a keyword of Python, hence no class statement.
RlimitsSection: type[ConfigSection] = type(
    "RlimitsSection",
    (ConfigSection,),
    {
        name: optional(kinds.resource_limit(name, *form), meaning, example)
        for name, form, meaning, example in (
            ("as", kinds.BYTES, "Size of its address space.", "4 GiB"),
            ("core", kinds.BYTES, "Size of a core file.", "unlimited"),
            ("cpu", kinds.SECONDS, "CPU time; SIGXCPU follows.", "10 min"),
            ("data", kinds.BYTES, "Size of its data segment.", "2 GiB"),
            ("fsize", kinds.BYTES, "Size of the files that it writes.", "10 GB"),
            ("memlock", kinds.BYTES, "Size of memory that it may lock.", "unlimited"),
            ("msgqueue", kinds.BYTES, "Size of POSIX message queues.", "1 MiB"),
            ("nice", kinds.NICE, "Lowest nice value that it may give itself.", -10),
            ("nofile", kinds.COUNT, "Number of open files.", 65536),
            ("nproc", kinds.COUNT, "Number of processes and threads of the user.", 4096),
            ("rtprio", kinds.PRIORITY, "Highest real-time priority it may take.", 80),
            (
                "rttime",
                kinds.MICROSECONDS,
                "CPU time that a real-time thread may use without blocking.",
                "200 ms",
            ),
            ("sigpending", kinds.COUNT, "Number of signals that wait.", 1024),
            ("stack", kinds.BYTES, "Size of a thread's stack.", "16 MiB"),
        )
    },
)
"""`resources.rlimits`: limits of setrlimit(2), by their names in lower case."""


class LimitsSection(ConfigSection):
    """Limits of a control group, wherever they stand."""

    cpu_max = optional(
        kinds.CPU_MAX,
        "CPU time of its control group: a share of one CPU, a quota and a period in "
        "microseconds, or max.",
        "50 %",
        "200 %",
        "5000 10000",
    )
    cpu_weight = optional(
        kinds.WEIGHT,
        "Share of the CPU time where several control groups want it, 1 to 10000; others have 100.",
        200,
    )
    cpuset = optional(kinds.CPUS, "CPUs of its control group.", "0-3", [2, 3])
    io_weight = optional(
        kinds.WEIGHT,
        "Share of the disk accesses where several control groups want them, 1 to 10000.",
        50,
    )
    pids_max = optional(kinds.PIDS_MAX, "Processes and threads in its control group, or max.", 64)
    memory_high = optional(
        kinds.MEMORY_LIMIT,
        "Memory from which on its control group is slowed down; not for a node that shares memory.",
        "400 MB",
    )
    memory_max = optional(
        kinds.MEMORY_LIMIT,
        "Memory at which its control group is killed; not for a node that shares memory.",
        "512 MB",
        "max",
    )


class GroupLimitsSection(LimitsSection):
    """`defaults` and entries of `per_node` of `cgroups`."""

    cpuset_cpus = optional(kinds.CPUS, "Another name of cpuset.", "0-3")


class ResourcesSection(LimitsSection):
    """`resources`: what a process asks of the kernel for itself."""

    nice = optional(kinds.integer(-20, 19), "Nice value, -20 (first) to 19.", 5, -5)
    scheduler = nested(
        SchedulerSection,
        "Policy of the scheduler, with the priority of a real-time one.",
        {"policy": "fifo", "priority": 50},
        {"policy": "batch"},
    )
    cpu_affinity = optional(kinds.CPUS, "CPUs that it may run on.", [2, 3], "0-3,6", 2)
    io_priority = optional(
        kinds.IO_PRIORITY,
        "Priority of its disk accesses: idle, best_effort or realtime, with a level from 0 "
        "(first) to 7.",
        "best_effort:2",
        "idle",
    )
    oom_score_adj = optional(
        kinds.integer(-1000, 1000),
        "Preference of the kernel's OOM killer: -1000 (never) to 1000.",
        500,
    )
    lock_memory = optional(
        kinds.BOOLEAN,
        "Whether its memory stays in RAM; for containers and isolation: process.",
        True,
    )
    rlimits = nested(
        RlimitsSection,
        "Limits of setrlimit(2): one value, or soft:hard.",
        {"nofile": 65536, "core": "unlimited"},
        {"nofile": "1024:65536"},
    )


class CgroupsSection(ConfigSection):
    """`composable_node_loading.cgroups`: whether there are control groups, and where."""

    enabled = optional(
        kinds.BOOLEAN,
        "Whether processes have control groups. By default where limits are asked for.",
        True,
    )
    required = optional(
        kinds.BOOLEAN,
        "Whether nothing starts without its control group and its limits. By default false.",
        True,
    )
    base_path = optional(
        kinds.GROUP_PATH,
        "Control group below which those of the session are made. By default auto: the one that "
        "play-launch runs in, where that is delegated.",
        "auto",
        "/sys/fs/cgroup/play_launch",
    )
    defaults = nested(GroupLimitsSection, "Limits of isolated nodes.", {"cpu_weight": 100})
    per_node = mapped(
        GroupLimitsSection,
        "Limits by the name, or full name, of isolated nodes.",
        {"pointcloud_filter": {"cpu_max": "50000 100000", "cpuset_cpus": "0-3"}},
    )

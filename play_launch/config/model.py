"""The configuration after validation: immutable, defaults filled in, names resolved.

Nothing in here reads YAML. Durations are seconds, full names are absolute ROS names.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from msgspec import Struct
from msgspec.structs import force_setattr

from play_launch.config.dependency import StartRule
from play_launch.config.expectations import Expectation
from play_launch.config.machines import DiscoveryBy, MachineConfig
from play_launch.config.node_key import NodeKey
from play_launch.config.resources import GroupPolicy, Resources

_EMPTY: Final[Mapping[str, Any]] = MappingProxyType({})


class OnExit(StrEnum):
    """Consequence of the exit of an ordinary process: ``on_exit``."""

    IGNORE = "ignore"
    RESTART = "restart"
    SHUTDOWN = "shutdown"


class RestartLimits(Struct, frozen=True):
    """How often something is started again: at most `max_restarts` times `within` seconds."""

    max_restarts: int = 5
    within: float = 60.0
    """Length of the window in seconds; also how long a life is healthy."""
    initial: float = 0.1
    """First pause in seconds."""
    maximum: float = 30.0
    """Longest pause in seconds."""
    first_at_once: bool = False
    """Whether the first restart after a healthy life comes without a pause."""


class OnCrash(StrEnum):
    """What follows when a node of an isolated container crashes: ``on_crash``."""

    RELOAD = "reload"
    IGNORE = "ignore"
    STOP_CONTAINER = "stop_container"
    SHUTDOWN = "shutdown"


class Autostart(StrEnum):
    """State that a managed node is brought to: ``autostart``."""

    CONFIGURE = "configure"
    ACTIVATE = "activate"


# ruff: noqa: TC001, TC003 - msgspec resolves the annotations to read recorded inputs


class ContainerType(StrEnum):
    """Which executor a container spins its nodes with, and in how many processes."""

    STANDARD = "standard"
    MT = "mt"
    ISOLATED = "isolated"
    ISOLATED_MT = "isolated_mt"
    STOCK = "stock"
    """A program with ROS's composition services."""

    @property
    def is_isolated(self) -> bool:
        """Whether each node is a process of its own, so that it can crash alone."""
        return self in {ContainerType.ISOLATED, ContainerType.ISOLATED_MT}

    @property
    def is_multi_threaded(self) -> bool:
        return self in {ContainerType.MT, ContainerType.ISOLATED_MT}


class Isolation(StrEnum):
    """How the nodes of an isolated container become processes of their own."""

    AUTO = "auto"
    """By shared memory where the machine can do it, else by ordinary processes."""
    SHARED_MEMORY = "shared_memory"
    PROCESS = "process"


class MemoryDomains(StrEnum):
    """Whether the private memory of isolated nodes is protected from their neighbours."""

    OFF = "off"
    AUTO = "auto"
    """As far as the machine can do it; up to 15 nodes of a container have a key of their own."""
    REQUIRED = "required"
    """A node whose memory would not be protected from each other one is not loaded."""


class Output(StrEnum):
    """Where the output of a process goes."""

    SCREEN = "screen"
    LOG = "log"
    """Into the recording."""
    BOTH = "both"

    @property
    def is_shown(self) -> bool:
        return self is not Output.LOG

    @property
    def is_recorded(self) -> bool:
        return self is not Output.SCREEN


class ParameterType(IntEnum):
    """The types a ROS parameter can have; numbers as in `rcl_interfaces/msg/ParameterType`."""

    BOOL = 1
    INTEGER = 2
    DOUBLE = 3
    STRING = 4
    BYTE_ARRAY = 5
    BOOL_ARRAY = 6
    INTEGER_ARRAY = 7
    DOUBLE_ARRAY = 8
    STRING_ARRAY = 9

    @property
    def field(self) -> str:
        """The field of `rcl_interfaces/msg/ParameterValue` that holds such a value."""
        return f"{self.name.lower()}_value"


if TYPE_CHECKING:
    ParameterPayload: TypeAlias = (
        bool
        | int
        | float
        | str
        | bytes
        | tuple[bool, ...]
        | tuple[int, ...]
        | tuple[float, ...]
        | tuple[str, ...]
    )
else:  # msgspec reads no union of several kinds of tuples
    ParameterPayload = object


class ParameterValue(Struct, frozen=True):
    """A value and its ROS type; `value` is bytes for a byte array, a tuple for other arrays."""

    type: ParameterType
    value: ParameterPayload

    def __post_init__(self) -> None:
        if isinstance(self.value, list):  # msgspec reads an array of any type as a list
            force_setattr(self, "value", tuple(self.value))


class ParameterConfig(Struct, frozen=True):
    """One parameter; nested names are joined with dots."""

    name: str
    value: ParameterValue


FOR_ALL: Final = "/**"
"""The pattern that every node matches."""


class ParameterSection(Struct, frozen=True):
    """Parameters for the nodes of a process whose full name matches `pattern`, as `/**`."""

    pattern: str
    parameters: tuple[ParameterConfig, ...]


class StopLimits(Struct, frozen=True):
    """Seconds to wait after asking, after SIGINT and after SIGTERM before going further."""

    ask: float = 3.0
    sigint: float = 2.0
    sigterm: float = 2.0


class RotateConfig(Struct, frozen=True):
    """When the recording goes on in a new file: at so many bytes, after so many seconds.

    Infinity is never.
    """

    size: float = 1e9
    duration: float = 3600.0


class KeepConfig(Struct, frozen=True):
    """How many sessions, and how many bytes of them, stay in the log folder; None: all."""

    sessions: int | None = None
    size: int | None = None


class SamplingConfig(Struct, frozen=True):
    """Every how many seconds processes and the machine are measured; infinity is never."""

    period: float = 1.0


DEFAULT_TOPICS: Final = ("/rosout", "/diagnostics", "/parameter_events")
"""What is recorded of ROS unasked."""


class BeforeCrashConfig(Struct, frozen=True):
    """Topics of which the last `seconds` are kept in memory, in at most so many megabytes."""

    topics: tuple[str, ...]
    seconds: float = 10.0
    megabytes: int = 256


class RecordConfig(Struct, frozen=True, kw_only=True):
    """How the session is recorded.

    `sync` is the seconds after which what was recorded is forced to the disk; infinity is never.
    `topics` and `exclude` are names of topics and patterns, `budget` is bytes per second of each
    topic (None: any number). `topic_budgets` are names and patterns with such numbers of their own,
    infinity is any number; the first that matches a topic holds. `stale_after` is the seconds after
    which a status on /diagnostics that is not reported counts as STALE.
    """

    sync: float = 1.0
    rotate: RotateConfig = RotateConfig()
    keep: KeepConfig = KeepConfig()
    sampling: SamplingConfig = SamplingConfig()
    ros: bool = True
    """Whether topics of ROS are recorded at all."""
    topics: tuple[str, ...] = DEFAULT_TOPICS
    exclude: tuple[str, ...] = ()
    budget: int | None = None
    topic_budgets: tuple[tuple[str, float], ...] = ()
    before_crash: BeforeCrashConfig | None = None
    stale_after: float = 30.0


class ManagedConfig(Struct, frozen=True):
    """A managed (lifecycle) node: its full name, and how far it is brought (None: watched only).

    `timeout` is the seconds for each transition, and for its services to answer.
    """

    name: str
    autostart: Autostart | None = None
    timeout: float = 60.0


class ComposableNodeConfig(Struct, frozen=True, kw_only=True):
    """A node to load into a container.

    An empty `name` or `namespace` keeps the component's own. `key` is unique in the configuration.
    `line` of `file` is where the node is declared. `on_crash` and `restart` apply
    when it crashes alone.
    """

    package: str
    plugin: str
    name: str = ""
    namespace: str = ""
    key: NodeKey
    parameters: tuple[ParameterConfig, ...] = ()
    remappings: tuple[tuple[str, str], ...] = ()
    extra_arguments: tuple[ParameterConfig, ...] = ()
    log_level: str | None = None
    on_crash: OnCrash = OnCrash.RELOAD
    restart: RestartLimits = RestartLimits()
    resources: Resources = Resources()
    line: int = 0
    file: str = ""

    @property
    def declared_full_name(self) -> str:
        """The absolute name where it is known, else a label; see `NodeKey`."""
        return self.key.name


class MemberConfig(Struct, frozen=True, kw_only=True):
    """What has a process of its own.

    `environment` holds the variables of the whole system too. `prefix` stands before the program in
    the command line, `cwd` is an absolute path (None: the supervisor's own). `process_parameters`
    are for all nodes that are made in the process, in the order in which rcl reads them.
    """

    name: str = ""
    namespace: str = ""
    full_name: str
    arguments: tuple[str, ...] = ()
    process_parameters: tuple[ParameterSection, ...] = ()
    prefix: tuple[str, ...] = ()
    cwd: Path | None = None
    output: Output = Output.BOTH
    log_level: str | None = None
    environment: Mapping[str, str] = _EMPTY
    ros_arguments: tuple[str, ...] = ()
    restart: RestartLimits = RestartLimits()
    resources: Resources = Resources()
    machine: str = ""
    line: int = 0
    file: str = ""


class ContainerConfig(MemberConfig, frozen=True, kw_only=True):
    """A component container.

    `thread_num` is None for the container's own choice, `loading_timeout` and `probe_timeout` are
    seconds. `on_exit` is RESTART or SHUTDOWN. A stock container is `executable` of `package` with
    `arguments`, or, with `attach`, one that is already running. A file gives no other
    container `arguments`; benchmarks do.
    """

    container_type: ContainerType = ContainerType.STANDARD
    thread_num: int | None = None
    isolation: Isolation = Isolation.AUTO
    memory_domains: MemoryDomains = MemoryDomains.OFF
    core_dumps: bool = False
    consolidate: bool = False
    package: str = ""
    executable: str = ""
    attach: bool = False
    on_exit: OnExit = OnExit.RESTART
    loading_timeout: float = 10.0
    probe_timeout: float = 60.0
    composable_nodes: tuple[ComposableNodeConfig, ...] = ()


class ProcessConfig(MemberConfig, frozen=True, kw_only=True):
    """An ordinary executable: either `command`, or `executable` of `package`.

    An empty `name` or `namespace` keeps the program's own; `full_name` is then a label such as
    `/[listener]`, unique in the configuration. `arguments` is empty where `command` is given.
    """

    command: tuple[str, ...] | None = None
    package: str | None = None
    executable: str | None = None
    parameters: tuple[ParameterConfig, ...] = ()
    remappings: tuple[tuple[str, str], ...] = ()
    emulate_tty: bool = False
    on_exit: OnExit = OnExit.IGNORE


class SourceFile(Struct, frozen=True):
    """A file that a configuration includes or names, and its bytes, for the recording."""

    path: Path
    text: bytes


class TakenValues(Struct, frozen=True):
    """The arguments that were given, and the values of substitutions by name.

    A variable that was not set is None; `packages` are share folders.
    """

    arguments: Mapping[str, str] = _EMPTY
    variables: Mapping[str, str | None] = _EMPTY
    packages: Mapping[str, str] = _EMPTY


class WebConfig(Struct, frozen=True, kw_only=True):
    """The page that runs beside the system. Without `token_file` tokens are new for each run."""

    bind: str = "127.0.0.1"
    port: int = 8080
    allow_control: bool = False
    token_file: Path | None = None
    allow_host: tuple[str, ...] = ()


class ReplayConfig(Struct, frozen=True, kw_only=True):
    """A whole system.

    `source` is the file it was read from and `text` its bytes, for the recording, as are
    `included_files` and `parameter_files`, each once and in the order in which they were read.
    `taken` is what they took from outside. `duration`
    is the seconds after which the system is stopped, None for never. `graph_daemon` is whether
    the graph daemon of the ROS domain runs beside the nodes, and is asked what it sees.
    `start_rules` are by unit, see `play_launch.config.dependency`, for units that wait for
    something, as are the nodes in `managed`. `expect` is by topic. `machine` is the one of
    `machines` that this is the part of, empty for the whole.
    """

    name: str
    source: Path
    text: bytes
    included_files: tuple[SourceFile, ...] = ()
    parameter_files: tuple[SourceFile, ...] = ()
    taken: TakenValues = TakenValues()
    duration: float | None = None
    log_dir: Path | None = None
    graph_daemon: bool = False
    environment: Mapping[str, str] = _EMPTY
    stop: StopLimits = StopLimits()
    record: RecordConfig = RecordConfig()
    cgroups: GroupPolicy = GroupPolicy()
    containers: tuple[ContainerConfig, ...] = ()
    nodes: tuple[ProcessConfig, ...] = ()
    start_rules: Mapping[str, StartRule] = _EMPTY
    managed: Mapping[str, ManagedConfig] = _EMPTY
    expect: Mapping[str, Expectation] = _EMPTY
    machines: Mapping[str, MachineConfig] = _EMPTY
    machine: str = ""
    discovery: DiscoveryBy = DiscoveryBy.MULTICAST
    web: WebConfig | None = None

    @property
    def members(self) -> tuple[ContainerConfig | ProcessConfig, ...]:
        """Containers and ordinary executables."""
        return (*self.containers, *self.nodes)

    @property
    def parts(self) -> dict[str, ContainerConfig | ProcessConfig | ComposableNodeConfig]:
        """Containers and processes by full name, composable nodes by the text of their keys."""
        nodes = [node for each in self.containers for node in each.composable_nodes]
        return {
            **{each.full_name: each for each in self.containers},
            **{each.full_name: each for each in self.nodes},
            **{str(each.key): each for each in nodes},
        }

    @property
    def units(self) -> dict[str, tuple[str, ...]]:
        """The members by full name, as declared, each with the units that are its nodes."""
        return {
            **{
                container.full_name: tuple(str(node.key) for node in container.composable_nodes)
                for container in self.containers
            },
            **{process.full_name: () for process in self.nodes},
        }

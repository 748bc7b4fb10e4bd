"""The configuration after validation: immutable, defaults filled in, names resolved.

Nothing in here reads YAML. Durations are seconds, full names are absolute ROS names.
"""

from __future__ import annotations

from enum import IntEnum, StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, TypeAlias

from msgspec import Struct, field

from play_launch.core.crash import OnCrash
from play_launch.core.restart import RestartLimits

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from play_launch.core.node_key import NodeKey


class ContainerType(StrEnum):
    """Which executor a container spins its nodes with, and in how many processes."""

    STANDARD = "standard"
    MT = "mt"
    ISOLATED = "isolated"
    ISOLATED_MT = "isolated_mt"
    STOCK = "stock"
    """Somebody else's program, which offers ROS's composition services."""

    @property
    def is_isolated(self) -> bool:
        """Whether each node is a process of its own, so that it can crash alone."""
        return self in {ContainerType.ISOLATED, ContainerType.ISOLATED_MT}

    @property
    def is_multi_threaded(self) -> bool:
        """Whether an executor has several threads."""
        return self in {ContainerType.MT, ContainerType.ISOLATED_MT}


class Isolation(StrEnum):
    """How the nodes of an isolated container become processes of their own."""

    AUTO = "auto"
    """By shared memory where the machine can do it, else by ordinary processes."""
    SHARED_MEMORY = "shared_memory"
    PROCESS = "process"


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


class ParameterValue(Struct, frozen=True):
    """A value and its ROS type; `value` is bytes for a byte array, a tuple for other arrays."""

    type: ParameterType
    value: ParameterPayload


class ParameterConfig(Struct, frozen=True):
    """One parameter; nested names are joined with dots."""

    name: str
    value: ParameterValue


class StopLimits(Struct, frozen=True):
    """Seconds to wait after asking, after SIGINT and after SIGTERM before going further."""

    ask: float = 3.0
    sigint: float = 2.0
    sigterm: float = 2.0


def _no_environment() -> Mapping[str, str]:
    return MappingProxyType({})


class ComposableNodeConfig(Struct, frozen=True, kw_only=True):
    """A node to load into a container.

    An empty `name` or `namespace` keeps the component's own. `key` is unique in the configuration.
    `line` is where the node is declared. `on_crash` and `restart` are what becomes of it when it
    crashes alone.
    """

    package: str
    plugin: str
    name: str
    namespace: str
    key: NodeKey
    parameters: tuple[ParameterConfig, ...] = ()
    remappings: tuple[tuple[str, str], ...] = ()
    extra_arguments: tuple[ParameterConfig, ...] = ()
    log_level: str | None = None
    on_crash: OnCrash = OnCrash.RELOAD
    restart: RestartLimits = field(default_factory=RestartLimits)
    line: int = 0

    @property
    def declared_full_name(self) -> str:
        """The absolute name where it is known, else a label; see `NodeKey`."""
        return self.key.name


class ContainerConfig(Struct, frozen=True, kw_only=True):
    """A component container.

    `environment` holds the variables of the whole system too, `thread_num` is None for
    the container's own choice, `loading_timeout` and `probe_timeout` are seconds. A stock
    container is `executable` of `package` with `arguments`, or, with `attach`, one that somebody
    else has started. A file gives no other container `arguments`; benchmarks do.
    """

    name: str
    namespace: str
    full_name: str
    container_type: ContainerType = ContainerType.STANDARD
    thread_num: int | None = None
    isolation: Isolation = Isolation.AUTO
    core_dumps: bool = False
    package: str = ""
    executable: str = ""
    arguments: tuple[str, ...] = ()
    attach: bool = False
    log_level: str | None = None
    environment: Mapping[str, str] = field(default_factory=_no_environment)
    ros_arguments: tuple[str, ...] = ()
    restart: RestartLimits = field(default_factory=RestartLimits)
    loading_timeout: float = 10.0
    probe_timeout: float = 60.0
    composable_nodes: tuple[ComposableNodeConfig, ...] = ()
    line: int = 0


class ProcessConfig(Struct, frozen=True, kw_only=True):
    """An ordinary executable: either `command`, or `executable` of `package`.

    An empty `name` or `namespace` keeps the program's own; `full_name` is then a label such as
    `/[listener]`, unique in the configuration. `arguments` is empty where `command` is given.
    `environment` holds the variables of the whole system too.
    """

    name: str
    namespace: str
    full_name: str
    command: tuple[str, ...] | None = None
    package: str | None = None
    executable: str | None = None
    arguments: tuple[str, ...] = ()
    parameters: tuple[ParameterConfig, ...] = ()
    remappings: tuple[tuple[str, str], ...] = ()
    environment: Mapping[str, str] = field(default_factory=_no_environment)
    ros_arguments: tuple[str, ...] = ()
    respawn: bool = False
    restart: RestartLimits = field(default_factory=RestartLimits)
    log_level: str | None = None
    line: int = 0


class ParameterFile(Struct, frozen=True):
    """A parameter file that a configuration names, and its bytes, for the recording."""

    path: Path
    text: bytes


class ReplayConfig(Struct, frozen=True, kw_only=True):
    """A whole system.

    `source` is the file it was read from and `text` its bytes, for the recording, as are
    `parameter_files`, each once and in the order in which they were read. `duration`
    is the seconds after which the system is stopped, None for never. `graph_daemon` says whether
    the graph daemon of the ROS domain runs before the nodes, and is asked what it sees.
    """

    name: str
    source: Path
    text: bytes
    parameter_files: tuple[ParameterFile, ...] = ()
    duration: float | None = None
    log_dir: Path | None = None
    graph_daemon: bool = False
    environment: Mapping[str, str] = field(default_factory=_no_environment)
    stop: StopLimits = StopLimits()
    containers: tuple[ContainerConfig, ...] = ()
    nodes: tuple[ProcessConfig, ...] = ()

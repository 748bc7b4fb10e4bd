"""What a launch description contains once it is evaluated, with nothing left to decide.

ROS's launch and dumps of other programs become these records, and one writer makes configurations
of them.
"""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Final, TypeAlias

from msgspec import Struct, field

from play_launch import UserError
from play_launch.config.model import (
    FOR_ALL,
    Autostart,
    ParameterConfig,
    ParameterSection,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


class Place(Struct, frozen=True, omit_defaults=True):
    """A line of a launch file, counted from 1; 0: not known. `file` is an absolute path."""

    file: str = ""
    line: int = 0

    def __str__(self) -> str:
        """Write it as `file:line`."""
        return f"{self.file}:{self.line}" if self.line else self.file


class Values(Struct, frozen=True, tag="values", omit_defaults=True):
    """A source of parameters: values that the launch file gives.

    `pattern` is the section in which the node gets them: launch_ros takes the full name of a node
    that has one, and `/**` otherwise.
    """

    parameters: tuple[ParameterConfig, ...]
    pattern: str = FOR_ALL


class ParameterFile(Struct, frozen=True, tag="file", omit_defaults=True):
    """A source of parameters: a file.

    `text` is what stands in it where the file does not stay (temporary files of substitutions, and
    files in dumps, whose `path` is empty); None: it is to be read at `path`, which is absolute.
    """

    path: str = ""
    text: str | None = None


Source: TypeAlias = Values | ParameterFile


class Event(StrEnum):
    """What has to happen before something is started."""

    DELAY = "delay"
    """`seconds` have passed (TimerAction)."""
    STARTED = "started"
    """The process `unit` was started (OnProcessStart)."""
    EXITED = "exited"
    """The process `unit` has exited, with any status (OnProcessExit)."""
    STATE = "state"
    """The managed node `unit` has reached the lifecycle state `state` (OnStateTransition)."""


class StartCondition(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One condition; `unit` is the `id` of another record."""

    event: Event
    unit: str = ""
    seconds: float = 0.0
    state: str = ""


class ProgramKind(StrEnum):
    """What a process is to ROS."""

    PROCESS = "process"
    """An ordinary command, no node (ExecuteProcess)."""
    NODE = "node"
    CONTAINER = "container"


OUTPUTS: Final = frozenset({"screen", "log", "both", "own_log", "full"})
"""What launch knows to do with the output of a process."""


class _Launched(Struct, kw_only=True, omit_defaults=True):
    """What processes and composable nodes have in common.

    `id` is unique in a description. `where` is for reports, and empty for the place of `origin`. An
    empty `name` is the program's own; `namespace` is absolute, or empty for the program's own.
    `sources` are the parameters as the launch file gives them, in order; of a composable node whose
    `parameters` are known, its files suffice. `parameters` are those that the node itself gets of
    them, as rcl reads them. Remappings are in the order in which they count, the first of each name
    holds. `autostart` is how far the launch file brings a managed node. It starts when all of
    `start` has happened, one after the other.
    """

    id: str = ""
    origin: Place = Place()
    where: str = ""
    package: str = ""
    name: str = ""
    namespace: str = ""
    sources: list[Source] = field(default_factory=list)
    parameters: list[ParameterConfig] = field(default_factory=list)
    remappings: list[tuple[str, str]] = field(default_factory=list)
    is_lifecycle: bool = False
    autostart: Autostart | None = None
    start: list[StartCondition] = field(default_factory=list)

    @property
    def full_name(self) -> str:
        """Namespace and name; empty where there is no name."""
        return f"{self.namespace.rstrip('/')}/{self.name}" if self.name else ""

    @property
    def described(self) -> str:
        """Where it stands, and what it is called, for reports."""
        return self.where or " ".join(filter(None, (str(self.origin), self.full_name)))


class LaunchedProcess(_Launched, kw_only=True, tag="process", omit_defaults=True):
    """A process: an ordinary command, a node, or a container.

    `for_others` is what other nodes in the process get of `sources`, in rcl's order: all sections
    but that of the node's full name.

    It runs `executable` of `package` with `arguments`, or, where `package` is empty, `command` (a
    single line for a shell with `shell`). `ros_arguments` are those beside name, namespace,
    remappings and parameters, without `--ros-args`. `environment` and `unset` are the difference to
    the environment in which the file was evaluated. `respawn_delay` and the timeouts are seconds,
    `respawn_max_retries` is -1 for any number. `output` is one of `OUTPUTS`, empty for the default.
    """

    kind: ProgramKind = ProgramKind.NODE
    for_others: list[ParameterSection] = field(default_factory=list)
    executable: str = ""
    command: list[str] = field(default_factory=list)
    label: str = ""
    """What launch calls the process in its output."""
    shell: bool = False
    arguments: list[str] = field(default_factory=list)
    ros_arguments: list[str] = field(default_factory=list)
    environment: list[tuple[str, str]] = field(default_factory=list)
    unset: list[str] = field(default_factory=list)
    prefix: list[str] = field(default_factory=list)
    cwd: str = ""
    output: str = ""
    emulate_tty: bool = False
    respawn: bool = False
    respawn_delay: float | None = None
    respawn_max_retries: int = -1
    ends_all: bool = False
    """Whether everything is shut down when it exits unasked."""
    sigterm_timeout: float | None = None
    sigkill_timeout: float | None = None


class Composable(_Launched, kw_only=True, tag="composable", omit_defaults=True):
    """A composable node; `container` is the full name of its container."""

    plugin: str = ""
    container: str = ""
    log_level: str = ""
    extra_arguments: list[ParameterConfig] = field(default_factory=list)


Unit: TypeAlias = LaunchedProcess | Composable


class Loss(Struct, frozen=True, omit_defaults=True):
    """Something that the records do not say, or that the configuration says in another way.

    With `is_note` the system behaves alike for all that is known, or it was not requested.
    """

    where: str
    what: str
    is_note: bool = False


class Argument(Struct, frozen=True, omit_defaults=True):
    """A declared launch argument; `default` is None where it is required."""

    name: str
    default: str | None = None
    description: str = ""
    choices: tuple[str, ...] = ()
    origin: Place = Place()


class TemporaryFile(Struct, frozen=True):
    """A file that something names and that does not stay."""

    path: str
    content: bytes


class Description(Struct, tag="description", omit_defaults=True):
    """An evaluated launch description.

    `units` are in the order in which launch starts them. `files` are the launch files that were
    read, the first one first. `arguments` are those that may be given. `losses` are what was found
    and has no record. `temporary` are the files other than those of parameters that units name, by
    paths at which they are no longer.
    """

    units: list[Unit] = field(default_factory=list)
    losses: list[Loss] = field(default_factory=list)
    files: list[str] = field(default_factory=list)
    arguments: list[Argument] = field(default_factory=list)
    temporary: list[TemporaryFile] = field(default_factory=list)


class LaunchOrigin(Struct, frozen=True, omit_defaults=True):
    """Where something stands, and the includes that led there, the nearest one first."""

    place: Place = Place()
    included_from: tuple[Place, ...] = ()


class EvaluationFailure(Struct, frozen=True, tag="failure", omit_defaults=True):
    """Why a launch file could not be evaluated: the first error, and where.

    `logged` is what ROS's launch said about it, which may name more.
    """

    message: str
    origin: LaunchOrigin = LaunchOrigin()
    logged: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Write one line for the error, one for each include that led there, then the rest."""
        place = f"{self.origin.place}: " if self.origin.place.file else ""
        chain = "".join(f"\n  included from {each}" for each in self.origin.included_from)
        logged = "".join(f"\n  launch: {each}" for each in self.logged)
        return f"{place}{self.message}{chain}{logged}"


class LaunchFileError(UserError):
    """A launch file cannot be found or evaluated; the text is that of the failure."""


class Job(Struct, frozen=True, kw_only=True):
    """What is to be evaluated, within `limit` seconds, into the file `answer`.

    `only_arguments` reads the file without visiting it. Without `is_faster` launch does everything
    as often as `ros2 launch` does.
    """

    path: str
    arguments: tuple[tuple[str, str], ...] = ()
    temporary: str
    answer: str
    limit: float
    is_faster: bool = True
    only_arguments: bool = False


class Losses:
    """What could not be carried over, in the order in which it was found, each once."""

    def __init__(self, found: Iterable[Loss] = ()) -> None:
        self._found: dict[Loss, None] = dict.fromkeys(found)

    def __iter__(self) -> Iterator[Loss]:
        return iter(self._found)

    def add(self, loss: Loss) -> None:
        self._found[loss] = None

    def lost(self, where: str, what: str) -> None:
        """Report something that is missing."""
        self.add(Loss(where, what))

    def note(self, where: str, what: str) -> None:
        """Report something that is worth knowing."""
        self.add(Loss(where, what, is_note=True))

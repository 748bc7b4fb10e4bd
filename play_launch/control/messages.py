"""Messages between a session and its clients, as docs/control.md lists them.

The session checks requests with these types, limits included, and writes results from them. A
client reads plain JSON: importing msgspec takes longer than its work. The tables of docs/control.md
are made from the docstrings by ``python -m tests.support.doc_tables``.
"""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable  # noqa: TC003 - msgspec reads annotations
from typing import Annotated, Literal, NamedTuple, TypeVar

import msgspec
from msgspec import UNSET, Meta, Raw, Struct, UnsetType, field

from play_launch.control.protocol import PROTOCOL, Code, OperationError
from play_launch.process.cgroups.usage import GroupUsage  # noqa: TC001 - msgspec reads annotations

Name = Annotated[str, Meta(max_length=1000)]
Names = Annotated[tuple[Name, ...], Meta(max_length=2000)]
Seconds = Annotated[float, Meta(gt=0, lt=365 * 24 * 3600)]

_T = TypeVar("_T")
_PLACE = re.compile(r"(.*) - at `\$\.?(.+)`")


class Request(Struct, frozen=True):
    """One line of a client."""

    id: Annotated[int, Meta(ge=0, le=2**53)]
    op: str
    arguments: Raw = Raw(b"{}")
    protocol: int = PROTOCOL
    command: tuple[str, ...] = ()
    """Command line of the client, as it reports it."""


async def _drop(kind: str, value: object) -> None:
    del kind, value


class Caller(NamedTuple):
    """The client of a request."""

    pid: int
    """When it connected; it may be reused since."""
    uid: int
    command: tuple[str, ...] = ()
    """Command line, as it reports it."""
    send: Callable[[str, object], Awaitable[None]] = _drop
    """Sends a message before the result, as soon as the client has read most earlier ones."""


class Selected(Struct, frozen=True, kw_only=True):
    """Arguments of an operation on units."""

    names: Names = ()
    """names or patterns; everything if missing"""


class ActionRequest(Struct, frozen=True, kw_only=True):
    """Arguments of an action."""

    names: Annotated[Names, Meta(min_length=1)]
    """names or patterns"""
    timeout: Seconds = 60.0
    """seconds until an answer; the action itself continues"""


class SignalRequest(ActionRequest, frozen=True, kw_only=True):
    """Arguments of ``signal``."""

    signal: str | int
    """name or number"""


class WaitRequest(Struct, frozen=True, kw_only=True):
    """Arguments of ``wait``."""

    names: Names = ()
    """names or patterns; everything that is configured if missing"""
    timeout: Seconds = 60.0
    """seconds"""
    condition: Literal["loaded", "active", "expected"] = field(default="loaded", name="for")
    """`loaded`; `active`: managed nodes with `autostart: activate` are active as well;
    `expected`: topics are as expected as well"""


class EventsRequest(Selected, frozen=True, kw_only=True):
    """Arguments of ``events``."""

    kinds: tuple[str, ...] = ()
    """kinds of events; all but `output` and samples if missing"""
    follow: bool = False
    """continue until the connection or the session ends"""
    only_new: bool = False
    """leave out earlier events"""
    since: Annotated[int, Meta(ge=0)] = 0
    """`number` of the last event that the client has: only later ones"""


class ChangeRequest(Struct, frozen=True, kw_only=True):
    """Arguments of ``apply``."""

    path: Annotated[str, Meta(pattern="^/", max_length=4095)]
    """absolute path of the configuration, which the session reads"""
    text: str | None = None
    """the configuration itself, if it is not a file; `path` is its name then"""
    arguments: tuple[str, ...] = ()
    """`name:=value` each"""
    environment: dict[str, str] | None = None
    """variables for `${env:...}` and the packages of the configuration; those of the session where they are missing"""  # noqa: E501 - a cell of a table
    timeout: Seconds = 60.0
    """seconds for each step"""
    rollback_on_failure: bool = False
    """apply the previous configuration again when a step fails"""
    dry_run: bool = False
    """compare only"""


class Managed(Struct, frozen=True):
    """State of a managed node with ``autostart``."""

    state: str
    reason: str


class UnitRow(Struct, frozen=True, kw_only=True):
    """A container, composable node or ordinary process, as ``ps`` lists it."""

    name: str
    """full name; the label of a node without a name"""
    kind: Literal["container", "component", "process"]
    """`container`, `component`, `process`"""
    container: str | None
    """full name of a component's container, else null"""
    state: str
    """of a container `stopped`, `starting`, `running`, `killing`, `backoff`, `gave up`, `stopping`; of a component `pending`, `requested`, `loading`, `loaded`, `load failed`, `unloading`, `unloaded`, `crashed`, `gave up`, `lost`; of a process `pending`, `waiting`, `running`, `exited`, `backoff`, `gave up`, `stopping`, `stopped`"""  # noqa: E501 - a cell of a table
    reason: str
    """reason of the state, may be empty"""
    is_guest: bool = False
    """whether another program loaded it: it is only listed"""
    managed: Managed | None
    """of a [managed node](config.md#managed-nodes) with `autostart` its `state` (`absent`, `asked`, `configuring`, `activating`, `unconfigured`, `inactive`, `active`, `finalized`, `failed`) and `reason`; else null"""  # noqa: E501
    pid: int | None
    """of its process; that of the container for a component without one; null when it does not run"""  # noqa: E501
    restarts: int
    """number of restarts or reloads"""
    uptime_s: float | None
    """seconds since the start of its process, or since the component was loaded"""
    exit_code: int | None
    """exit code of its last process; null while it runs or where unknown"""
    signal: int | None
    """signal that ended its last process"""
    crashes: int
    """crashes of a component, or of all components of a container"""
    causes: dict[str, int] = {}
    """how often it ended unrequested, by cause: `signal`, `exception`, `exit status`, `unknown status`, `out of memory`, `frozen`, `channel failed`, `node left lock`, `container exited`"""  # noqa: E501 - a cell of a table
    cpu_percent: float | None
    """of one core, in the last second; null without a process of its own, without sampling (`record.sampling`), or just after a start"""  # noqa: E501
    memory_bytes: int | None
    """null also where the memory is the container's"""
    machine: str | UnsetType = UNSET
    """on which of [several machines](machines.md); missing in a system of one"""
    memory_kind: Literal["unknown", "pss", "rss", "shared"] | None
    """`pss`, `rss`, `shared` (the container's), `unknown` or null"""
    cgroup: GroupUsage | UnsetType | None = UNSET
    """usage of its [control group](resources.md#usage); null without one, and for a component without a process of its own"""  # noqa: E501


class RestartRecord(Struct, frozen=True):
    """One restart, reload or final failure of a unit."""

    stamp_ns: int
    cause: str


class LastLine(Struct, frozen=True):
    """A line of output."""

    stamp_ns: int
    stream: str
    text: str


class UnitStatus(UnitRow, frozen=True, kw_only=True):
    """All that is known of one unit: the fields of ``ps``, and these."""

    since_ns: int | None
    """time since which it is in its state, in nanoseconds since the epoch; null before its first start"""  # noqa: E501
    last_restarts: tuple[RestartRecord, ...]
    """its latest exits, crashes and restarts, each with `stamp_ns` and `cause`; at most 10"""
    waits_for: str
    """conditions that its start waits for; empty: none"""
    wanted: bool
    """whether it is to run: false when it was stopped or unloaded by an operator"""
    command: tuple[str, ...]
    """command line of its process; empty for a component"""
    resources: dict[str, object]
    """[resources](resources.md) that are configured for it"""
    declared: str
    """`file:line` of its declaration"""
    output: tuple[LastLine, ...]
    """its last 10 lines of output, each with `stamp_ns`, `stream` and `text`"""


class ActionResult(Struct, frozen=True):
    """Result of an action on one unit."""

    name: str
    container: str | None
    done: bool
    reason: str


class Results(Struct, frozen=True):
    """Result of an action, or of ``wait``."""

    results: tuple[ActionResult, ...]


class SystemResult(Struct, frozen=True):
    """Result of ``system``."""

    up_after_s: float | None
    """seconds from the start of the session until all containers were started and all loads done; null before"""  # noqa: E501 - a cell of a table


class RecordingResult(Struct, frozen=True):
    """Result of ``recording``."""

    dropped: int
    """events that are not in the recording"""
    topic_drops: int
    """messages of topics of ROS that are not in the recording"""
    lag: float
    """seconds for which the oldest event waits that is not written yet"""
    error: str
    """why the recording takes no data at the moment; empty if it does"""


class SnapshotResult(Struct, frozen=True):
    """What was written into the recording."""

    messages: int
    bytes: int
    seconds: float


class ParameterNames(Struct, frozen=True):
    """Names of the parameters of a node."""

    name: str
    parameters: list[str]


class SessionHello(Struct, frozen=True, kw_only=True):
    """The first message of a session."""

    protocol: int = PROTOCOL
    version: str
    """of play-launch"""
    pid: int
    name: str
    """of the configuration"""
    session: str
    """id of the recording"""
    folder: str
    started_ns: int
    """nanoseconds since the epoch"""
    source: str = ""
    """absolute path of the configuration that it was started with"""
    machine: str = ""
    """the one of [machines](machines.md) whose part it runs; empty: the whole system"""


def read_request(line: bytes) -> Request:
    try:
        request = msgspec.json.decode(line, type=Request)
    except (ValueError, RecursionError) as error:
        raise OperationError(Code.MALFORMED, f"not a request: {error}") from None
    if request.protocol != PROTOCOL:
        raise OperationError(
            Code.PROTOCOL,
            f"protocol {request.protocol} is not supported: this session uses protocol {PROTOCOL}; "
            "use the command of the session's version",
        )
    return request


def read_arguments(arguments: bytes, kind: type[_T]) -> _T:
    try:
        return msgspec.json.decode(arguments, type=kind)
    except (ValueError, RecursionError) as error:
        found = _PLACE.fullmatch(str(error))
        text = f"{found[2]}: {found[1][:1].lower()}{found[1][1:]}" if found else str(error)
        raise OperationError(Code.BAD_ARGUMENTS, text) from None

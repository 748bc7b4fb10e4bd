"""Made-up sessions, event by event, for what judges recordings."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from mcap.records import Channel
from msgspec.structs import replace

from play_launch.config.model import ParameterType
from play_launch.config.node_key import NodeKey
from play_launch.container.cdr.messages import NODE_PARAMETERS, PARAMETER_EVENT
from play_launch.postmortem.bag_reader import ChannelInfo, RecordedTopic
from play_launch.postmortem.diagnostics import DIAGNOSTIC_ARRAY
from play_launch.postmortem.findings import Finding, findings
from play_launch.postmortem.mcap_records import MESSAGE
from play_launch.postmortem.timeline import Timeline, read_timeline
from play_launch.recording import topics
from play_launch.recording.bag import BagWriter
from play_launch.recording.forms import convert
from play_launch.recording.topics import METADATA_NAME, Topic
from play_launch.supervisor.endpoints import Endpoint
from play_launch.supervisor.events import (
    ActionEvent,
    ActionPhase,
    ComponentEvent,
    ComponentEventKind,
    ContainerState,
    ContainerStateChanged,
    GraphChanged,
    GroupSample,
    ManagedNodeChanged,
    ManagedState,
    MemoryKind,
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
    ProcessSample,
    RunEvent,
    Stream,
    SubjectKind,
    SystemSample,
    WantChanged,
)
from play_launch.supervisor.outcome import Cause, Sequel

if TYPE_CHECKING:
    from pathlib import Path

    from play_launch.postmortem.parameters import Parameters

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
DIAGNOSTICS = Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
NAN = float("nan")
RELOADED = ("it is loaded again at once", Sequel.RELOAD)
"""What the supervisor does, in the words of the first version and as a code."""
STAYS = ("it stays away", Sequel.NONE)
TYPES = {
    ParameterType.BOOL: bool,
    ParameterType.INTEGER: int,
    ParameterType.DOUBLE: float,
    ParameterType.STRING: str,
    ParameterType.BYTE_ARRAY: bytes,
    ParameterType.STRING_ARRAY: tuple,
}
"""A bool is an int as well: the first that fits holds."""


def channel_of(name: str, key: str = "") -> ChannelInfo:
    """A channel of a file, as far as it matters."""
    topic = RecordedTopic(name, "", "cdr", "process", key)
    return ChannelInfo(topic, Channel(0, name, "cdr", {}, 0), None)


def message_record(data: bytes, log_time: int) -> bytes:
    """A message of channel 0, as it stands in a file."""
    return MESSAGE.pack(5, 22 + len(data), 0, 1, log_time, log_time) + data


@dataclass
class Scene:
    """Events with their times; methods take seconds since the start."""

    events: list[RunEvent] = field(default_factory=list)
    messages: list[tuple[int, Topic, bytes]] = field(default_factory=list)
    """Others, with their times."""
    has_codes: bool = True
    """Whether events have codes; those of the first version have sentences only."""
    resolved: dict[str, Any] | None = None
    """The configuration, as far as it matters."""
    applied: list[dict[str, Any]] = field(default_factory=list)
    """Those that were applied later."""

    def parameters(self, at: float, node: str, **values: Any) -> None:
        """What a node answered when it was asked."""
        self._answer(at, {"node": node, "parameters": parameters(values)})

    def no_parameters(self, at: float, node: str, error: str) -> None:
        """Why it did not answer."""
        self._answer(at, {"node": node, "error": error})

    def _answer(self, at: float, fields: dict[str, Any]) -> None:
        data = NODE_PARAMETERS.write({"stamp": ns(at), **fields})
        self.messages.append((ns(at), topics.PARAMETERS, data))

    def parameters_changed(self, at: float, node: str, **changes: dict[str, Any]) -> None:
        """A message of ROS; ``new``, ``changed`` and ``deleted`` hold values."""
        fields = {f"{kind}_parameters": parameters(values) for kind, values in changes.items()}
        data = PARAMETER_EVENT.write({"stamp": ns(at), "node": node, **fields})
        self.messages.append((ns(at), topics.PARAMETER_EVENTS, data))

    def diagnostics(self, at: float, **levels: tuple[int, str]) -> None:
        """A message of ROS: level and message of each status."""
        status = [
            {"level": level, "name": name, "message": message, "hardware_id": "", "values": []}
            for name, (level, message) in levels.items()
        ]
        data = DIAGNOSTIC_ARRAY.write({"stamp": ns(at), "frame_id": "", "status": status})
        self.messages.append((ns(at), DIAGNOSTICS, data))

    def node(self, at: float, name: str, state: NodeState, **fields: Any) -> None:
        key = NodeKey(fields.pop("container", "/box"), name)
        fields = {"cause": Cause.NONE} | fields
        self.events.append(NodeStateChanged(stamp_ns=ns(at), key=key, state=state, **fields))

    def container(
        self, at: float, state: ContainerState, name: str = "/box", reason: str = ""
    ) -> None:
        event = ContainerStateChanged(stamp_ns=ns(at), container=name, state=state, reason=reason)
        self.events.append(event)

    def managed(self, at: float, unit: str, state: ManagedState, reason: str = "") -> None:
        node = unit.rpartition(":")[2]
        self.events.append(
            ManagedNodeChanged(stamp_ns=ns(at), unit=unit, node=node, state=state, reason=reason)
        )

    def process(self, at: float, kind: ProcessEventKind, name: str = "/box", **fields: Any) -> None:
        has_failed = fields.get("signal") or fields.get("exit_code")
        fields = {"cause": Cause.SIGNAL if has_failed else Cause.NONE} | fields
        self.events.append(ProcessEvent(stamp_ns=ns(at), kind=kind, name=name, **fields))

    def dismissed(self, at: float, unit: str) -> None:
        """An operator stopped it; before there were codes, only the request was recorded."""
        self.events.append(requested(ns(at), "stop", (unit,)))
        if self.has_codes:
            self.events.append(WantChanged(stamp_ns=ns(at), unit=unit, is_wanted=False))

    def graph(self, at: float, appeared: str = "", vanished: str = "", **qos: int) -> None:
        """Endpoints as words: ``/lidar>/scan`` publishes, ``/slam</scan:pkg/msg/T`` subscribes."""
        changes = (tuple(_endpoint(each, qos) for each in s.split()) for s in (appeared, vanished))
        added, removed = changes
        self.events.append(
            GraphChanged(
                stamp_ns=ns(at),
                appeared=(),
                vanished=(),
                nodes=1,
                endpoints_appeared=added,
                endpoints_vanished=removed,
            )
        )

    def line(self, at: float, text: str, process: str = "/box") -> None:
        line = OutputLine(stamp_ns=ns(at), process=process, pid=1, stream=Stream.STDOUT, text=text)
        self.events.append(line)

    def started(self, at: float = 0.0, name: str = "/box") -> None:
        self.container(at, ContainerState.STARTING, name)
        self.process(at, ProcessEventKind.STARTED, name, pid=100)
        self.container(at, ContainerState.RUNNING, name)

    def crashed(
        self,
        at: float,
        name: str,
        function: str = "demo::tick()",
        *,
        crashes: int = 0,
        in_constructor: bool = False,
        **fields: Any,
    ) -> None:
        """A container's word about a crash, and what the supervisor makes of it."""
        report = {
            "signal": 11,
            "error_message": "SIGSEGV (no memory at address 0x0) in thread 'main'",
            "backtrace": (f"#0 {function}+0x1 (libdemo.so+0x2)",),
            "pid": 7,
            **fields,
        }
        words, sequel = report.pop("sequel", RELOADED)
        cause, delay_ns = report.pop("cause", Cause.SIGNAL), report.pop("delay_ns", 0)
        self.events.append(
            ComponentEvent(
                stamp_ns=ns(at),
                kind=ComponentEventKind["LOAD_FAILED" if in_constructor else "CRASHED"],
                container="/box",
                unique_id=1,
                attempt=1,
                full_node_name=name,
                package_name="demo",
                plugin_name="demo::Talker",
                **report,
            )
        )
        said = {
            "reason": "; ".join(filter(None, (report["error_message"], words))),
            "cause": cause,
            "sequel": sequel,
            "delay_ns": delay_ns,
            "crashes": crashes,
            "pid": report["pid"],
        }
        state = NodeState.LOAD_FAILED if in_constructor else NodeState.CRASHED
        self.node(at, name, state, unique_id=1, attempt=1, **said)

    def used(
        self,
        at: float,
        key: str,
        memory_kind: MemoryKind = MemoryKind.PSS,
        **numbers: Any,
    ) -> None:
        kind = SubjectKind.NODE if ":/" in key else SubjectKind.PROCESS
        numbers = {"cpu_percent": 0.0, "cpu_seconds": 0.0, "memory_bytes": 10**7} | numbers
        numbers = {"threads": 1, "descriptors": 10, "involuntary_switches": 0} | numbers
        self.events.append(
            ProcessSample(
                stamp_ns=ns(at),
                kind=kind,
                key=key,
                pid=numbers.pop("pid", 7),
                start_time=1,
                memory_kind=memory_kind,
                read_bytes=0,
                write_bytes=0,
                voluntary_switches=0,
                **numbers,
            )
        )

    def group(self, at: float, key: str, **numbers: Any) -> None:
        numbers = {"group": 1, "throttled_seconds": 0.0, "oom_kills": 0, **numbers}
        sample = GroupSample(
            stamp_ns=ns(at),
            kind=SubjectKind.PROCESS,
            key=key,
            cpu_seconds=0.0,
            throttled_periods=0,
            cpu_pressure=0.0,
            memory_pressure=0.0,
            io_pressure=0.0,
            memory_bytes=0,
            processes=1,
            pids_max_hits=numbers.pop("pids_max_hits", 0),
            **numbers,
        )
        self.events.append(sample)

    def machine(self, at: float, **numbers: Any) -> None:
        numbers = {"cpu_percent": 10.0, "cpu_some_avg10": NAN, "disk_free": 10**12} | numbers
        numbers = {"memory_available": 8 * 10**9} | numbers
        self.events.append(
            SystemSample(
                stamp_ns=ns(at),
                core_percent=(),
                core_mhz=(),
                memory_total=16 * 10**9,
                swap_used=0,
                shm_used=0,
                shm_total=0,
                load_1=0.0,
                load_5=0.0,
                load_15=0.0,
                memory_some_avg10=NAN,
                memory_full_avg10=NAN,
                io_some_avg10=NAN,
                io_full_avg10=NAN,
                steal_percent=0.0,
                **numbers,
            )
        )

    def record(self, path: Path, *, finished: bool = True) -> Path:
        """Write it; received when it happened."""
        writer = BagWriter(path)
        writer.metadata(METADATA_NAME, {"name": "made_up", "started_ns": str(START)})
        if self.resolved is not None:
            config = json.dumps(self.resolved).encode()
            writer.attach(topics.RESOLVED, "application/json", config, time=START)
        for number, applied in enumerate(self.applied, 1):
            name = f"{topics.APPLIED}{number}/{topics.RESOLVED}"
            writer.attach(name, "application/json", json.dumps(applied).encode(), time=START)
        channels: dict[Topic, int] = {}
        messages = self.messages + [
            (event.stamp_ns, recorded.topic, recorded.data)
            for event in self.events
            for recorded in convert(event if self.has_codes else without_codes(event))
        ]
        flushed = 0
        for stamp, topic, data in messages:
            if topic not in channels:
                channels[topic] = writer.register(topic)
            if abs(stamp - flushed) >= SECOND:
                writer.flush()
                flushed = stamp
            writer.write(channels[topic], data, log_time=stamp, publish_time=stamp)
        if finished:
            writer.close()
            return path
        writer.flush()
        writer.abandon()
        return path.with_name(f"{path.name}.active")

    def story(self, folder: Path) -> Story:
        return story_of(self.record(folder / "session.mcap"))


@dataclass
class Story:
    """What a recording tells."""

    timeline: Timeline
    findings: tuple[Finding, ...]

    @property
    def parameters(self) -> Parameters:
        return self.timeline.parameters


def _endpoint(text: str, qos: dict[str, int]) -> Endpoint:
    rest, _, kind = text.partition(":")
    is_publisher = ">" in rest
    node, _, topic = rest.partition(">" if is_publisher else "<")
    return Endpoint(topic, node, kind or "std_msgs/msg/String", is_publisher, **qos)


def story_of(path: Path, *, only_failures: bool = False) -> Story:
    timeline = read_timeline(path, only_failures=only_failures)
    return Story(timeline, findings(timeline))


def without_codes(event: RunEvent) -> RunEvent:
    """The same event of the version that wrote no codes."""
    if isinstance(event, NodeStateChanged | ProcessEvent | ContainerStateChanged):
        return replace(event, cause=Cause.NOT_RECORDED, sequel=Sequel.NONE, delay_ns=0, culprit="")
    return event


def parameters(values: dict[str, Any]) -> tuple[dict[str, Any], ...]:
    """Values as ``rcl_interfaces/Parameter``; None is one that is not set."""
    found = []
    for name, value in values.items():
        kind = next((kind for kind, types in TYPES.items() if isinstance(value, types)), None)
        given = {} if kind is None else {"type": kind, kind.field: value}
        found.append({"name": name, "value": given})
    return tuple(found)


def requested(stamp_ns: int, action: str, targets: tuple[str, ...]) -> ActionEvent:
    return ActionEvent(
        stamp_ns=stamp_ns,
        number=1,
        action=action,
        phase=ActionPhase.REQUESTED,
        targets=targets,
        uid=0,
        pid=1,
        command="",
    )


def ns(seconds: float) -> int:
    return START + round(seconds * SECOND)

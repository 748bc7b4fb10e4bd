"""From an event of a run to the messages that record it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple, assert_never

from play_launch.core.events import (
    ComponentEvent,
    ComponentEventKind,
    ContainerState,
    ContainerStateChanged,
    GraphChanged,
    LogRecord,
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
    RunEvent,
)
from play_launch.recording import topics
from play_launch.recording.cdr import log_message, text_bytes
from play_launch.recording.console_format import ERROR, INFO, WARN, line_level

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.recording.topics import Topic

_NANOSECONDS: Final = 1_000_000_000

_ON_THE_WAY: Final = frozenset({NodeState.REQUESTED, NodeState.LOADING})
_STATE_LEVELS: Final[dict[NodeState | ContainerState, int]] = {
    NodeState.LOAD_FAILED: ERROR,
    NodeState.CRASHED: ERROR,
    NodeState.GAVE_UP: ERROR,
    NodeState.LOST: ERROR,
    ContainerState.BACKOFF: WARN,
    ContainerState.GAVE_UP: ERROR,
}


class Recorded(NamedTuple):
    """One message for the bag."""

    topic: Topic
    data: bytes


def is_failure(event: RunEvent) -> bool:
    """Whether an event tells of a failure, so that it must reach the disk at once.

    Output lines are not looked into here: that would cost their producer time.
    """
    match event:
        case ComponentEvent():
            return event.kind in (ComponentEventKind.LOAD_FAILED, ComponentEventKind.CRASHED)
        case ProcessEvent():
            return event.kind is ProcessEventKind.GAVE_UP or (
                event.kind is ProcessEventKind.EXITED
                and (event.exit_code != 0 or event.signal != 0)
            )
        case LogRecord():
            return event.level >= ERROR
        case NodeStateChanged() | ContainerStateChanged():
            return _STATE_LEVELS.get(event.state, INFO) >= ERROR
        case _:
            return False


class Converter:
    """Turns events into CDR messages.

    Importing the message classes costs tens of milliseconds, so that happens at the first event
    that needs them, in the thread that converts. Nothing here calls ``rclpy.init``.
    """

    def __init__(self) -> None:
        """A converter of its own for each thread."""
        self._messages: _Messages | None = None

    def convert(self, event: RunEvent) -> tuple[Recorded, ...]:
        """Return the messages that record ``event``, in the order to be written."""
        match event:
            case OutputLine():
                return (self.output(event)[0],)
            case LogRecord():
                data = log_message(
                    event.stamp_ns,
                    event.level,
                    event.name,
                    event.message,
                    file=event.file,
                    function=event.function,
                    line=event.line,
                )
                everything = Recorded(topics.LOG_ALL, data)
                if event.level < WARN:
                    return (everything,)
                return (everything, Recorded(topics.LOG, data))
            case NodeStateChanged():
                return (Recorded(topics.STATES, _node_state(event)),)
            case ContainerStateChanged():
                return (Recorded(topics.STATES, _container_state(event)),)
            case ComponentEvent():
                return (Recorded(topics.COMPONENT_EVENTS, self._loaded().component(event)),)
            case ProcessEvent():
                return (Recorded(topics.PROCESS_EVENTS, self._loaded().process(event)),)
            case GraphChanged():
                return (Recorded(topics.GRAPH, _graph(event)),)
        assert_never(event)

    def output(self, line: OutputLine) -> tuple[Recorded, int]:
        """Return the message for a line of output, and the level the line was written at."""
        level = line_level(line)
        data = log_message(
            line.stamp_ns,
            level,
            line.process,
            line.text + " [cut]" if line.truncated else line.text,
            file=line.stream.value,
            function=f"pid {line.pid}",
        )
        return Recorded(topics.OUTPUT, data), level

    def _loaded(self) -> _Messages:
        if self._messages is None:
            self._messages = _Messages()
        return self._messages


def _node_state(event: NodeStateChanged) -> bytes:
    facts = [
        f"{label} {value}"
        for label, value in (
            ("pid", event.pid),
            ("unique_id", event.unique_id),
            ("attempt", event.attempt),
            ("crashes", event.crashes),
            ("reloads", event.reloads),
        )
        if value
    ]
    if event.cpu_time_ns:
        facts.append(f"cpu {event.cpu_time_ns / _NANOSECONDS:.1f} s")
    text = event.state.value
    if event.elapsed_ns:
        elapsed = f"{event.elapsed_ns / _NANOSECONDS:.3f} s"
        if event.state in _ON_THE_WAY:
            text += f" for {elapsed}"
        else:
            facts.append(f"{elapsed} after the load was sent")
    if facts:
        text += f" ({', '.join(facts)})"
    return log_message(
        event.stamp_ns,
        _STATE_LEVELS.get(event.state, INFO),
        event.node,
        _with_reason(text, event.reason),
        file=event.container,
        function=event.state.value,
        line=event.index,
    )


def _graph(event: GraphChanged) -> bytes:
    parts = [
        f"{word} {', '.join(names)}"
        for word, names in (("appeared", event.appeared), ("vanished", event.vanished))
        if names
    ]
    text = f"{'; '.join(parts)}; {event.nodes} nodes"
    return log_message(event.stamp_ns, INFO, "graph", text)


def _container_state(event: ContainerStateChanged) -> bytes:
    text = event.state.value
    if event.mechanism:
        text += f" (nodes isolated by {event.mechanism})"
    return log_message(
        event.stamp_ns,
        _STATE_LEVELS.get(event.state, INFO),
        event.container,
        _with_reason(text, event.reason),
        file=event.container,
        function=event.state.value,
    )


def _with_reason(text: str, reason: str) -> str:
    return f"{text}: {reason}" if reason else text


class _Messages:
    """The generated classes and rclpy's serialiser, imported on construction."""

    def __init__(self) -> None:
        # ruff: disable[PLC0415]
        from builtin_interfaces.msg import Time
        from play_launch_msgs.msg import ComponentEvent as ComponentMessage
        from play_launch_msgs.msg import ProcessEvent as ProcessMessage
        from rclpy.serialization import serialize_message

        # ruff: enable[PLC0415]

        # rosidl generates classes without type information that mypy could use.
        self._time: Callable[..., Any] = Time
        self._component: Callable[..., Any] = ComponentMessage
        self._process: Callable[..., Any] = ProcessMessage
        self._serialize: Callable[[Any], bytes] = serialize_message

    def component(self, event: ComponentEvent) -> bytes:
        return self._serialize(
            self._component(
                stamp=self._stamp(event.stamp_ns),
                event_type=int(event.kind),
                unique_id=event.unique_id,
                attempt=event.attempt,
                full_node_name=_text(event.full_node_name),
                package_name=_text(event.package_name),
                plugin_name=_text(event.plugin_name),
                error_message=_text(event.error_message),
                pid=event.pid,
                start_time=event.start_time,
                exit_code=event.exit_code,
                signal=event.signal,
                backtrace=[_text(frame) for frame in event.backtrace],
                confirmed_by=_text(event.confirmed_by),
            )
        )

    def process(self, event: ProcessEvent) -> bytes:
        return self._serialize(
            self._process(
                stamp=self._stamp(event.stamp_ns),
                event_type=int(event.kind),
                name=_text(event.name),
                pid=event.pid,
                start_time=event.start_time,
                exit_code=event.exit_code,
                signal=event.signal,
                restarts=event.restarts,
                message=_text(event.message),
                command=[_text(word) for word in event.command],
            )
        )

    def _stamp(self, stamp_ns: int) -> Any:
        seconds, nanoseconds = divmod(max(stamp_ns, 0), _NANOSECONDS)
        return self._time(sec=min(seconds, 2**31 - 1), nanosec=nanoseconds)


def _text(text: str) -> str:
    return text_bytes(text).decode()

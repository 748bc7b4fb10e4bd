"""Display of a run in a thread of its own: a slow terminal never delays the run."""

from __future__ import annotations

import contextlib
import json
import logging
import sys
import threading
import time
from typing import IO, TYPE_CHECKING, Final, Generic, NamedTuple, TypeVar

from play_launch.cli.output import abandon_stdout, counted, duration, redirect_to_devnull
from play_launch.cli.show.event_lines import DisplayLine, format_lines, line_of, missed_line
from play_launch.config.text import listed
from play_launch.control.event_words import because, event_object
from play_launch.process.exit import Exit
from play_launch.supervisor.events import (
    ContainerState,
    LogRecord,
    OutputLine,
    ProcessEventKind,
    RunEvent,
    Sample,
)
from play_launch.supervisor.view import SystemView

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console, Group
    from rich.live import Live
    from rich.text import Text

    from play_launch.supervisor.events import NodeStateChanged, ProcessEvent
    from play_launch.supervisor.view import ContainerView

_Item = TypeVar("_Item")
_log = logging.getLogger(__name__)
_NO_VIEW: Final = SystemView()
_LINES_LIMIT: Final = 5_000
"""Lines of output waiting to be shown; further ones are left out and counted."""
_OTHERS_LIMIT: Final = 100_000
"""Room for other events; it is used up only if stdout is not read."""
_INTERVAL: Final = 0.05
"""Seconds between two writes."""
_CLOSE_TIMEOUT: Final = 2.0
"""Seconds for the last events at the end of the run."""
_LEAVE_TIMEOUT: Final = 5.0
"""Seconds more for a stdout that takes nothing, when all is recorded."""


class ShownEvent(NamedTuple):
    """An event and the view before and after it; a record of the log has none."""

    event: RunEvent
    before: SystemView
    after: SystemView


class Style(Generic[_Item]):
    """One way to show a run; called in the display's thread."""

    def show(self, batch: Sequence[_Item], missed: int) -> float | None:
        """Show what happened; ``missed`` lines of output before the end of it are missing.

        Returns the seconds after which to be called again even though nothing has happened, or
        None.
        """
        raise NotImplementedError

    def close(self) -> None:
        """Restore the terminal."""


class Screen(Generic[_Item]):
    """Shows what any thread gives it.

    A terminal can be stopped (Ctrl-S) and a pipe can be full; both would block the writing thread.
    When a write to stdout fails (its reader has exited, the disk is full, the terminal was closed),
    the display ends, and the run continues.
    """

    def __init__(self, style: Style[_Item]) -> None:
        self._style = style
        self._lock = threading.Lock()
        self._queue: list[_Item] = []
        self._missed = 0
        self._closing = False
        self._is_off = False
        self._wake = threading.Event()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="display", daemon=True)
        self._thread.start()

    def put(self, item: _Item, *, is_output: bool) -> None:
        """Show something soon; never blocks."""
        if self._is_off:
            return
        room = _LINES_LIMIT + (0 if is_output else _OTHERS_LIMIT)
        with self._lock:
            waiting = len(self._queue)
            if self._closing or waiting >= room:
                self._missed += 1
                return
            self._queue.append(item)
        if not waiting:
            self._wake.set()

    def close(self) -> None:
        with self._lock:
            self._closing = True
        self._end.set()
        self._wake.set()
        self._thread.join(_CLOSE_TIMEOUT)

    def leave(self) -> None:
        """Close it, once all else is done: a reader may come back, or stdout is given up."""
        self.close()
        self._thread.join(_LEAVE_TIMEOUT)
        if self._thread.is_alive():
            abandon_stdout()

    def _run(self) -> None:
        again: float | None = 0.0
        try:
            while True:
                self._wake.wait(again)
                self._end.wait(_INTERVAL)
                self._wake.clear()
                with self._lock:
                    batch, self._queue = self._queue, []
                    missed, self._missed = self._missed, 0
                    closing = self._closing
                again = self._style.show(batch, missed)
                if closing:
                    return
        except OSError as error:
            # A closed terminal answers EIO; SIGHUP decides about the run.
            self._is_off = True
            redirect_to_devnull(sys.stdout)
            if not isinstance(error, BrokenPipeError):
                _log.warning("the display is off: stdout cannot be written: %s", error.strerror)
        finally:
            # Also after an exception: the cursor must be visible again.
            with contextlib.suppress(OSError, ValueError):
                self._style.close()


class Display(Screen[ShownEvent]):
    """Shows the events of a run, samples excepted, and without output where ``quiet``."""

    def __init__(self, style: Style[ShownEvent], *, quiet: bool = False) -> None:
        self._hidden = (Sample, OutputLine) if quiet else Sample
        super().__init__(style)

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:
        if not isinstance(event, self._hidden):
            self.put(ShownEvent(event, before, after), is_output=isinstance(event, OutputLine))

    def publish_alone(self, event: LogRecord | OutputLine) -> None:
        """Show what neither changes the view nor needs one, in any thread."""
        self.publish(event, _NO_VIEW, _NO_VIEW)


# Styles.

_REDRAW: Final = 0.5
"""Seconds between two frames while something is pending."""
_OTHER_ROWS: Final = 3
"""Rows that are kept free: the totals, the line about omitted rows, and the prompt."""
_TROUBLE: Final = frozenset({ContainerState.BACKOFF, ContainerState.GAVE_UP})


def encode(values: dict[str, object]) -> str:
    """Write one object on one line; plain ASCII, so that no stream's encoding can refuse it."""
    return json.dumps(values, separators=(",", ":"))


class JsonStyle(Style[ShownEvent]):
    """Events as JSON, one object a line, for programs that watch a run."""

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream

    def show(self, batch: Sequence[ShownEvent], missed: int) -> None:
        objects = [event_object(shown.event) for shown in batch]
        if missed:
            objects.append({"event": "missed", "lines": missed})
        if objects:
            self._stream.write("".join(f"{encode(values)}\n" for values in objects))
            self._stream.flush()


class PlainStyle(Style[ShownEvent]):
    """Lines with a time, for files, pipes and journals."""

    def __init__(self, stream: IO[str], *, colour: bool) -> None:
        self._stream = stream
        self._colour = colour

    def show(self, batch: Sequence[ShownEvent], missed: int) -> None:
        if lines := _lines(batch, missed):
            self._stream.write(format_lines(lines, times=True, colour=self._colour))
            self._stream.flush()


class LiveStyle(Style[ShownEvent]):
    """Lines scroll by above a view of what is up and what is missing."""

    def __init__(self, console: Console, *, colour: bool) -> None:
        self._console = console
        self._colour = colour
        self._view = SystemView()
        self._live: Live | None = None

    def show(self, batch: Sequence[ShownEvent], missed: int) -> float | None:
        from rich.live import Live  # noqa: PLC0415 - not needed where there is no terminal

        if self._live is None:
            self._live = Live(
                console=self._console,
                auto_refresh=False,
                transient=True,
                redirect_stdout=False,
                redirect_stderr=False,
            )
            self._live.start()
        for shown in batch:
            if not isinstance(shown.event, LogRecord):
                self._view = shown.after
        lines = [line for line in _lines(batch, missed) if not line.is_progress]
        if lines:
            text = format_lines(lines, times=False, colour=self._colour)
            self._console.out(text, end="", highlight=False)
        view = live_view(self._view, time.time_ns(), self._console.height)
        self._live.update(view, refresh=True)
        return _REDRAW if self._view.waiting or self._view.total == 0 else None

    def close(self) -> None:
        if self._live is not None:
            self._live.stop()


def _lines(batch: Sequence[ShownEvent], missed: int) -> list[DisplayLine]:
    lines = [line for shown in batch if (line := line_of(*shown))]
    return [*lines, missed_line(missed)] if missed else lines


def live_view(view: SystemView, now_ns: int, height: int) -> Group:
    """Draw a view for a terminal of ``height`` rows; a row too long for it is cut.

    Containers with trouble come first, complete ones last. When all are complete only the totals
    remain.
    """
    from rich.console import Group  # noqa: PLC0415 - as above

    containers = sorted(view.containers.values(), key=_urgency)
    missing = [each for each in containers if not is_complete(each)]
    rows = [_container_row(each, now_ns) for each in missing]
    rows += [_row(each.name, process_status(each), "red") for each in view.failed_processes]
    if rows:
        rows += [_container_row(each, now_ns) for each in containers if is_complete(each)]
    room = max(height - _OTHER_ROWS, 1)
    if len(rows) > room:
        rows = [*rows[:room], _text(f"  … and {len(rows) - room} more", "dim")]
    return Group(*rows, _totals(view, len(containers) - len(missing)))


def _totals(view: SystemView, complete: int) -> Text:
    if not view.containers and not view.processes:
        return _text("starting", "bold")
    containers = counted(len(view.containers), "container")
    text = f"{view.loaded}/{view.total} nodes loaded, {complete}/{containers} complete"
    if view.processes:
        running = sum(process.pid != 0 for process in view.processes.values())
        text += f", {running}/{counted(len(view.processes), 'process')} running"
    is_up = complete == len(view.containers) and not view.failed_processes
    return _text(text, "green" if is_up else "bold")


def _container_row(container: ContainerView, now_ns: int) -> Text:
    style = "not bold"
    if container.failed or container.state is ContainerState.GAVE_UP:
        style = "not bold red"
    elif is_complete(container):
        style = "not bold green"
    elif container.state in _TROUBLE:
        style = "not bold yellow"
    return _row(container.name, container_status(container, now_ns), style)


def _row(name: str, status: str, style: str) -> Text:
    return _text(f"  {name}  ", "bold").append(status, style)


def _text(text: str, style: str) -> Text:
    from rich.text import Text  # noqa: PLC0415 - as above

    return Text(text, style=style, no_wrap=True, overflow="ellipsis")


def _urgency(container: ContainerView) -> tuple[bool, bool, str]:
    is_troubled = bool(container.failed) or container.state in _TROUBLE
    return not is_troubled, container.state is ContainerState.STOPPED, container.name


# States in words.

_SHOWN_AFTER_NS: Final = 2_000_000_000
"""A shorter wait is shown without its time."""


def container_status(container: ContainerView, now_ns: int = 0) -> str:
    """Describe a container and its nodes at ``now_ns`` (nanoseconds since the epoch).

    For example ``loaded 3/4, waiting on /talker … 12 s``; without ``now_ns`` no time is given.
    """
    if container.state is not ContainerState.RUNNING:
        is_starting = container.state is ContainerState.STARTING
        waited = _waited(container.stamp_ns, now_ns) if is_starting else ""
        return because(container.state.value, container.reason) + waited
    parts = [f"loaded {container.loaded}/{container.total}"]
    if container.failed:
        parts.append(f"failed: {node_names(container.failed)}")
    if container.unloaded:
        parts.append(f"unloaded: {node_names(container.unloaded)}")
    if waiting := container.waiting:
        oldest = min(node.stamp_ns for node in waiting)
        parts.append(f"waiting on {node_names(waiting)}{_waited(oldest, now_ns)}")
    return ", ".join(parts)


def is_complete(container: ContainerView) -> bool:
    return container.state is ContainerState.RUNNING and container.loaded == container.total


def process_status(process: ProcessEvent) -> str:
    """Describe an ordinary process: ``running``, ``exited with signal 11 (SIGSEGV)`` …."""
    match process.kind:
        case ProcessEventKind.EXITED:
            return ending(process)
        case ProcessEventKind.RESTARTING | ProcessEventKind.GAVE_UP:
            return because(process.kind.name.lower().replace("_", " "), process.message)
        case ProcessEventKind.STOPPING | ProcessEventKind.STOPPED:
            return process.kind.name.lower()
        case ProcessEventKind.WAITING:
            return process.message
        case _:
            return "running"


def ending(process: ProcessEvent) -> str:
    return str(Exit(code=process.exit_code, signal=process.signal))


def _waited(since_ns: int, now_ns: int) -> str:
    waited = now_ns - since_ns
    return f" … {duration(waited)}" if since_ns and waited >= _SHOWN_AFTER_NS else ""


def node_names(nodes: tuple[NodeStateChanged, ...]) -> str:
    return listed([node.node for node in nodes], 1)

"""The summary at the end of a run: tables for people, or one object for programs."""

from __future__ import annotations

import signal
from collections import Counter
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import asdict

from play_launch.cli.output import RED, RESET, YELLOW, counted, printable, size, table
from play_launch.cli.show.display import (
    container_status,
    ending,
    is_complete,
    node_names,
    process_status,
)
from play_launch.config.node_key import NodeKey
from play_launch.process.exit import UNKNOWN_STATUS
from play_launch.supervisor.events import ContainerState, NodeState, ProcessEventKind, SubjectKind
from play_launch.supervisor.view import has_failed

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from play_launch.cli.run import GroupTotal
    from play_launch.recording.limits import RecordingSummary
    from play_launch.supervisor.events import ProcessEvent
    from play_launch.supervisor.view import ContainerView, SystemView

    Used = Mapping[tuple[SubjectKind, str], GroupTotal]
    _Cell = str | int | tuple[str | int, str]
    """Its text, and its colour if it has one."""

_NO_GROUPS: Final[Used] = {}


class Summary(Struct, frozen=True):
    """What the summary is made of."""

    view: SystemView
    """The system when its end began: what was up then."""
    final: SystemView
    """The system after that: how each process ended."""
    recording: RecordingSummary
    used: Used = _NO_GROUPS
    """Usage of control groups."""

    def text(self, *, colour: bool) -> str:
        """Return tables of containers and processes, failed nodes, and the recording."""

        def paint(cell: _Cell) -> str:
            text, style = cell if isinstance(cell, tuple) else (cell, "")
            clean = printable(str(text))
            return f"{style}{clean}{RESET}" if colour and style else clean

        lines: list[str] = []
        for titles, rows in self._tables():
            if rows:
                cells = [[paint(cell) for cell in row] for row in rows]
                lines += [*table(titles.split("|"), cells), ""]
        for node in (*self.view.failed, *self.view.unloaded):
            reason = f": {node.reason}" if node.reason else ""
            text = f"{node.node} ({node.container}): {node.state.value}{reason}"
            lines.append(paint((text, "" if str(node.key) in self.view.dismissed else RED)))
        lines.append(recording_line(self.recording))
        if self.recording.error:
            lines.append(paint((f"the recording stopped early: {self.recording.error}", RED)))
        return "\n".join(lines)

    def _tables(self) -> Iterator[tuple[str, list[tuple[_Cell, ...]]]]:
        view = self.view
        rows: list[tuple[_Cell, ...]] = []
        for each in view.containers.values():
            end = container_at_end(each, self.final.containers.get(each.name, each))
            failed, restarts = _alarm(len(each.failed)), _alarm(each.process.restarts)
            rows.append((each.name, each.total, each.loaded, failed, restarts, (end, YELLOW)))
        if len(rows) > 1:
            restarts = _alarm(sum(each.process.restarts for each in view.containers.values()))
            name, failed = counted(len(rows), "container"), _alarm(len(view.failed))
            rows.append((name, view.total, view.loaded, failed, restarts, ""))
        yield "container|nodes|loaded|failed|restarts|", rows
        rows = []
        for process in view.processes.values():
            state = self._at_end(process), RED if self._has_failed(process) else ""
            rows.append((process.name, _alarm(process.restarts), state))
        yield "process|restarts|state", rows
        rows = []
        names = Counter(node.node for node in view.crashed)
        for node in view.crashed:
            # Nodes without a name can have the same label in two containers.
            name = node.node if names[node.node] == 1 else str(node.key)
            is_up = node.state is NodeState.LOADED
            state = node.state.value, "" if is_up else RED
            rows.append(
                (name, _alarm(node.crashes), node.reloads, node.pid if is_up else "", state)
            )
        yield "node that crashed|crashes|reloads|pid|state", rows
        rows = []
        for (kind, key), total in self.used.items():
            if total.is_throttled:
                name = NodeKey.parsed(key).name if kind is SubjectKind.NODE else key
                throttled = f"{total.throttled_seconds:.2f} s" if total.throttled_periods else ""
                kills, hits = _alarm(total.oom_kills), _alarm(total.pids_max_hits)
                rows.append((name, f"{total.cpu_seconds:.2f} s", throttled, kills, hits))
        yield "throttled by cgroup limits|CPU time|throttled|OOM kills|pids_max hits", rows

    def as_object(self, exit_code: int) -> dict[str, object]:
        recording = asdict(self.recording)
        return {
            "event": "summary",
            "exit_code": exit_code,
            "containers": [
                _container_object(each, self.final.containers.get(each.name, each))
                for each in self.view.containers.values()
            ],
            "processes": [
                {
                    "name": each.name,
                    "state": self._at_end(each),
                    **_end_object(self.final.processes.get(each.name, each)),
                    "failed": self._has_failed(each),
                    "restarts": each.restarts,
                }
                for each in self.view.processes.values()
            ],
            "cgroups": [
                {"kind": kind.name.lower(), "key": key, **asdict(total)}
                for (kind, key), total in self.used.items()
            ],
            "recording": {**recording, "path": str(self.recording.path)},
        }

    def _at_end(self, process: ProcessEvent) -> str:
        final = self.final.processes.get(process.name, process)
        return process_at_end(process, final, dismissed=process.name in self.view.dismissed)

    def _has_failed(self, process: ProcessEvent) -> bool:
        return has_failed(process) and process.name not in self.view.dismissed


def _alarm(number: int) -> _Cell:
    return number, RED if number else ""


def recording_line(recording: RecordingSummary) -> str:
    """``Recording: /x/session.mcap (1,234 messages, 56 kB)``."""
    facts = [f"{recording.messages:,} messages", size(recording.bytes)]
    if recording.parts > 1:
        facts.insert(0, f"{recording.parts} files")
    if recording.removed_parts:
        facts.append(f"the first {counted(recording.removed_parts, 'file')} removed")
    if recording.dropped:
        facts.append(f"{recording.dropped:,} events dropped")
    if recording.interruptions:
        facts.append(f"interrupted {counted(recording.interruptions, 'time')}")
    if recording.topic_drops:
        facts.append(f"{recording.topic_drops:,} messages of topics dropped")
    return f"Recording: {recording.path} ({', '.join(facts)})"


def _container_object(container: ContainerView, final: ContainerView) -> dict[str, object]:
    return {
        "name": container.name,
        "state": container.state.value,
        **_end_object(final.process),
        "nodes": container.total,
        "loaded": container.loaded,
        "failed": [node.node for node in container.failed],
        "unloaded": [node.node for node in container.unloaded],
        "waiting": [node.node for node in container.waiting],
        "restarts": container.process.restarts,
        "pid": container.process.pid,
        "mechanism": container.mechanism,
        "crashes": container.crashes,
        "crashed_when_stopped": [node.node for node in final.crashed_since(container)],
        "details": [
            {
                "key": str(node.key),
                "name": node.node,
                "state": node.state.value,
                "pid": node.pid,
                "crashes": node.crashes,
                "reloads": node.reloads,
            }
            for node in container.nodes.values()
        ],
    }


def _end_object(process: ProcessEvent) -> dict[str, object]:
    """Return the end of its last process; null if unknown or still running."""
    has_ended = process.kind is ProcessEventKind.EXITED
    is_known = not process.signal and process.exit_code != UNKNOWN_STATUS
    return {
        "exit_code": process.exit_code if has_ended and is_known else None,
        "signal": process.signal if has_ended and process.signal else None,
    }


_STOP_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)


def container_at_end(before: ContainerView, after: ContainerView) -> str:
    """Describe a container of a run that is over; empty: it had all of its nodes, and stopped well.

    ``before`` is as it was when the end began, ``after`` as it is now.
    """
    state = "" if is_complete(before) else container_status(before)
    if state and before.state in {ContainerState.STARTING, ContainerState.STOPPING}:
        state = f"was {state}"
    crashed = after.crashed_since(before)
    crashes = f"crashed when stopped: {node_names(crashed)}" if crashed else ""
    stopped = stop_problem(after.process) if before.process.pid else ""
    return "; ".join(each for each in (state, crashes, stopped) if each)


def process_at_end(before: ProcessEvent, after: ProcessEvent, *, dismissed: bool = False) -> str:
    """Describe a process of a run that is over; ``dismissed``: an operator had stopped it."""
    match before.kind:
        case ProcessEventKind.EXITED if dismissed:
            return stop_problem(before) or "stopped"
        case ProcessEventKind.EXITED | ProcessEventKind.GAVE_UP:
            return process_status(before)
        case ProcessEventKind.RESTARTING:
            return f"not restarted: {ending(before)}"
        case ProcessEventKind.WAITING:
            return f"not started: {before.message}"
        case _ if after.kind is ProcessEventKind.EXITED:
            return stop_problem(after) or "stopped"
        case _:
            return process_status(after)


def stop_problem(process: ProcessEvent) -> str:
    """Describe an unexpected end of a stopped process; empty if it exited as expected."""
    # A shell reports a signal as 128 more.
    expected = {0, *(128 + number for number in _STOP_SIGNALS)}
    is_expected = process.signal in _STOP_SIGNALS or (
        not process.signal and process.exit_code in expected
    )
    if is_expected or process.kind is not ProcessEventKind.EXITED:
        return ""
    return f"stopped: {ending(process)}"

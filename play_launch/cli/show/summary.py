"""What a run came to: the last thing that is shown."""

from __future__ import annotations

from collections import Counter
from typing import IO, TYPE_CHECKING, Final

from msgspec.structs import asdict
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from play_launch.cli.check import counted
from play_launch.cli.output import size
from play_launch.cli.show.status import container_at_end, process_at_end
from play_launch.config.node_key import NodeKey
from play_launch.process.exit import UNKNOWN_STATUS
from play_launch.supervisor.events import NodeState, ProcessEventKind, SubjectKind

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.cli.show.group_totals import GroupTotal
    from play_launch.recording.limits import RecordingSummary
    from play_launch.supervisor.view import ContainerView, ProcessView, SystemView

    Used = Mapping[tuple[SubjectKind, str], GroupTotal]

_PIPE_WIDTH: Final = 200
"""Columns of a table that no terminal limits."""
_NO_GROUPS: Final[Used] = {}


def print_summary(
    view: SystemView,
    final: SystemView,
    recording: RecordingSummary,
    *,
    stream: IO[str],
    colour: bool,
    used: Used = _NO_GROUPS,
) -> None:
    """Print a table of containers and processes, what is not there and why, and the recording.

    ``view`` is the system at the moment its end began: what was up then. ``final`` is the system
    after that, which says how each process ended. ``used`` is what control groups came to.
    """
    terminal = stream.isatty()
    console = Console(
        file=stream,
        width=None if terminal else _PIPE_WIDTH,
        no_color=not colour,
        force_terminal=colour,
        highlight=False,
        soft_wrap=False,
    )
    if view.containers:
        console.print(_containers(view, final))
    if view.processes:
        console.print(_processes(view, final))
    if view.crashed:
        console.print(_crashed(view))
    if held_back := {whose: total for whose, total in used.items() if total.is_held_back}:
        console.print(_held_back(held_back))
    for node in (*view.failed, *view.unloaded):
        reason = f": {node.reason}" if node.reason else ""
        style = "" if str(node.key) in view.dismissed else "red"
        console.print(
            Text(f"{node.node} ({node.container}): {node.state.value}{reason}", style=style),
            soft_wrap=True,
        )
    # Not wrapped and not cut, so that the path can be copied.
    console.print(Text(recording_line(recording)), soft_wrap=True)
    if recording.error:
        console.print(
            Text(f"the recording stopped early: {recording.error}", "red"), soft_wrap=True
        )


def recording_line(recording: RecordingSummary) -> str:
    """``Recording: /x/session.mcap (1,234 messages, 56 kB)``."""
    facts = [f"{recording.messages:,} messages", size(recording.bytes)]
    if recording.parts > 1:
        facts.insert(0, f"{recording.parts} files")
    if recording.dropped:
        facts.append(f"{recording.dropped:,} events dropped")
    if recording.interruptions:
        facts.append(f"interrupted {counted(recording.interruptions, 'time')}")
    if recording.topic_drops:
        facts.append(f"{recording.topic_drops:,} messages of topics dropped")
    return f"Recording: {recording.path} ({', '.join(facts)})"


def summary_object(
    view: SystemView,
    final: SystemView,
    recording: RecordingSummary,
    *,
    exit_code: int,
    used: Used = _NO_GROUPS,
) -> dict[str, object]:
    """Give the same for machines."""
    return {
        "event": "summary",
        "exit_code": exit_code,
        "containers": [
            _container_object(each, final.containers.get(each.name, each))
            for each in view.containers.values()
        ],
        "processes": [
            _process_object(each, final.processes.get(each.name, each), view)
            for each in view.processes.values()
        ],
        "cgroups": [
            {"kind": kind.name.lower(), "key": key, **asdict(total)}
            for (kind, key), total in used.items()
        ],
        "recording": {
            "path": str(recording.path),
            "messages": recording.messages,
            "dropped": recording.dropped,
            "topic_drops": recording.topic_drops,
            "bytes": recording.bytes,
            "parts": recording.parts,
            "interruptions": recording.interruptions,
            "error": recording.error,
        },
    }


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


def _process_object(
    process: ProcessView, final: ProcessView, view: SystemView
) -> dict[str, object]:
    return {
        "name": process.name,
        "state": _at_end(process, final, view),
        **_end_object(final),
        "failed": _has_failed(process, view),
        "restarts": process.restarts,
    }


def _end_object(process: ProcessView) -> dict[str, object]:
    """Return the end of its last process; null if unknown or still running."""
    has_ended = process.kind is ProcessEventKind.EXITED
    is_known = not process.signal and process.exit_code != UNKNOWN_STATUS
    return {
        "exit_code": process.exit_code if has_ended and is_known else None,
        "signal": process.signal if has_ended and process.signal else None,
    }


def _at_end(process: ProcessView, final: ProcessView, view: SystemView) -> str:
    return process_at_end(process, final, dismissed=process.name in view.dismissed)


def _has_failed(process: ProcessView, view: SystemView) -> bool:
    return process.failed and process.name not in view.dismissed


def _held_back(used: Used) -> Table:
    table = _table(
        "throttled by cgroup limits", "CPU time", "throttled", "OOM kills", "pids_max hits"
    )
    for (kind, key), total in used.items():
        name = NodeKey.parsed(key).name if kind is SubjectKind.NODE else key
        table.add_row(
            Text(name),
            f"{total.cpu_seconds:.2f} s",
            f"{total.throttled_seconds:.2f} s" if total.throttled_periods else "",
            _alarming(total.oom_kills),
            _alarming(total.pids_max_hits),
        )
    return table


def _containers(view: SystemView, final: SystemView) -> Table:
    table = _table("container", "nodes", "loaded", "failed", "restarts", "")
    for container in view.containers.values():
        status = container_at_end(container, final.containers.get(container.name, container))
        table.add_row(
            Text(container.name),
            str(container.total),
            str(container.loaded),
            _alarming(len(container.failed)),
            _alarming(container.process.restarts),
            Text(status, "yellow"),
        )
    if len(view.containers) > 1:
        table.add_section()
        failed = sum(len(each.failed) for each in view.containers.values())
        restarts = sum(each.process.restarts for each in view.containers.values())
        name = counted(len(view.containers), "container")
        table.add_row(
            name, str(view.total), str(view.loaded), _alarming(failed), _alarming(restarts), ""
        )
    return table


def _crashed(view: SystemView) -> Table:
    table = _table("node that crashed", "crashes", "reloads", "pid", "state")
    names = Counter(node.node for node in view.crashed)
    for node in view.crashed:
        is_there = node.state is NodeState.LOADED
        table.add_row(
            # Nodes without a name can have the same label in two containers.
            Text(node.node if names[node.node] == 1 else str(node.key)),
            _alarming(node.crashes),
            str(node.reloads),
            str(node.pid) if is_there else "",
            Text(node.state.value, "" if is_there else "red"),
        )
    return table


def _processes(view: SystemView, final: SystemView) -> Table:
    table = _table("process", "state", "restarts")
    for process in view.processes.values():
        status = _at_end(process, final.processes.get(process.name, process), view)
        state = Text(status, "red" if _has_failed(process, view) else "")
        table.add_row(Text(process.name), state, _alarming(process.restarts))
    return table


def _table(first: str, *others: str) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, header_style="bold")
    table.add_column(first, overflow="fold")
    for name in others:
        is_text = name in {"", "state"}
        table.add_column(
            name, justify="left" if is_text else "right", overflow="fold", min_width=len(name)
        )
    return table


def _alarming(number: int) -> Text:
    return Text(str(number), "red" if number else "")

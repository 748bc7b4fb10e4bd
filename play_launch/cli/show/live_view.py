"""The live view of a run on a terminal: one line for each container, until all are complete."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from rich.console import Group
from rich.text import Text

from play_launch.cli.check import counted
from play_launch.cli.show.status import container_status, is_complete, process_status
from play_launch.supervisor.events import ContainerState

if TYPE_CHECKING:
    from play_launch.supervisor.view import ContainerView, SystemView

_OTHER_ROWS: Final = 3
"""Rows that are kept free: the totals, the line about omitted rows, and the prompt."""
_TROUBLE: Final = frozenset({ContainerState.BACKOFF, ContainerState.GAVE_UP})


def live_view(view: SystemView, now_ns: int, height: int) -> Group:
    """Draw a view for a terminal of ``height`` rows; a row too long for it is cut.

    Containers with trouble come first, complete ones last. When all are complete only the totals
    remain.
    """
    containers = sorted(view.containers.values(), key=_urgency)
    complete = [container for container in containers if is_complete(container)]
    rows = [_container_row(each, now_ns) for each in containers if not is_complete(each)]
    rows += [
        _row(process.name, process_status(process), "red") for process in view.failed_processes
    ]
    if rows:
        rows += [_container_row(each, now_ns) for each in complete]
    room = max(height - _OTHER_ROWS, 1)
    if len(rows) > room:
        left_out = len(rows) - room
        rows = [*rows[:room], _text(f"  … and {left_out} more", "dim")]
    return Group(*rows, _totals(view))


def _totals(view: SystemView) -> Text:
    if not view.containers and not view.processes:
        return _text("starting", "bold")
    complete = sum(is_complete(container) for container in view.containers.values())
    text = (
        f"{view.loaded}/{view.total} nodes loaded, "
        f"{complete}/{counted(len(view.containers), 'container')} complete"
    )
    if view.processes:
        running = sum(process.pid != 0 for process in view.processes.values())
        text += f", {running}/{counted(len(view.processes), 'process')} running"
    all_there = complete == len(view.containers) and not view.failed_processes
    return _text(text, "green" if all_there else "bold")


def _container_row(container: ContainerView, now_ns: int) -> Text:
    return _row(container.name, container_status(container, now_ns), _style(container))


def _row(name: str, status: str, style: str) -> Text:
    row = _text(f"  {name}  ", "bold")
    row.append(status, style)
    return row


def _text(text: str, style: str) -> Text:
    return Text(text, style=style, no_wrap=True, overflow="ellipsis")


def _style(container: ContainerView) -> str:
    if container.failed or container.state is ContainerState.GAVE_UP:
        return "not bold red"
    if is_complete(container):
        return "not bold green"
    return "not bold yellow" if container.state in _TROUBLE else "not bold"


def _urgency(container: ContainerView) -> tuple[bool, bool, str]:
    troubled = bool(container.failed) or container.state in _TROUBLE
    stopped = container.state is ContainerState.STOPPED
    return not troubled, stopped, container.name

"""The exit code of a run.

====== ======================================================================
0      everything that was declared was there when the run ended
1      a node failed: it did not load, or crashed and is not loaded again,
       or did not reach the state that ``autostart`` requests; or a process
       crashed while it was being stopped
3      nothing failed, but something was missing: a node that is not loaded,
       a container or a process between two starts
128+n  the run was ended by signal n
====== ======================================================================

What an operator stopped or unloaded counts neither as failed nor as missing, until it is started or
loaded again.

A signal comes first, as shells expect it. (2 is for the command line and the configuration; a run
never gets that far.)
"""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING

from play_launch.supervisor.outcome import ENDING_SIGNALS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.supervisor.view import ProcessView, SystemView


class ExitCode(IntEnum):
    """Exit codes of all commands; docs/exit-codes.md explains them."""

    OK = 0
    NODE_FAILED = 1
    """Failure: of a node, of a request; or `diff`, `compare`, `explain` found something."""
    USAGE = 2
    NODES_MISSING = 3
    """Something that was declared does not run, and has not failed."""
    TIMEOUT = 4
    DAMAGED = 5
    """A recording could not be read completely."""
    SIGNAL_BASE = 128


def exit_code(view: SystemView, final: SystemView, signum: int | None) -> int:
    """Give the exit code.

    Args:
        view: The system at the moment in which the run began to end, so before it was stopped.
        final: The system after that.
        signum: The signal that ended the run; None for another end.
    """
    if signum is not None:
        return ExitCode.SIGNAL_BASE + signum
    expected = view.expected
    if expected.failed or expected.gave_up or expected.failed_processes or expected.failed_managed:
        return ExitCode.NODE_FAILED
    if crashed_while_stopped(view, final):
        return ExitCode.NODE_FAILED
    if not expected.is_complete:
        return ExitCode.NODES_MISSING
    return ExitCode.OK


def crashed_while_stopped(view: SystemView, final: SystemView) -> list[str]:
    """Name what ran when the end began, and crashed before it had stopped; see `exit_code`."""
    from play_launch.supervisor.events import ProcessEventKind  # noqa: PLC0415 - commands use ExitCode

    return [
        *(
            name
            for name, before, after in _processes(view, final)
            if before.pid
            and after.kind is ProcessEventKind.EXITED
            and after.signal
            and after.signal not in ENDING_SIGNALS
        ),
        *(
            str(node.key)
            for name, container in view.containers.items()
            if name in final.containers
            for node in final.containers[name].crashed_since(container)
        ),
    ]


def _processes(
    view: SystemView, final: SystemView
) -> Iterator[tuple[str, ProcessView, ProcessView]]:
    for name, container in view.containers.items():
        if name in final.containers:
            yield name, container.process, final.containers[name].process
    for name, process in view.processes.items():
        if name in final.processes:
            yield name, process, final.processes[name]

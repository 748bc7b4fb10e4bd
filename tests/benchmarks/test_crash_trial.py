"""How a trial goes on, ends and helps, with a scripted supervisor."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest

from benchmarks.crash.cases import Case, Kind
from benchmarks.crash.tally import SECOND
from benchmarks.crash.trial import FIGURES, NEIGHBOURS, VICTIM, Trial
from benchmarks.figures import Figures
from play_launch.supervisor.events import (
    ComponentEvent,
    ComponentEventKind,
    ProcessEvent,
    ProcessEventKind,
    RunEvent,
)
from play_launch.supervisor.view import SystemView

PID = 4_000_000_000
"""Of no process: larger than any pid."""
DIED_AT, LAST_BEATS = 2, (8 + 2, 16 + 2)


class Script:
    """A trial of two crashes, and what it did."""

    def __init__(self, figures: Figures) -> None:
        self.now = 100 * SECOND
        self.signals: list[tuple[int, int]] = []
        self.stops = 0
        self.figures = figures
        self.trial = Trial(
            Case("isolated", Kind("segv", "callback"), 2),
            figures,
            stop=self._stop,
            send=lambda pid, number: self.signals.append((pid, number)),
            clock=lambda: int(self.now),
        )
        self.process(ProcessEventKind.STARTED)
        for name in (*NEIGHBOURS, VICTIM):
            self.component(ComponentEventKind.LOADED, name)

    def _stop(self) -> None:
        self.stops += 1

    def publish(self, event: RunEvent) -> None:
        self.trial.publish(event, SystemView(), SystemView())

    def process(self, kind: ProcessEventKind) -> None:
        self.publish(ProcessEvent(stamp_ns=0, kind=kind, name="/lab", pid=PID))

    def component(self, kind: ComponentEventKind, name: str = VICTIM) -> None:
        self.publish(
            ComponentEvent(
                stamp_ns=0,
                kind=kind,
                container="/lab",
                unique_id=1,
                attempt=1,
                full_node_name=name,
                package_name="",
                plugin_name="",
            )
        )

    def crash(self) -> None:
        self.figures[DIED_AT] = int(self.now)
        self.component(ComponentEventKind.CRASHED)
        self.component(ComponentEventKind.LOADED)

    def beat(self, *places: int) -> None:
        for place in places:
            self.figures[place] = int(self.now)

    def pass_time(self, seconds: float, *beating: int) -> None:
        self.now += seconds * SECOND
        self.beat(*beating)
        self.trial.look(int(self.now))


@pytest.fixture
def script() -> Iterator[Script]:
    with Figures(FIGURES) as figures:
        yield Script(figures)


def test_it_ends_after_the_last_crash(script: Script) -> None:
    script.crash()
    assert script.stops == 0
    script.crash()
    assert script.stops == 1
    script.crash()
    assert script.trial.tally.crashes == 2


def test_it_does_not_end_while_a_neighbour_is_stuck(script: Script) -> None:
    script.crash()
    script.pass_time(1.0, LAST_BEATS[0])
    script.crash()
    assert script.stops == 0
    script.pass_time(0.1, *LAST_BEATS)
    assert script.stops == 1
    assert max(script.trial.tally.gap_ms) == pytest.approx(1000.0)
    assert script.signals == []


def test_a_victim_that_does_not_come_back_is_helped_once(script: Script) -> None:
    script.crash()
    for _ in range(13):
        script.pass_time(1.0, *LAST_BEATS)
    script.pass_time(1.0, *LAST_BEATS)
    assert script.signals == [(PID, signal.SIGKILL)]
    script.process(ProcessEventKind.EXITED)
    tally = script.trial.tally
    assert (tally.restarts, tally.undetected, tally.recovered) == (1, 1, 0)
    script.process(ProcessEventKind.STARTED)
    for name in (VICTIM, *NEIGHBOURS):
        script.component(ComponentEventKind.LOADED, name)
    assert tally.recovered == 1


def test_a_neighbour_that_nobody_misses_is_noticed(script: Script) -> None:
    for _ in range(13):
        script.pass_time(1.0, LAST_BEATS[1])
        script.component(ComponentEventKind.CRASHED)
        script.component(ComponentEventKind.LOADED)
    assert script.signals == [(PID, signal.SIGKILL)]


def test_a_container_that_the_supervisor_kills_is_not_helped(script: Script) -> None:
    script.crash()
    script.pass_time(4.0, *LAST_BEATS)
    script.process(ProcessEventKind.STOPPING)
    script.process(ProcessEventKind.EXITED)
    assert script.trial.tally.detection_s == [4.0]
    assert (script.trial.tally.restarts, script.trial.tally.undetected) == (1, 0)
    assert script.signals == []

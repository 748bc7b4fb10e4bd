"""One trial: a container with a node that dies again and again, and two neighbours.

The supervisor is the real one, with its actors and control channels, in this process; only its
pauses before reloads are switched off.
"""

from __future__ import annotations

import asyncio
import os
import random
import signal
import time
from collections.abc import Callable
from typing import Final

from benchmarks.crash.cases import Case
from benchmarks.crash.footprint import Footprint, footprint
from benchmarks.crash.tally import SECOND, Tally
from benchmarks.figures import Figures
from benchmarks.systems import Node, system
from play_launch.config.model import ReplayConfig
from play_launch.runtime.publisher import Publisher
from play_launch.runtime.run import RunOutcome, run_system
from play_launch.runtime.signals import StopRequests
from play_launch.supervisor.events import (
    ComponentEvent,
    ComponentEventKind,
    ContainerState,
    ContainerStateChanged,
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
    RunEvent,
)
from play_launch.supervisor.view import SystemView

VICTIM: Final = "/victim"
NEIGHBOURS: Final = ("/left", "/right")
_ALL_NODES: Final = {VICTIM, *NEIGHBOURS}
# Where the components leave their figures.
_LIVES, _VICTIM_PID, _DIED_AT = 0, 1, 2
_METRONOMES: Final = (8, 16)
_LAST_BEAT, _LONGEST_GAP = 2, 3
FIGURES: Final = 24

_DELAY, _SPREAD = 0.005, 0.02
"""Seconds from being loaded to death: at least, and a random part."""
_QUIET_WINDOW: Final = 0.03
"""Seconds between two checks of the neighbours where no node dies."""
STUCK_AFTER: Final = 12.0
"""Seconds without any progress after which we help; the supervisor should in 5."""
_SILENT: Final = 0.2
"""Seconds without a beat after which a neighbour with a 1 kHz timer is taken for stuck."""
_SAMPLES: Final = 20
"""How often in a trial the container's footprint is taken."""
_LOOK_EVERY: Final = 0.25
_LEAK_TEXT: Final = "could not clean up after"
_DOUBTS: Final = (
    "it died inside the middleware or the allocator",
    "of its threads could not be stopped in a harmless place",
)


def configuration(case: Case, figures: Figures) -> ReplayConfig:
    kind = case.kind
    dies_by_itself = kind.is_crash and not kind.is_sent
    victim: dict[str, object] = {
        "figures": _LIVES,
        "how": kind.how if dies_by_itself else "none",
        "where": kind.where if kind.where in {"constructor", "thread"} else "callback",
        "delay": _DELAY,
        "spread": _SPREAD,
        "allocating_threads": 2 if kind.where == "malloc" else 0,
        "publishing_threads": 1 if kind.publishes else 0,
    }
    arguments = () if case.quiesced else ("--failpoints", "container.abrupt_deaths=always")
    by_pointer = not kind.publishes
    nodes = [
        *(
            Node(name.removeprefix("/"), "Metronome", {"figures": place}, by_pointer)
            for name, place in zip(NEIGHBOURS, _METRONOMES, strict=True)
        ),
        Node(VICTIM.removeprefix("/"), "Faulty", victim, by_pointer),
    ]
    return system(case.mode, nodes, environment=figures.environment, arguments=arguments)


class Trial:
    """Hears the supervisor's events (a StateSink) and keeps the tally."""

    def __init__(
        self,
        case: Case,
        figures: Figures,
        *,
        stop: Callable[[], None],
        send: Callable[[int, int], None] = os.kill,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """`stop` ends the run; `send` sends a signal."""
        self.tally = Tally()
        self.footprints: list[Footprint] = []
        self.progress_at = clock()
        self.container_pid = 0
        self._case = case
        self._figures = figures
        self._stop = stop
        self._send = send
        self._clock = clock
        self._timer: asyncio.TimerHandle | None = None
        self._victim_pid = 0
        self._killed_at = 0
        self._is_over = False
        self._helped = ""
        self._loaded: set[str] = set()
        self._windows = 0

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:
        del before, after
        now = self._clock()
        match event:
            case ComponentEvent():
                self._hear_component(event, now)
            case ProcessEvent():
                self._hear_process(event, now)
            case OutputLine() if _LEAK_TEXT in event.text:
                self.tally.leaked += 1
                why = event.text.partition(_LEAK_TEXT)[2].partition("; ")[0]
                self.tally.reasons[f"{_LEAK_TEXT}{why}"] += 1
            case (
                NodeStateChanged(state=NodeState.GAVE_UP)
                | ContainerStateChanged(state=ContainerState.GAVE_UP)
            ):
                self.tally.given_up += 1
            case ContainerStateChanged(state=ContainerState.RUNNING):
                self.tally.mechanism = event.mechanism
            case _:
                pass

    def progress(self) -> str:
        """How far it is, for people."""
        if not self._case.kind.is_crash:
            return f"{self._windows} looks at undisturbed neighbours"
        return f"{self.tally.crashes} crashes, {self.tally.restarts} restarts of the container"

    def look(self, now: int) -> None:
        """Help, and count it, when nothing has moved for so long that a person would."""
        if self._is_over or not self.container_pid or self._helped:
            return
        if self._is_done(now):
            self.end()
            return
        why = ""
        if self._case.kind.is_crash and now - self.progress_at > STUCK_AFTER * SECOND:
            why = "the node that crashes has not moved, and no restart followed"
        elif self._loaded >= set(NEIGHBOURS) and self._silence(now) > STUCK_AFTER * SECOND:
            why = "a neighbour was silent, and no restart followed"
        if why:
            self._helped = why
            self._send(self.container_pid, signal.SIGKILL)

    def end(self) -> None:
        """The run is over, or is to end now."""
        if not self._is_over:
            self._is_over = True
            if self._timer is not None:
                self._timer.cancel()
            self._stop()

    def _silence(self, now: int) -> int:
        return now - min(self._figures[place + _LAST_BEAT] for place in _METRONOMES)

    def _is_done(self, now: int) -> bool:
        """All nodes are loaded and well after the last crash.

        A neighbour that is stuck is given time to be found.
        """
        return (
            self._case.kind.is_crash
            and self.tally.crashes >= self._case.count
            and self._loaded >= _ALL_NODES
            and self._silence(now) < _SILENT * SECOND
        )

    def _hear_component(self, event: ComponentEvent, now: int) -> None:
        if self._is_over:
            return
        self.progress_at = now
        name, kind = event.full_node_name, event.kind
        if kind is ComponentEventKind.LOADED:
            self._loaded.add(name)
            if name == VICTIM:
                self.tally.victim_loaded(now)
                self._victim_pid = event.pid
            self.tally.node_loaded(name, _ALL_NODES, now)
            if self._loaded >= _ALL_NODES:
                self._go_on(now)
        elif kind in {ComponentEventKind.CRASHED, ComponentEventKind.LOAD_FAILED}:
            if name == VICTIM:
                self._victim_died(event, now)
            else:
                self.tally.neighbour_died()
            self._loaded.discard(name)

    def _victim_died(self, event: ComponentEvent, now: int) -> None:
        kind = self._case.kind
        if kind.is_sent:
            died_at, self._killed_at = self._killed_at or now, 0
        else:
            died_at = self._figures[_DIED_AT]
        failed = event.kind is ComponentEventKind.LOAD_FAILED
        self.tally.victim_died(now, died_at, counts=failed or kind.where != "constructor")
        if failed and kind.where != "constructor":
            self.tally.reasons[f"not loaded: {event.error_message[:80]}"] += 1
        doubts = [text for text in _DOUBTS if text in event.error_message]
        self.tally.doubtful += bool(doubts)
        self.tally.reasons.update(doubts)
        self._look_at_neighbours(now)
        self._take_footprint()

    def _go_on(self, now: int) -> None:
        """All nodes are loaded (again)."""
        kind = self._case.kind
        if self._is_done(now):
            self.end()
        elif kind.is_sent:
            delay = _DELAY + random.uniform(0, _SPREAD)
            self._timer = asyncio.get_running_loop().call_later(delay, self._strike)
        elif not kind.is_crash and self._timer is None:
            self._wait_in_peace()

    def _strike(self) -> None:
        self._killed_at = self._clock()
        number = {"segv": signal.SIGSEGV, "kill": signal.SIGKILL}[self._case.kind.how]
        try:
            self._send(self._victim_pid, number)
        except ProcessLookupError:
            self._killed_at = 0  # its container has just died

    def _wait_in_peace(self) -> None:
        self._look_at_neighbours(self._clock())
        self._take_footprint()
        self._windows += 1
        if self._windows > self._case.count:
            self.end()
            return
        self._timer = asyncio.get_running_loop().call_later(_QUIET_WINDOW, self._wait_in_peace)

    def _look_at_neighbours(self, now: int) -> None:
        # A stuck node has no gap yet, only a long silence.
        longest = self._silence(now) if self._loaded >= set(NEIGHBOURS) else 0
        for place in _METRONOMES:
            longest = max(longest, self._figures[place + _LONGEST_GAP])
            self._figures[place + _LONGEST_GAP] = 0
        self.tally.neighbours_disturbed(longest)

    def _take_footprint(self) -> None:
        done = self.tally.crashes or self._windows
        if done % max(1, self._case.count // _SAMPLES) == 0 and self.container_pid:
            taken = footprint(self.container_pid, done)
            if taken is not None:
                self.footprints.append(taken)

    def _hear_process(self, event: ProcessEvent, now: int) -> None:
        self.progress_at = now
        match event.kind:
            case ProcessEventKind.STARTED:
                self.container_pid = event.pid
                # The time from before is no gap of the new neighbours.
                for place in _METRONOMES:
                    self._figures[place + _LAST_BEAT] = now
                    self._figures[place + _LONGEST_GAP] = 0
            case ProcessEventKind.STOPPING if not self._is_over:
                silence = self._silence(now)
                silent_since = now - silence if silence > _SILENT * SECOND else 0
                self.tally.container_condemned(now, silent_since)
            case ProcessEventKind.EXITED:
                self._container_exited(event)
            case _:
                pass

    def _container_exited(self, event: ProcessEvent) -> None:
        self.container_pid = 0
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._is_over:
            if event.exit_code != 0 or event.signal != 0:
                self.tally.stopped_hard += 1
                self.tally.reasons[f"when it was stopped: {event.message}"] += 1
            return
        self._loaded.clear()
        self.footprints.clear()  # growth is that of one process
        self.tally.container_died(self._helped or event.message, by_us=bool(self._helped))
        self._helped = ""


async def run_trial(
    case: Case, *, limit: float, report: Callable[[str], None]
) -> tuple[Tally, list[Footprint], bool]:
    """Do one trial.

    Args:
        case: What to try.
        limit: Seconds after which it ends, however far it is.
        report: Is told now and then how far it is.

    Returns:
        What was counted, the footprints of the last container, and whether it came to its end.
    """
    stop = StopRequests()
    with Figures(FIGURES) as figures:
        trial = Trial(case, figures, stop=lambda: stop.request(reason="the benchmark is done"))
        running = asyncio.ensure_future(
            run_system(configuration(case, figures), Publisher(trial), stop)
        )
        try:
            in_time = await _accompany(trial, running, limit, report)
            kept = list(trial.footprints)
            trial.end()
            await running
        finally:
            # Also when we are interrupted: nothing of the system may be left.
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)
    return trial.tally, kept, in_time


async def _accompany(
    trial: Trial, running: asyncio.Future[RunOutcome], limit: float, report: Callable[[str], None]
) -> bool:
    begin = time.monotonic()
    while not running.done():
        await asyncio.wait({running}, timeout=_LOOK_EVERY)
        trial.look(time.monotonic_ns())
        report(trial.progress())
        if time.monotonic() - begin > limit:
            return False
    return True

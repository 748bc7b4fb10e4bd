"""Processes of the machine: slow to come, deaf to signals, with children that outlive them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from play_launch.config.dependency import Condition
from play_launch.supervisor import inputs as said
from play_launch.supervisor.transitions import NodeFact
from play_launch.supervisor.world import Exit, Hello

if TYPE_CHECKING:
    from .machine import Machine
    from .nodes import Loaded

ENDS: Final = ((0, 0), (1, 0), (64, 0), (79, 0), (126, 0), (127, 0), (0, 6), (0, 11))
"""Exit codes and signals."""


@dataclass
class Proc:
    """A process."""

    unit: str
    start: int
    pid: int
    is_container: bool
    spawned_at: float
    is_attached: bool = False
    is_alive: bool = True
    is_started: bool = False
    """Whether its start was reported."""
    is_ready: bool = False
    ready_at: float = 0.0
    is_clean: bool = False
    is_deaf: bool = False
    """Whether it ignores all signals but SIGKILL."""
    ignores_kill: bool = False
    """Whether it hangs in the kernel."""
    hangs: bool = False
    """Whether the loader of a container is stuck, so that nothing is constructed any more."""
    exit: Exit | None = None
    nodes: dict[int, Loaded] = field(default_factory=dict)
    ids: Any = field(default_factory=lambda: itertools.count(1))


class Processes:
    """All processes, dead ones included."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._pids = itertools.count(100)
        self.of: dict[str, list[Proc]] = {}
        self.failed: dict[str, int] = {}
        """The latest start of each unit that led to no process."""

    def live(self, unit: str) -> list[Proc]:
        return [each for each in self.of.get(unit, ()) if each.is_alive]

    def last(self, unit: str) -> Proc | None:
        procs = self.of.get(unit)
        return procs[-1] if procs else None

    def _find(self, unit: str, start: int) -> Proc | None:
        return next((each for each in self.of.get(unit, ()) if each.start == start), None)

    def spawn(self, unit: str, start: int) -> None:
        machine = self._machine
        config = machine.world.processes[unit].container
        delay = machine.soon(0.1, f"spawn {unit}")
        if machine.is_unlucky(0.1, f"spawn takes long: {unit}"):
            delay += 20.0
        is_attached = config is not None and config.attach
        if not is_attached and machine.is_unlucky(0.2, f"cannot be started: {unit}"):
            is_permanent = machine.chance.number(f"permanent {unit}") < 0.2
            self.failed[unit] = start
            answer = said.NotStarted(unit, start, "no memory", is_permanent=is_permanent)
            machine.post_later(delay, answer)
            return
        proc = Proc(unit, start, next(self._pids), config is not None, machine.now)
        proc.is_attached = is_attached
        proc.ignores_kill = machine.is_unlucky(0.05, f"hangs in the kernel: {unit}")
        proc.is_deaf = machine.is_unlucky(0.1, f"is deaf: {unit}")
        proc.hangs = machine.is_unlucky(0.04, f"loader hangs: {unit}")
        self.of.setdefault(unit, []).append(proc)
        machine.later(delay, lambda: self._started(proc))

    def _started(self, proc: Proc) -> None:
        machine, unit = self._machine, proc.unit
        if not proc.is_alive:
            return
        proc.is_started = True
        if not proc.is_container:
            proc.is_ready, proc.ready_at = True, machine.now
        machine.post(said.Started(unit, proc.start, 0 if proc.is_attached else proc.pid, 1))
        if not proc.is_alive:
            return
        if machine.is_unlucky(0.6, f"dies: {unit}"):
            code, signal = machine.chance.choice(ENDS, f"exit {unit}")
            delay = machine.soon(20.0, f"death {unit}")
            machine.later(delay, lambda: self.end(proc, code, signal))
        if not proc.is_container:
            if not machine.is_unlucky(1.0, f"writes no line: {unit}"):
                line = (Condition.LOG, unit, "ready")
                machine.later(machine.soon(1.0, f"line {unit}"), lambda: machine.write(line))
            return
        delay = machine.soon(1.0, f"hello {unit}")
        if proc.is_attached:  # it comes when it likes
            comes = machine.chance.number(f"comes {unit}")
            if comes < 0.2:
                return
            delay += 200.0 * (comes < 0.4)
        elif machine.is_unlucky(0.1, f"says no hello: {unit}"):
            return
        machine.later(delay, lambda: self._greet(proc))

    def _greet(self, proc: Proc) -> None:
        machine, unit = self._machine, proc.unit
        if not proc.is_alive:
            return
        if machine.is_unlucky(0.1, f"speaks another version: {unit}"):
            machine.post(said.Faulty(unit, proc.start, "version 7", is_fatal=True))
            return
        proc.is_ready, proc.ready_at = True, machine.now
        greeted = said.Greeted(unit, proc.start, Hello("shared_memory", "isolated"))
        machine.post(greeted)
        if machine.is_unlucky(0.1, f"says hello late again: {unit}"):
            machine.post_later(machine.soon(20.0, f"second hello {unit}"), greeted)
        if machine.is_unlucky(0.1, f"freezes: {unit}"):
            fault = said.Faulty(unit, proc.start, "it is frozen")
            machine.post_later(machine.soon(30.0, f"freeze {unit}"), fault)
        if machine.is_unlucky(0.1, f"is ill: {unit}"):
            ill = said.HealthReported(unit, proc.start, 1, 1, (), {})
            machine.post_later(machine.soon(10.0, f"illness {unit}"), ill)
        if machine.is_unlucky(0.05, f"waits for a dead lock: {unit}"):
            ill = said.HealthReported(unit, proc.start, 1, 1, ("a mutex",), {})
            machine.post_later(machine.soon(10.0, f"lock {unit}"), ill)

    def end(self, proc: Proc, code: int = 0, signal: int = 0) -> None:
        if not proc.is_alive:
            return
        machine, unit = self._machine, proc.unit
        proc.is_alive = False
        proc.exit = Exit(f"exited with {code or signal}", code, signal)
        for each in list(proc.nodes.values()):
            if machine.is_unlucky(0.3, f"last words: {unit}"):
                machine.nodes.report(proc, each, NodeFact.UNLOADED)
        exited, clean = said.Exited(unit, proc.start, proc.exit), machine.soon(0.5, f"reap {unit}")
        machine.post_later(clean, exited)
        if machine.is_unlucky(0.3, f"exit is reported again: {unit}"):
            machine.post_later(clean + machine.soon(0.5, f"second exit {unit}"), exited)
        left = clean + machine.soon(2.0, f"children {unit}")
        machine.later(left, lambda: self._clean(proc))

    def _clean(self, proc: Proc) -> None:
        machine = self._machine
        proc.is_clean = True
        clean = said.CleanedUp(proc.unit, proc.start)
        machine.post(clean)
        if machine.is_unlucky(0.5, f"is cleaned up again: {proc.unit}"):
            machine.post_later(machine.soon(5.0, f"second cleaning {proc.unit}"), clean)

    def kill(self, unit: str, start: int) -> None:
        machine, proc = self._machine, self._find(unit, start)
        if proc is None or not proc.is_alive:
            return
        if not proc.is_started:
            if machine.chance.number(f"cancelled {unit}") < 0.7:  # else its pid is on its way
                proc.is_alive, proc.is_clean = False, True
                machine.post(said.NotStarted(unit, start, "cancelled", is_permanent=False))
            return
        if not proc.ignores_kill:
            delay = machine.soon(0.1, f"kill {unit}")
        elif machine.chance.number(f"endless {unit}") < 0.5:
            return
        else:
            delay = 60.0
        machine.later(delay, lambda: self.end(proc, signal=9))

    def stop(self, unit: str, start: int) -> None:
        machine, proc = self._machine, self._find(unit, start)
        if proc is None or not proc.is_alive:
            return
        if machine.is_unlucky(0.1, f"its stop raises: {unit}"):
            machine.post_later(machine.soon(0.5, f"error {unit}"), said.Failed(unit, "a bug"))
        if proc.ignores_kill:
            machine.post_later(10.0, said.Unkillable(unit, start))
            machine.later(60.0, lambda: self.end(proc, signal=9))
        elif proc.is_deaf:
            machine.later(10.0, lambda: self.end(proc, signal=9))
        else:
            crashes = machine.is_unlucky(0.2, f"crashes at its stop: {unit}")
            signal = 11 if crashes else 2
            delay = min(10.0, machine.soon(1.0, f"stop {unit}"))
            machine.later(delay, lambda: self.end(proc, signal=signal))

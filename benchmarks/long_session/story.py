"""Everything that happens in the made-up session, but output and samples."""

from __future__ import annotations

import random
from operator import itemgetter
from typing import Any, NamedTuple

from benchmarks.long_session.makers import component, container_state, log, node_state, step
from benchmarks.long_session.plan import AREAS, PROCESSES, Life, Plan, Robot, container_of, names
from play_launch.config.node_key import NodeKey
from play_launch.supervisor.events import (
    ComponentEventKind,
    ContainerState,
    NodeState,
    ProcessEventKind,
)
from play_launch.supervisor.outcome import Cause, Sequel

CRASHES = (
    (11, "SIGSEGV (invalid address 0x0)", "on_scan"),
    (11, "SIGSEGV (invalid address 0x7f31c0de0000)", "interpolate"),
    (6, "SIGABRT (abort() was called)", "check_frame"),
    (8, "SIGFPE (integer division by zero)", "estimate_rate"),
)
OUT_OF_MEMORY = (6, "SIGABRT (terminate called after throwing 'std::bad_alloc')", "append")
SLOW = 18.0
"""Seconds that the slowest constructor takes."""
LIVES = 20.0
"""Seconds between two crashes of a node at least, and before the first."""
STOPS = 1.0
"""Seconds before the end at which everything is stopped."""


def make_up(plan: Plan) -> Robot:
    robot = Robot(plan, random.Random(plan.seed))
    nodes = names(plan)
    crashes: dict[str, list[float]] = {name: [] for name in nodes}
    weights = [robot.random.gammavariate(0.5, 1.0) for _ in nodes]
    for name in robot.random.choices(nodes, weights, k=plan.crashes):
        crashes[name].append(robot.random.uniform(0.02, 0.99) * plan.seconds)
    special = Special(nodes[-1], nodes[len(nodes) // 2], nodes[len(nodes) // 3])
    crashes[special.leaking] = [0.6 * plan.seconds]
    crashes[special.hopeless] = [0.4 * plan.seconds + 1.5 * LIVES * i for i in range(4)]
    for number, area in enumerate(AREAS[: len(nodes)]):
        story = _ContainerStory(robot, container_of(area), crashes, special)
        mine = [name for name in nodes if name.startswith(f"/{area}/")]
        story.tell([NodeKey(story.name, name) for name in mine], dies=number == 0)
    for name in PROCESSES:
        _process(robot, name, [0.3 * plan.seconds] if name == PROCESSES[-1] else [])
    robot.events.sort(key=itemgetter(0))
    robot.deaths.sort()
    return robot


class Special(NamedTuple):
    """Names of the nodes of which something is known beforehand."""

    leaking: str
    hopeless: str
    slow: str


class _ContainerStory:
    """One container and its nodes."""

    def __init__(
        self, robot: Robot, name: str, crashes: dict[str, list[float]], special: Special
    ) -> None:
        self.robot = robot
        self.name = name
        self.crashes = crashes
        self.special = special
        self.counts: dict[str, int] = dict.fromkeys(crashes, 0)

    def tell(self, keys: list[NodeKey], *, dies: bool) -> None:
        robot, name = self.robot, self.name
        robot.at(0.01, container_state(0.01, name, ContainerState.STOPPED))
        for key in keys:
            robot.at(0.01, node_state(0.01, key, NodeState.PENDING))
        begin, stops = 0.05, robot.plan.seconds - STOPS
        for number, end in enumerate((*([0.75 * stops] if dies else []), stops)):
            pid = robot.pid()
            runs = begin + robot.random.uniform(0.05, 0.4)
            self._start(begin, runs, pid, number)
            robot.lives.append(Life("container", name, pid, begin, end))
            for key in keys:
                self._node(key, runs, end)
            if end == stops:
                self._stop(end, pid, number)
                return
            self._die(end, pid, number, keys)
            begin = end + 1.0

    def _start(self, begin: float, runs: float, pid: int, restarts: int) -> None:
        at, name = self.robot.at, self.name
        at(begin, container_state(begin, name, ContainerState.STARTING))
        command = ("component_container", "--isolated", "--ros-args", "-r", f"__node:={name[1:]}")
        at(begin, step(begin, name, ProcessEventKind.STARTED, pid, restarts, command=command))
        at(runs, container_state(runs, name, ContainerState.RUNNING))
        ready = "isolated by shared_memory, rmw_fastrtps_cpp, domain 0"
        at(runs, step(runs, name, ProcessEventKind.READY, pid, restarts, ready))

    def _die(self, end: float, pid: int, restarts: int, keys: list[NodeKey]) -> None:
        at, name, why = self.robot.at, self.name, "exited with signal 11 (SIGSEGV)"
        cause = Cause.SIGNAL
        exited = step(
            end, name, ProcessEventKind.EXITED, pid, restarts, why, signal=11, cause=cause
        )
        at(end, exited)
        text = f"{why}; starts again in 1.00 s"
        sequel = _sequel(cause, Sequel.RESTART, 1.0)
        at(end, container_state(end, name, ContainerState.BACKOFF, text, **sequel))
        at(end, step(end, name, ProcessEventKind.RESTARTING, 0, restarts + 1, text, **sequel))
        lost = {"cause": Cause.CONTAINER_EXITED}
        for key in keys:
            at(end, node_state(end, key, NodeState.LOST, f"{name} died", **lost))

    def _stop(self, end: float, pid: int, restarts: int) -> None:
        at, name, why, gone = self.robot.at, self.name, "its duration is over", end + 0.2
        stopped = {"cause": Cause.STOPPED}
        at(end, container_state(end, name, ContainerState.STOPPING, why, **stopped))
        at(end, step(end, name, ProcessEventKind.STOPPING, pid, restarts, why, **stopped))
        why = "exited with status 0"
        at(gone, step(gone, name, ProcessEventKind.EXITED, pid, restarts, why))
        at(gone, container_state(gone, name, ContainerState.STOPPED, why))

    def _node(self, key: NodeKey, begin: float, until: float) -> None:
        """Let a node live while its container does."""
        build = SLOW if key.name == self.special.slow else self.robot.random.uniform(0.1, 3.0)
        last = begin + build
        for crash in sorted(self.crashes[key.name]):
            if last + LIVES < crash < until - LIVES:
                self._load(key, begin, build, crash)
                for_good = key.name == self.special.hopeless and self.counts[key.name] == 3
                pause = self.robot.random.uniform(0.3, 5.0)
                self._crash(key, crash, pause, for_good=for_good)
                if for_good:
                    return
                begin = crash + pause
                last = begin + build
        self._load(key, begin, build, until)
        if until + 2 * STOPS > self.robot.plan.seconds:
            attempt, pid, crashes = self.robot.attempts, self.robot.pids, self.counts[key.name]
            unloaded = ComponentEventKind.UNLOADED
            self.robot.at(until, component(until, key, unloaded, pid, attempt))
            state = NodeState.UNLOADED
            event = node_state(until, key, state, pid=pid, attempt=attempt, crashes=crashes)
            self.robot.at(until, event)

    def _load(self, key: NodeKey, begin: float, build: float, end: float) -> None:
        robot, crashes = self.robot, self.counts[key.name]
        robot.attempts += 1
        attempt, pid, accepted = robot.attempts, robot.pid(), begin + 0.003
        loaded = min(begin + build, end)
        for at, state in ((begin, NodeState.REQUESTED), (accepted, NodeState.LOADING)):
            robot.at(at, node_state(at, key, state, attempt=attempt, crashes=crashes))
        robot.at(accepted, component(accepted, key, ComponentEventKind.LOADING, 0, attempt))
        robot.at(loaded, component(loaded, key, ComponentEventKind.LOADED, pid, attempt))
        event = node_state(
            loaded,
            key,
            NodeState.LOADED,
            pid=pid,
            attempt=attempt,
            crashes=crashes,
            elapsed_ns=round(build * 1e9),
        )
        robot.at(loaded, event)
        leaks = key.name == self.special.leaking
        robot.lives.append(Life("node", str(key), pid, begin, end, leaks))

    def _crash(self, key: NodeKey, end: float, pause: float, *, for_good: bool) -> None:
        robot, attempt, pid = self.robot, self.robot.attempts, self.robot.pids
        # A node dies of the same more often than not.
        cause = (len(key.name) + (robot.random.random() < 0.3)) % len(CRASHES)
        signal, words, function = (
            OUT_OF_MEMORY if key.name == self.special.leaking else CRASHES[cause]
        )
        frames = _frames(robot, key.name, function)
        why = f"exited with signal {signal} ({words.split()[0]}): {words} at {frames[2]}"
        crashed = component(end, key, ComponentEventKind.CRASHED, pid, attempt, error_message=words,
                            signal=signal, backtrace=frames)  # fmt: skip
        robot.at(end, crashed)
        robot.at(end, log(end, 20, f"{key.name} crashed: {why}"))
        robot.deaths.append((end, key.container, key.name))
        self.counts[key.name] += 1
        crashes = self.counts[key.name]
        text, code = f"it is loaded again in {pause:.2f} s", Sequel.RELOAD
        if for_good:
            text, code, pause = "restart limit reached (3 in 60 s)", Sequel.GAVE_UP, 0.0
            robot.at(end, log(end, 40, f"{key.name} is not loaded again: {why}; {text}"))
        cause = Cause.EXCEPTION if "terminate" in words else Cause.SIGNAL
        outcome = _sequel(cause, code, pause)
        for state in (NodeState.CRASHED, *((NodeState.GAVE_UP,) if for_good else ())):
            numbers = {"pid": pid, "attempt": attempt, "crashes": crashes, "unique_id": attempt}
            robot.at(end, node_state(end, key, state, f"{why}; {text}", **numbers, **outcome))


def _process(robot: Robot, name: str, failures: list[float]) -> None:
    begin, stops = 0.1, robot.plan.seconds - STOPS
    at, command = robot.at, ("python3", f"{name[1:]}.py")
    for number, end in enumerate((*failures, stops)):
        pid = robot.pid()
        at(begin, step(begin, name, ProcessEventKind.STARTED, pid, number, command=command))
        robot.lives.append(Life("process", name, pid, begin, end))
        if end == stops:
            why, cause = "its duration is over", Cause.STOPPED
            at(end, step(end, name, ProcessEventKind.STOPPING, pid, number, why, cause=cause))
            at(end, step(end, name, ProcessEventKind.EXITED, pid, number, "exited with status 0"))
            return
        why, cause = "exited with status 1", Cause.EXIT_STATUS
        exited = step(
            end, name, ProcessEventKind.EXITED, pid, number, why, exit_code=1, cause=cause
        )
        at(end, exited)
        text, sequel = f"{why}; starts again in 2.00 s", _sequel(cause, Sequel.RESTART, 2.0)
        at(end, step(end, name, ProcessEventKind.RESTARTING, 0, number + 1, text, **sequel))
        begin = end + 2.0


def _sequel(cause: Cause, sequel: Sequel, delay: float) -> dict[str, Any]:
    return {"cause": cause, "sequel": sequel, "delay_ns": round(delay * 1e9)}


def _frames(robot: Robot, node: str, function: str) -> tuple[str, ...]:
    _, area, role = node.split("/")
    own = (
        f"{area}::{role.title()}::{function}(Frame const&)+0x{robot.random.getrandbits(10):x}",
        "sdk::Executor::execute(sdk::Handle&)+0x1c8",
        "sdk::Executor::spin()+0x94",
    )
    names = ("raise+0x12 (libc.so.6+0x3bfb2)", "abort+0xd3 (libc.so.6+0x26472)")
    places = (f"{each} (lib{area}_{role}.so+0x{robot.random.getrandbits(18):x})" for each in own)
    return tuple(f"#{number} {each}" for number, each in enumerate((*names, *places)))

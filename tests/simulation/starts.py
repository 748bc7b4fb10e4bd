"""Invariants of starts: when, how often, and after which ends."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.config.dependency import Condition, OnTimeout
from play_launch.config.model import ContainerType, OnExit
from play_launch.config.node_key import NodeKey
from play_launch.supervisor.events import ContainerState, ManagedState, NodeState

from .person import unit_of
from .seen import LOADING, BrokenError

if TYPE_CHECKING:
    from play_launch.config.dependency import Dependency, StartRule
    from play_launch.supervisor import inputs as said
    from play_launch.supervisor.world import Process

    from .machine import Machine
    from .seen import Ending, Seen, Starts

EXCUSED: Final = 2
"""Restarts beyond the limit for each node that may be what kills its container."""
MOST_DEATHS: Final = 3
"""Of its container, after which a node is not loaded any more."""
SUSPECT: Final = 2
"""Deaths after which it is loaded alone."""
LATE: Final = 2.0
"""Seconds after its conditions hold, and its delay, in which a unit has to start."""
ALONE: Final = 60.0
"""Seconds for which a load keeps others waiting."""
REPEATS: Final = frozenset({64, 125, 126, 127})
"""Exit codes that the next start would repeat, if it was the first."""
NEVER_RAN: Final = frozenset({126, 127})
CONTEXT: Final = 79
SLACK: Final = 1e-6


class StartChecks:
    """Judges each spawn and each load when it is requested."""

    def __init__(self, machine: Machine, seen: Seen) -> None:
        self._machine = machine
        self._seen = seen
        self._first: set[str] = set()
        self._sent: dict[NodeKey, float] = {}
        """When the latest load of a node was sent."""
        self._held: set[tuple[str, Dependency]] = set()
        """What held, or was waited for long enough, before a unit that then waited for its turn."""
        self._met: dict[str, float] = {}
        """Since when all conditions of a unit hold that has not been started."""
        self._delayed: set[str] = set()
        """Nodes whose delay was over once; a suspect may have kept them waiting then."""

    def spawn(self, effect: said.Spawn) -> None:
        machine, seen, unit = self._machine, self._seen, effect.unit
        procs = machine.processes.of.get(unit, ())
        left = [each for each in procs if each.is_alive or not each.is_clean]
        if left:
            raise BrokenError("never two live attempts of a unit", f"{unit}: {left}", (unit,))
        if seen.stop_reason is not None:
            raise BrokenError("nothing starts while the system stops", unit, (unit,))
        if seen.is_dismissed(unit):
            raise BrokenError("what is stopped stays stopped", unit, (unit,))
        self._conditions(unit)
        self._slots(effect)
        starts = seen.starts[unit]
        if starts.ending is None or seen.is_requested(unit) or starts.ending.was_stopped:
            ending = starts.ending
            starts.may_be_again = not (ending is None or ending.was_stopped)
            starts.restarts.clear()
            starts.streak = 0
            seen.forgive(unit)
            return
        self._again(machine.world.processes[unit], starts, starts.ending)

    def _slots(self, effect: said.Spawn) -> None:
        machine, world = self._machine, self._machine.world
        own = world.processes[effect.unit].container
        if own is None or own.attach:
            return
        count = 0
        for name, process in world.processes.items():
            starts, config = self._seen.starts[name], process.container
            if name == effect.unit or config is None or config.attach or not starts.start:
                continue
            is_leaving = starts.ending is not None or starts.was_stopped or starts.was_killed
            proc = machine.processes.last(name)
            is_ready = proc is not None and proc.start == starts.start and proc.is_ready
            is_up = name in machine.view.containers and not is_ready
            has_failed = machine.processes.failed.get(name) == starts.start
            is_leaving = is_leaving or name in self._seen.dismissed | self._seen.changing
            count += is_up and not is_leaving and not has_failed
        if count >= world.starts:
            text = f"{effect.unit} beside {count} others"
            raise BrokenError("no more containers start at once than may", text)

    def _again(self, process: Process, starts: Starts, ending: Ending) -> None:
        """Judge a restart that nothing requested."""
        unit, now, limits = process.name, self._machine.now, process.config.restart
        self._cannot_succeed(process, starts, ending)
        if unit in self._seen.gave_up:
            raise BrokenError("what gave up stays so", unit, (unit,))
        starts.streak = 0 if ending.lived >= limits.within else starts.streak
        pause = min(limits.maximum, limits.initial * 2.0**starts.streak) / 2
        starts.streak += 1
        if now - ending.at < pause - SLACK:
            text = f"{unit}: after {now - ending.at:.3f} s instead of {pause:.3f} s"
            raise BrokenError("restarts wait for their pause", text, (unit,))
        recent = [each for each in starts.restarts if ending.at - each[0] < limits.within]
        starts.restarts = [*recent, (ending.at, now, not ending.under_way)]
        counted = [each for each in starts.restarts if each[2]]
        most = limits.max_restarts
        nodes = self._machine.world.keys.get(unit, ())
        is_over = len(counted) > most or len(starts.restarts) > most + EXCUSED * len(nodes)
        if most == 0 or is_over:
            text = f"{unit}: {len(starts.restarts)} restarts in {limits.within:g} s"
            raise BrokenError("restart bounds hold", text, (unit,))

    def _cannot_succeed(self, process: Process, starts: Starts, ending: Ending) -> None:
        code = 0 if ending.exit is None else ending.exit.code
        name, text = "what cannot succeed is not tried again", f"{process.name}: {ending}"
        wrong = starts.is_fatal
        is_first = not starts.streak and not starts.may_be_again
        if process.container is None:
            if process.config.on_exit is not OnExit.RESTART:
                raise BrokenError("what has ended is not started again", text, (process.name,))
            repeats = code in NEVER_RAN
        else:
            wrong = wrong or (code == CONTEXT and ending.was_ready)
            repeats = code in REPEATS and not ending.was_ready
        if wrong or (is_first and (repeats or ending.is_permanent)):
            raise BrokenError(name, text, (process.name,))

    def load(self, effect: said.Load) -> None:
        machine, seen, key = self._machine, self._seen, effect.node
        self._sent[key] = machine.now
        unit, procs = str(key), machine.live(effect.node.container)
        self._conditions(unit)
        if procs and not procs[-1].is_ready:
            raise BrokenError("nothing is loaded before the hello", unit, (unit,))
        if seen.is_dismissed(unit):
            raise BrokenError("what is stopped stays stopped", unit, (unit,))
        there = machine.nodes.of(key)
        if there:
            raise BrokenError("never two live attempts of a unit", f"{there}", (unit,))
        if seen.is_requested(unit):
            return
        if unit in seen.gave_up:
            raise BrokenError("what gave up stays so", unit, (unit,))
        config = machine.world.processes[key.container].container
        is_ours = config is not None and config.container_type is not ContainerType.STOCK
        if is_ours and seen.killers[key] >= MOST_DEATHS:
            text = f"{key}: {seen.killers[key]} deaths"
            raise BrokenError("what kills its container is not loaded again", text, (unit,))
        if is_ours:
            self._is_alone(key)

    def _is_alone(self, key: NodeKey) -> None:
        """Judge a load beside others: whichever is there at a second death is loaded alone."""
        seen, now, nodes = self._seen, self._machine.now, self._machine.world.nodes
        is_reload = seen.crashed.get(key) == seen.starts[key.container].start
        # With a change nodes begin anew at a moment that only the supervisor knows.
        if is_reload or nodes[key].resent or seen.has_changed:
            return
        beside = [
            other
            for other, at in self._sent.items()
            if other in nodes
            and other.container == key.container
            and other != key
            and now - at < ALONE
            and seen.shown.get(other) in LOADING
            and nodes[other].attempt == seen.attempts.get(other)  # not sent in this very step
        ]
        if beside and any(seen.killers[each] >= SUSPECT for each in (key, *beside)):
            text = f"{key} beside {', '.join(map(str, beside))}"
            raise BrokenError("what may kill its container is loaded alone", text, (str(key),))

    # Conditions.

    def _conditions(self, unit: str) -> None:
        """Judge a first start by what was published, and what the machine knows."""
        if unit in self._first:
            return
        self._first.add(unit)
        rule = self._machine.world.config.start_rules.get(unit)
        if rule is None or self._seen.is_requested(unit) or self._seen.has_changed:
            return
        name, waited = "nothing starts before its conditions hold", self._waited(unit)
        if waited < rule.delay - SLACK and unit not in self._delayed:
            raise BrokenError(name, f"{unit} starts without its delay", (unit,))
        for dependency in rule.dependencies:
            if self.holds(dependency) or (unit, dependency) in self._held:
                continue
            is_outside = bool(dependency.machine) or not dependency.unit
            can_wait = is_outside and waited < dependency.timeout - SLACK
            if dependency.on_timeout is OnTimeout.FAIL or can_wait:
                raise BrokenError(name, f"{unit} starts without {dependency}", (unit,))

    def note_conditions(self) -> None:
        """Note which conditions hold now of what was not started."""
        for unit, rule in self._machine.world.config.start_rules.items():
            self._is_late(unit, rule)
            if (
                ":/" not in unit
                and unit not in self._first
                and unit in self._machine.view.containers
            ):
                self._held |= {(unit, each) for each in rule.dependencies if self.holds(each)}
            if ":/" in unit and unit not in self._first:
                waited = self._waited(unit) if self._is_shown_up(unit_of(unit)) else -1.0
                if waited >= rule.delay - SLACK:
                    self._delayed.add(unit)
                for each in rule.dependencies:
                    if each.on_timeout is OnTimeout.START and waited >= each.timeout - SLACK:
                        self._held.add((unit, each))

    def _is_late(self, unit: str, rule: StartRule) -> None:
        """Judge what waits although its conditions hold, or has failed by them."""
        machine, seen = self._machine, self._seen
        container = unit_of(unit)
        is_meant = not seen.has_changed and seen.is_wanted(unit) and seen.is_wanted(container)
        is_over = seen.stop_reason is not None or bool(seen.ends_all)
        if unit in self._first or not is_meant or is_over or seen.is_requested(unit):
            self._met.pop(unit, None)
            return
        if ":/" in unit:
            deaths = [n for key, n in seen.killers.items() if key.container == container]
            may_start = self._is_shown_up(container) and not any(deaths)
            has_failed = seen.shown.get(NodeKey.parsed(unit)) is NodeState.LOAD_FAILED
        else:
            may_start = unit not in machine.view.containers  # those wait for a turn
            has_failed = unit in seen.gave_up
        all_hold = all(
            self.holds(each) and self._is_shown_up(unit_of(each.unit)) for each in rule.dependencies
        )
        if not may_start or not all_hold:
            self._met.pop(unit, None)
        elif not has_failed:
            self._met.setdefault(unit, machine.now)
        if machine.now - self._met.get(unit, machine.now) > rule.delay + LATE:
            raise BrokenError("what waits starts when its conditions hold", unit, (unit,))

    def _is_shown_up(self, unit: str) -> bool:
        """Whether the supervisor knows that a container is up; others are."""
        shown = self._machine.view.containers.get(unit)
        return shown is None or shown.state is ContainerState.RUNNING

    def _waited(self, unit: str) -> float:
        """Give for how long it may have waited, at most."""
        machine, since = self._machine, self._seen.born
        if ":/" in unit:
            proc = machine.processes.last(NodeKey.parsed(unit).container)
            since = since if proc is None else proc.ready_at
        return machine.now - since

    def holds(self, dependency: Dependency) -> bool:
        machine, unit, kind = self._machine, dependency.unit, dependency.condition
        if dependency.machine or kind in {Condition.FILE, Condition.TOPIC, Condition.LOG}:
            return (kind, unit, dependency.subject) in machine.met
        match kind:
            case Condition.ACTIVE:
                goal = machine.world.goals.get(unit)
                return goal is not None and goal.state is ManagedState.ACTIVE
            case Condition.LOADED if ":/" in unit:
                key = NodeKey.parsed(unit)
                return machine.view.containers[key.container].nodes[key].state is NodeState.LOADED
            case Condition.LOADED:
                nodes = machine.view.containers[unit].nodes.values()
                return self._is_up(unit) and all(each.state is NodeState.LOADED for each in nodes)
            case Condition.EXITED:
                return self._has_ended_well(unit)
            case Condition.STARTED:
                return self._is_up(unit) or self._has_ended_well(unit)
            case other:
                raise NotImplementedError(other)

    def _is_up(self, unit: str) -> bool:
        proc = self._machine.processes.last(unit)
        is_over = self._seen.starts[unit].ending is not None
        return proc is not None and proc.is_ready and not is_over

    def _has_ended_well(self, unit: str) -> bool:
        proc = self._machine.processes.last(unit)
        return bool(proc and not proc.is_container and proc.exit and proc.exit.is_ok)

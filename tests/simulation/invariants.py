"""What always holds, each by its name; judged by what the machine saw."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Final

from play_launch.config.model import Autostart, OnCrash, OnExit
from play_launch.supervisor import inputs as said
from play_launch.supervisor.events import (
    ContainerState,
    ManagedState,
    NodeState,
    NodeStateChanged,
    ProcessEventKind,
)
from play_launch.supervisor.plan import StepOutcome
from play_launch.supervisor.transitions import NodeFact
from play_launch.supervisor.world import STATE_OF_PHASE, Phase

from .person import unit_of
from .rest import RestChecks
from .seen import BrokenError, Seen
from .starts import StartChecks

__all__ = ["BrokenError", "Checks"]

if TYPE_CHECKING:
    from play_launch.config.node_key import NodeKey
    from play_launch.supervisor.events import RunEvent
    from play_launch.supervisor.view import SystemView

    from .machine import Machine
    from .seen import Snapshot

_LEADS_TO: Final = {
    ManagedState.CONFIGURING: frozenset(Autostart),
    ManagedState.ACTIVATING: frozenset({Autostart.ACTIVATE}),
}
"""What may have been asked of a node for a transition."""
AWAITED: Final = frozenset({NodeState.REQUESTED, NodeState.LOADING, NodeState.UNLOADING})
INTERVAL: Final = 15.0
"""Seconds between two queries about a constructor that runs."""
SLACK: Final = 0.01


class Checks:
    """Watches one machine."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self.seen = Seen(machine)
        self.starts = StartChecks(machine, self.seen)
        self.rest = RestChecks(machine, self.seen, self.starts)
        self._start_before = 0
        """The latest start of the unit of an input, before that was processed."""
        self._once: Counter[tuple[object, ...]] = Counter()
        self._sent_again: set[NodeKey] = set()
        """Nodes whose latest load was sent because the container did not know the one before."""
        self._owed: dict[NodeKey, float] = {}
        """When a container was last asked about a node, or reported something of it."""

    def before(self, one: said.Input) -> None:
        self._start_before = self.seen.starts[getattr(one, "unit", "")].start
        self.seen.before(one)

    def after(
        self,
        one: said.Input,
        before: Snapshot,
        effects: list[said.Effect],
        events: list[RunEvent],
    ) -> None:
        """Judge one step."""
        for event in events:
            self.seen.event(event)
        is_fatal = isinstance(one, said.Faulty) and one.is_fatal
        for effect in effects:
            self._effect(effect)
            if isinstance(effect, said.Load):
                self._is_reload_allowed(effect)
                self._is_sent_again_once(one, effect)
            self.seen.effect(effect)
            if is_fatal and isinstance(effect, said.Kill):
                self.seen.starts[effect.unit].is_fatal = True
        self.starts.note_conditions()
        self._views()
        self._remedies(one, before, effects)
        self._goals(one, before, effects)
        self._stale(one, before, effects)
        self._isolation(one, before)
        self._consequences(one)
        self._deaths()
        self._answers(one, effects, events)

    def at_rest(self) -> None:
        self.rest.at_rest()

    def at_end(self, before: SystemView) -> None:
        self.rest.at_end(before)

    # Effects.

    def _effect(self, effect: said.Effect) -> None:
        match effect:
            case said.Raised():
                text = f"{effect.unit}: {effect.error!r}"
                raise BrokenError("no rule raises", text, (effect.unit,)) from effect.error
            case said.Spawn():
                self._is_once("spawn", effect.start)
                self.starts.spawn(effect)
            case said.Load():
                self._is_once("load", effect.attempt)
                self.starts.load(effect)
            case said.Kill():
                self._is_once("kill", effect.unit, effect.start)
            case said.Stop():
                self._is_once("stop", effect.unit, effect.start)
                self._reverse_order(effect)
            case said.Drive() if effect.to in _LEADS_TO:
                goal = self._machine.world.goals[effect.unit].config.autostart
                if goal not in _LEADS_TO[effect.to]:
                    text = f"{effect.unit}, {goal}: {effect.to}"
                    raise BrokenError("a managed node goes no further", text, (effect.unit,))
            case StepOutcome():
                if effect.step.id in {each.step.id for each in self._machine.person.done}:
                    raise BrokenError("a step of a change ends once", str(effect))
            case _:
                pass

    def _is_once(self, *what: object) -> None:
        self._once[what] += 1
        if self._once[what] > 1:
            raise BrokenError("every effect is carried out once", str(what))

    def _reverse_order(self, effect: said.Stop) -> None:
        machine, seen = self._machine, self.seen
        if seen.is_hurried or seen.has_changed or effect.reason != seen.stop_reason:
            return
        units = machine.world.config.units
        for unit, rule in machine.world.config.start_rules.items():
            member = unit_of(unit)
            for dependency in rule.dependencies:
                needed = unit_of(dependency.unit)
                if needed == effect.unit and member != needed and member in units:
                    live = [each for each in machine.live(member) if not each.ignores_kill]
                    if live and not self._is_mutual(member, needed):
                        text = f"{effect.unit} is stopped before {member}"
                        raise BrokenError("stops in reverse order", text, (effect.unit, member))

    def _is_mutual(self, one: str, other: str) -> bool:
        """Whether members depend on each other by their nodes, so are stopped together."""
        edges: dict[str, set[str]] = {}
        for unit, rule in self._machine.world.config.start_rules.items():
            for dependency in rule.dependencies:
                if dependency.unit:
                    edges.setdefault(unit_of(unit), set()).add(unit_of(dependency.unit))
        reached, todo = {other}, [other]
        while todo:
            for each in edges.get(todo.pop(), set()) - reached:
                reached.add(each)
                todo.append(each)
        return one in reached

    # The world.

    def _views(self) -> None:
        """Compare what was published with what is."""
        world, view = self._machine.world, self._machine.view
        name = "events tell the truth"
        for unit, process in world.processes.items():
            starts = self.seen.starts[unit]
            is_over = starts.ending is not None and starts.ending.exit is not None
            if starts.exits != is_over:
                text = f"{unit}: {starts.exits} exits reported"
                raise BrokenError("every exit is reported once", text, (unit,))
            shown = view.processes.get(unit)
            if process.container is not None:
                container = view.containers[unit]
                shown = container.process
                if container.state is not STATE_OF_PHASE[process.phase]:
                    text = f"{unit}: {container.state} is {process.phase}"
                    raise BrokenError(name, text, (unit,))
            if shown is not None and shown.restarts > starts.deaths:
                text = f"{unit}: {shown.restarts} restarts after {starts.deaths} deaths"
                raise BrokenError(name, text, (unit,))
            is_backoff = process.phase is Phase.BACKOFF
            if is_backoff and (shown is None or shown.kind is not ProcessEventKind.RESTARTING):
                raise BrokenError(name, f"{unit} waits, and it is not shown", (unit,))
        for key, node in world.nodes.items():
            known = view.containers[key.container].nodes[key]
            if (known.state, known.crashes) != (node.state, node.crashes):
                text = f"{key}: {known.state} is {node.state}"
                raise BrokenError(name, text, (str(key),))
            if node.state in {NodeState.LOAD_FAILED, NodeState.GAVE_UP} and not node.reason:
                raise BrokenError("what is given up has a reason", str(key), (str(key),))
        if len(view.containers) > len(world.processes):
            raise BrokenError(name, "a container is gone and still shown")
        if differs := view.dismissed ^ world.dismissed:
            raise BrokenError(name, f"dismissed: {sorted(differs)}", tuple(differs))
        for unit, goal in world.goals.items():
            told = view.managed.get(unit)
            is_, shown_as = goal.state, ManagedState.ABSENT if told is None else told.state
            if goal.config.autostart is None:  # it is only watched, which is not published
                is_ = ManagedState.ABSENT
            if shown_as is not is_:
                raise BrokenError(name, f"{unit}: {shown_as} is {is_}", (unit,))

    def _remedies(self, one: said.Input, before: Snapshot, effects: list[said.Effect]) -> None:
        """What a container or a scratch process reports has its consequence at once."""
        loads = {each.node for each in effects if isinstance(each, said.Load)}
        is_bad = isinstance(one, said.Probed) and one.finding and not one.finding.loads
        if isinstance(one, said.Probed) and is_bad and one.node in loads:
            raise BrokenError("what cannot be loaded is not", str(one.node), (str(one.node),))
        if isinstance(one, said.HealthReported) and one.dead_locks:
            process = before.processes.get(one.unit)
            runs = process is not None and process.phase is Phase.RUNNING
            is_meant = process is not None and process.attempt == one.start
            if runs and is_meant and not self._leaves(one.unit, effects):
                raise BrokenError("a dead lock ends its container", one.unit, (one.unit,))

    def _goals(self, one: said.Input, before: Snapshot, effects: list[said.Effect]) -> None:
        for unit, goal in self._machine.world.goals.items():
            was = before.goals.get(unit)
            is_new = was is None or goal.state is not was.state
            has_failed = goal.state is ManagedState.FAILED
            is_told = any(isinstance(each, said.Log) and each.is_error for each in effects)
            if bool(goal.reason) is not has_failed or (is_new and has_failed and not is_told):
                text = f"{unit}: {goal.state}, {goal.reason!r}"
                raise BrokenError("what is given up has a reason", text, (unit,))
            if not isinstance(one, said.GoalReported) or one.unit != unit or was is None:
                continue
            if one.instance != was.instance == goal.instance and is_new:
                raise BrokenError("events of an old attempt change nothing", f"{one}", (unit,))

    def _stale(self, one: said.Input, before: Snapshot, effects: list[said.Effect]) -> None:
        name = "events of an old attempt change nothing"
        unit, start = getattr(one, "unit", ""), getattr(one, "start", None)
        old = before.processes.get(unit)
        if start is None or old is None:
            return
        is_old = self._start_before != start
        new = self._machine.world.processes.get(unit)
        is_waiting = old.wait is not None or old.phase is Phase.QUEUED
        if is_old and not is_waiting:
            wrong = [each for each in effects if getattr(each, "unit", "") == unit]
            if new != old or wrong:
                raise BrokenError(name, f"{one}: {wrong}", (unit,))
        if isinstance(one, said.NodeReported) and one.said is not NodeFact.UNLOAD_REJECTED:
            for key, node in self._machine.world.nodes.items():
                was = before.nodes.get(key)
                if key.container != unit or was is None or was.wait is not None:
                    continue
                is_about = not is_old and was.attempt == one.attempt
                has_changed = was.state in AWAITED and was.state is not node.state
                if is_about or self.seen.is_changing or self._leaves(unit, effects):
                    continue
                if has_changed:
                    raise BrokenError(name, f"{one}: {key}", (str(key),))

    def _leaves(self, unit: str, effects: list[said.Effect]) -> bool:
        return any(
            isinstance(each, said.Stop | said.Kill) and each.unit == unit for each in effects
        )

    def _isolation(self, one: said.Input, before: Snapshot) -> None:
        name, world = "no unit's failure changes another unit", self._machine.world
        if not isinstance(one, said.Exited | said.NodeReported | said.Faulty):
            return
        if self.seen.stop_reason is not None or self.seen.is_changing:
            return
        for unit, process in world.processes.items():
            old = before.processes.get(unit)
            if old is None or unit == one.unit:
                continue
            if old.phase in {Phase.RUNNING, Phase.STARTING} and process.phase is not old.phase:
                text = f"{unit} goes to {process.phase} because of {one.unit}"
                raise BrokenError(name, text, (unit, one.unit))
        container = world.processes.get(one.unit)
        is_up = container is not None and container.phase is Phase.RUNNING
        for key, node in world.nodes.items():
            was = before.nodes.get(key)
            if was is None or (key.container == one.unit and not is_up):
                continue
            if key.container == one.unit and was.attempt == getattr(one, "attempt", 0):
                continue
            if was.state is NodeState.LOADED and node.state is not NodeState.LOADED:
                raise BrokenError(name, f"{key} goes because of {one.unit}", (str(key), one.unit))

    def _consequences(self, one: said.Input) -> None:
        """What an end has to bring about: the end of all, or of a container."""
        machine, seen = self._machine, self.seen
        if isinstance(one, said.Exited | said.NotStarted):
            process, starts = machine.world.processes.get(one.unit), seen.starts[one.unit]
            ends_all = process is not None and process.config.on_exit is OnExit.SHUTDOWN
            ending = starts.ending
            is_own = ending is not None and not ending.was_stopped
            if isinstance(one, said.NotStarted):  # a stop cancels a start by killing it
                is_own = is_own and not starts.was_killed
            if ends_all and starts.start == one.start and is_own:
                seen.ends_all = f"{one.unit} has ended"
        if isinstance(one, said.NodeReported) and one.said is NodeFact.CRASHED:
            for key in list(seen.crashed):
                node = machine.world.nodes.get(key)
                if node is None or key.container != one.unit or node.state is not NodeState.CRASHED:
                    continue
                policy, wanted = node.config.on_crash, seen.is_wanted(str(key))
                if node.attempt != one.attempt or not wanted:
                    continue
                was_stopped = seen.starts[one.unit].was_stopped or seen.starts[one.unit].was_killed
                if policy is OnCrash.STOP_CONTAINER and not was_stopped:
                    raise BrokenError("what on_crash says is done", f"{key}: {policy}", (str(key),))
                if policy is OnCrash.SHUTDOWN and not was_stopped:
                    seen.ends_all = f"{key} has crashed"

    def _is_reload_allowed(self, effect: said.Load) -> None:
        key, seen = effect.node, self.seen
        policy = self._machine.world.nodes[key].config.on_crash
        is_same = seen.crashed.get(key) == seen.starts[key.container].start
        if is_same and policy is not OnCrash.RELOAD and not seen.is_requested(str(key)):
            text = f"{key} is loaded again"
            raise BrokenError("what on_crash says is done", text, (str(key),))

    def _is_sent_again_once(self, one: said.Input, effect: said.Load) -> None:
        is_again = (
            isinstance(one, said.NodeReported)
            and one.said is NodeFact.STATUS_UNKNOWN
            and self.seen.is_wanted(str(effect.node))
            and not self.seen.is_requested(str(effect.node))
        )
        if is_again and effect.node in self._sent_again:
            raise BrokenError("a lost load is sent again once", f"{effect}", (str(effect.node),))
        (self._sent_again.add if is_again else self._sent_again.discard)(effect.node)

    def _deaths(self) -> None:
        """What was killed has exited in time, or is reported as given up."""
        machine, limit = self._machine, self._machine.world.limits.kill
        for unit, at in self.seen.killed.items():
            shown = machine.view.containers.get(unit)
            is_killing = shown is not None and shown.state is ContainerState.KILLING
            if is_killing and machine.now - at > limit + SLACK:
                raise BrokenError("what does not die is given up", unit, (unit,))

    def _answers(self, one: said.Input, effects: list[said.Effect], events: list[RunEvent]) -> None:
        """No request is forgotten: silence leads to a query, and a query to an end."""
        machine, now = self._machine, self._machine.now
        for event in events:
            if isinstance(event, NodeStateChanged) and event.key in self._owed:
                self._owed[event.key] = now
        for effect in effects:
            if isinstance(effect, said.Load):
                self._owed[effect.node] = now
            elif isinstance(effect, said.Query):
                for key, _, _ in effect.about:
                    self._owed[key] = now
        if isinstance(one, said.NodeReported):
            for key, attempt in self.seen.attempts.items():
                if attempt == one.attempt and key.container == one.unit:
                    self._owed[key] = now
        for key, at in list(self._owed.items()):
            node = machine.world.nodes.get(key)
            if (
                node is None
                or machine.view.containers[key.container].nodes[key].state not in AWAITED
            ):
                del self._owed[key]
                continue
            config = machine.world.processes[key.container].container
            assert config is not None
            if now - at > max(config.loading_timeout, INTERVAL) + SLACK:
                raise BrokenError("silence is a question", f"{key} in {node.state}", (str(key),))

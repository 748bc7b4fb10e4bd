"""The reducer: the only place that changes the world, from one input to the effects that follow.

Everything that follows from the state of the world alone is evaluated after each input: an input
that was missed costs a delay, never a hang.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, TypeVar

from play_launch.supervisor import change, goals, inputs, node_rules, process_rules, quarantine
from play_launch.supervisor.conditions import (
    find_unit,
    has_arrived,
    nothing_is_left,
    stopped_before,
    unit_key,
)
from play_launch.supervisor.transitions import IDLE
from play_launch.supervisor.world import INACTIVE, Phase, Process

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from play_launch.config.node_key import NodeKey
    from play_launch.supervisor.inputs import Effect, Input
    from play_launch.supervisor.world import Node, UnitKey, World

_About = TypeVar("_About")

_ABOUT_ALL: Final = (
    inputs.Time,
    inputs.StopRequested,
    inputs.StartRequested,
    inputs.EndRequested,
    inputs.ChangeRequested,
    inputs.ParametersSet,
    inputs.Failed,
)
"""Inputs that may concern any unit; others concern units that they change, and those that wait."""
_OF_PROCESS: Final[Mapping[type, Callable[[Reduction, Any], None]]] = {
    inputs.Started: process_rules.started,
    inputs.NotStarted: process_rules.not_started,
    inputs.Greeted: process_rules.greeted,
    inputs.Faulty: process_rules.faulty,
    inputs.Exited: process_rules.exited,
    inputs.CleanedUp: process_rules.cleaned_up,
    inputs.Unkillable: process_rules.unkillable,
    inputs.NodeReported: node_rules.reported,
    inputs.HealthReported: node_rules.health,
}
"""Reports about one start of a process; those about an earlier start change nothing."""
_ROUNDS: Final = 100
"""Rounds in which one change of the world may lead to another; more are an error of the rules."""


class Reduction:
    """One call of `reduce`: the world, the time, and the effects so far."""

    def __init__(self, world: World, now: float, chance: float) -> None:
        self.world = world
        self.now = now
        self.chance = chance
        """A random number in [0, 1), for the jitter of delays."""
        self.effects: list[Effect] = []
        self._queries: dict[str, list[Node]] = {}

    def process(self, name: str) -> Process:
        return self.world.processes[name]

    def node(self, key: NodeKey) -> Node:
        return self.world.nodes[key]

    def log(self, text: str, *, is_shown_otherwise: bool = False) -> None:
        self.effects.append(inputs.Log(text, is_shown_otherwise=is_shown_otherwise))

    def confine(self, unit: str, rule: Callable[[Reduction, _About], None], about: _About) -> None:
        """Evaluate a rule of one unit; an exception in it is the failure of that unit alone."""
        try:
            rule(self, about)
        except Exception as error:  # noqa: BLE001 - the other units continue
            self.effects.append(inputs.Raised(unit, error))

    def query(self, node: Node) -> None:
        """Query the container of a node about it, in one message with other nodes."""
        self._queries.setdefault(node.key.container, []).append(node)

    def finish(self) -> list[Effect]:
        for container, nodes in self._queries.items():
            about = tuple((node.key, node.attempt, node.unique_id) for node in nodes)
            self.effects.append(inputs.Query(container, about))
        return self.effects


def reduce(world: World, said: Input, now: float, chance: float = 0.5) -> list[Effect]:
    """Change the world as an input says, and give the effects that are to be carried out.

    Args:
        world: Is changed.
        said: What happened.
        now: Seconds of the event loop's clock.
        chance: A random number in [0, 1), for the jitter of delays.
    """
    step = Reduction(world, now, chance)
    try:
        _take(step, said)
        _settle(step, is_about_all=isinstance(said, _ABOUT_ALL))
    except Exception as error:  # noqa: BLE001 - the effects until then are carried out
        step.effects.append(inputs.Raised("", error))
    # What is declared anew later is wanted.
    world.dismissed = frozenset(each for each in world.dismissed if find_unit(world, each))
    return step.finish()


def deadline(world: World) -> float | None:
    """When the input `Time` is due next; None: time alone changes nothing."""
    times = (change.next_deadline(world), world.next_due())
    return min((at for at in times if at is not None), default=None)


def _take(step: Reduction, said: Input) -> None:
    world = step.world
    if (rule := _OF_PROCESS.get(type(said))) is not None:
        report: Any = said
        process = world.processes.get(report.unit)
        if process is not None and process.attempt == report.start and process.is_present:
            step.confine(report.unit, rule, report)
        return
    match said:
        case inputs.Time():
            for name in list(world.processes):
                step.confine(name, process_rules.due, name)
            for key in list(world.nodes):
                step.confine(key.container, node_rules.due, key)
        case inputs.Failed():
            if said.unit in world.processes:
                process_rules.failed(step, said.unit, said.reason)
        case inputs.Probed():
            quarantine.probed(step, said)
        case inputs.Found():
            world.met = said.met
        case inputs.GoalReported():
            goals.reported(step, said)
        case inputs.StopRequested():
            is_second = world.stop_signal is not None and said.signum is not None
            world.is_hurried |= is_second or said.is_hurried
            if not world.is_stopping and not said.is_hurried:
                world.stop_reason, world.stop_signal = said.reason, said.signum
                world.stop_order = stopped_before(world)
        case inputs.StartRequested() | inputs.EndRequested():
            _operate(step, said)
        case inputs.ChangeRequested():
            change.begin(step, said)
        case inputs.ParametersSet():
            change.parameters_set(step, said)


def _operate(step: Reduction, said: inputs.StartRequested | inputs.EndRequested) -> None:
    """Note what an operator wants; it waits for no conditions."""
    world, unit = step.world, find_unit(step.world, said.unit)
    if unit is None:
        raise KeyError(said.unit)
    if isinstance(said, inputs.EndRequested):
        if isinstance(unit, Process):
            world.put(unit, request_reason=said.reason)
        world.dismissed |= {said.unit}
        change.dismissed(world, said.unit)
        return
    was_wanted = said.unit not in world.dismissed
    world.dismissed -= {said.unit}
    values: dict[str, object] = {"wait": None}
    if isinstance(unit, Process):
        runs = was_wanted and unit.phase not in INACTIVE | {Phase.STOPPING, Phase.BACKOFF}
        is_new = said.anew or not runs
        values["request_reason"] = said.reason if said.anew else ""
    else:
        is_new = said.anew or not was_wanted or unit.state in IDLE
        values |= {"next_at": None, "gives_up": ""}
    released_at = step.now if unit.released_at is None else unit.released_at
    is_requested = unit.is_requested or is_new
    world.put(unit, released_at=released_at, is_requested=is_requested, **values)


def _settle(step: Reduction, *, is_about_all: bool) -> None:
    """Evaluate what follows from the state of the world until nothing more does."""
    world = step.world
    for _ in range(_ROUNDS):
        touched, world.touched = world.touched, set()
        before = (world.change, world.stop_reason)
        is_about_all = is_about_all or world.is_stopping or world.change is not None
        names, keys = _concerned(world, touched, is_about_all=is_about_all)
        for name in names:
            step.confine(name, process_rules.settle, name)
        for key in keys:
            if key in world.nodes:
                step.confine(key.container, node_rules.settle, key)
        for name in list(world.goals):
            step.confine(name.partition(":")[0], goals.settle, name)
        change.settle_confined(step)
        if not world.is_stopping and nothing_is_left(world):
            process_rules.request_stop(step, "nothing is left to run")
        _note_arrivals(world, touched)
        if not world.touched and before == (world.change, world.stop_reason):
            return
    raise AssertionError("the rules do not come to an end")


def _concerned(
    world: World, touched: set[UnitKey], *, is_about_all: bool
) -> tuple[list[str], list[NodeKey]]:
    """Give the units whose rules may have another result than before, as declared."""
    if is_about_all:
        return list(world.processes), list(world.nodes)
    found = touched | world.waiting
    for key in touched:
        if isinstance(key, str):
            found |= set(world.keys.get(key, ()))
    ordered = sorted((key for key in found if key in world.places), key=world.places.__getitem__)
    names = [key for key in ordered if isinstance(key, str) and key in world.processes]
    return names, [key for key in ordered if not isinstance(key, str)]


def _note_arrivals(world: World, touched: set[UnitKey]) -> None:
    if world.is_stopping:
        return
    for key in touched:
        unit = find_unit(world, key) if isinstance(key, str) else world.nodes.get(key)
        if unit is not None and unit_key(unit) not in world.arrived and has_arrived(world, unit):
            world.arrived |= {unit_key(unit)}

"""The reducer: the only place that changes the world, from one input to the effects that follow.

Everything that follows from the state of the world alone is evaluated after each input: an input
that was missed costs a delay, never a hang.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

from play_launch.supervisor import change, goal_rules, node_rules, process_rules, quarantine
from play_launch.supervisor.conditions import (
    find_unit,
    has_arrived,
    nothing_is_left,
    stopped_before,
    unit_key,
)
from play_launch.supervisor.inputs import (
    Begun,
    ChangeRequested,
    CleanedUp,
    EndRequested,
    Exited,
    Failed,
    Faulty,
    FilesSeen,
    GoalReported,
    GraphSeen,
    Greeted,
    HealthReported,
    Hurried,
    LineSeen,
    LoadRequested,
    NodeReported,
    NotStarted,
    ParametersSet,
    Probed,
    Raised,
    Started,
    StartRequested,
    StopRequested,
    Time,
    Unkillable,
    UnloadRequested,
)
from play_launch.supervisor.node_life import IDLE
from play_launch.supervisor.reduction import Reduction
from play_launch.supervisor.world import INACTIVE, Phase

if TYPE_CHECKING:
    from play_launch.config.node_key import NodeKey
    from play_launch.supervisor.inputs import Effect, Input
    from play_launch.supervisor.world import UnitKey, World

_ABOUT_ALL: Final = (
    Begun,
    Time,
    StopRequested,
    Hurried,
    StartRequested,
    EndRequested,
    LoadRequested,
    UnloadRequested,
    ChangeRequested,
    ParametersSet,
    Failed,
)
"""Inputs that may concern any unit; others concern units that they change, and those that wait."""
_ROUNDS: Final = 100
"""Rounds in which one change of the world may lead to another; more are an error of the rules."""


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
        step.effects.append(Raised("", error))
    # What is declared anew later is wanted.
    world.dismissed = frozenset(each for each in world.dismissed if find_unit(world, each))
    return step.finish()


def deadline(world: World) -> float | None:
    """When the input `Time` is due next; None: time alone changes nothing."""
    times = (change.next_deadline(world), world.next_due())
    return min((at for at in times if at is not None), default=None)


def _take(step: Reduction, said: Input) -> None:
    world = step.world
    match said:
        case Begun():
            pass
        case Time():
            for name in list(world.processes):
                step.confine(name, partial(process_rules.due, step, name))
            for key in list(world.nodes):
                step.confine(key.container, partial(node_rules.due, step, key))
        case (
            Started()
            | NotStarted()
            | Greeted()
            | Faulty()
            | Exited()
            | CleanedUp()
            | Unkillable()
            | NodeReported()
            | HealthReported()
        ):
            process = world.processes.get(said.unit)
            if process is not None and process.attempt == said.start and process.is_present:
                step.confine(said.unit, partial(_take_of_process, step, said))
        case Failed():
            if said.unit in world.processes:
                process_rules.failed(step, said.unit, said.reason)
        case Probed():
            quarantine.probed(step, said)
        case LineSeen():
            world.lines |= {(said.unit, said.pattern)}
        case FilesSeen():
            world.files = said.paths
        case GraphSeen():
            world.graph = said.found
        case GoalReported():
            goal_rules.reported(step, said)
        case StopRequested():
            if world.stop_signal is not None and said.signum is not None:
                world.is_hurried = True
            if not world.is_stopping:
                world.stop_reason, world.stop_signal = said.reason, said.signum
                world.stop_order = stopped_before(world)
        case Hurried():
            world.is_hurried = True
        case StartRequested() | EndRequested() | LoadRequested() | UnloadRequested():
            _operate(step, said)
        case ChangeRequested():
            change.begin(step, said)
        case ParametersSet():
            change.parameters_set(step, said)


def _take_of_process(
    step: Reduction,
    said: Started
    | NotStarted
    | Greeted
    | Faulty
    | Exited
    | CleanedUp
    | Unkillable
    | NodeReported
    | HealthReported,
) -> None:
    match said:
        case Started():
            process_rules.started(step, said)
        case NotStarted():
            process_rules.not_started(step, said)
        case Greeted():
            process_rules.greeted(step, said.unit, said.hello)
        case Faulty():
            process_rules.faulty(step, said)
        case Exited():
            process_rules.exited(step, said)
        case CleanedUp():
            process_rules.cleaned_up(step, said)
        case Unkillable():
            process_rules.unkillable(step, said)
        case NodeReported():
            node_rules.reported(step, said)
        case HealthReported():
            node_rules.health(step, said)


def _operate(
    step: Reduction, said: StartRequested | EndRequested | LoadRequested | UnloadRequested
) -> None:
    """Note what an operator wants; it waits for no conditions."""
    world, now = step.world, step.now
    match said:
        case StartRequested():
            process = world.processes[said.unit]
            was_wanted = said.unit not in world.dismissed
            world.dismissed -= {said.unit}
            runs = process.phase not in INACTIVE | {Phase.STOPPING, Phase.BACKOFF} and was_wanted
            is_asked = process.generation > process.attempted
            world.put(
                process,
                released_at=now if process.released_at is None else process.released_at,
                wait=None,
                generation=process.generation + (not is_asked and (said.anew or not runs)),
                request_reason=said.reason if said.anew else "",
            )
        case EndRequested():
            world.put(world.processes[said.unit], request_reason=said.reason)
            world.dismissed |= {said.unit}
            change.dismissed(world, said.unit)
        case LoadRequested():
            node = world.nodes[said.node]
            was_wanted = str(said.node) not in world.dismissed
            world.dismissed -= {str(said.node)}
            exists = node.state not in IDLE and was_wanted
            world.put(
                node,
                released_at=now if node.released_at is None else node.released_at,
                wait=None,
                next_at=None,
                gives_up="",
                generation=node.generation + (said.anew or not exists),
            )
        case UnloadRequested():
            world.dismissed |= {str(said.node)}
            change.dismissed(world, str(said.node))


def _settle(step: Reduction, *, is_about_all: bool) -> None:
    """Evaluate what follows from the state of the world until nothing more does."""
    world = step.world
    for _ in range(_ROUNDS):
        touched, world.touched = world.touched, set()
        before = (world.change, world.stop_reason)
        is_about_all = is_about_all or world.is_stopping or world.change is not None
        names, keys = _concerned(world, touched, is_about_all=is_about_all)
        for name in names:
            step.confine(name, partial(process_rules.settle, step, name))
        for key in keys:
            if key in world.nodes:
                step.confine(key.container, partial(node_rules.settle, step, key))
        for name in list(world.goals):
            step.confine(name.partition(":")[0], partial(goal_rules.settle, step, name))
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

"""Changes a running system to another configuration: phase by phase, and each step to its result.

A step changes what is wanted; what follows is the same as for a start. So a step is done when the
world has come to where the step leads.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from play_launch.config.model import ContainerConfig
from play_launch.supervisor import node_rules
from play_launch.supervisor.conditions import unit_state
from play_launch.supervisor.inputs import Raised, SetParameters
from play_launch.supervisor.plan import Need, PlanAction, PlanKind, Result, StepOutcome
from play_launch.supervisor.world import Goal, Node, Process

if TYPE_CHECKING:
    from play_launch.config.model import ReplayConfig
    from play_launch.supervisor.inputs import ChangeRequested, ParametersSet
    from play_launch.supervisor.plan import Step
    from play_launch.supervisor.reducer import Reduction
    from play_launch.supervisor.world import World

_BECAUSE: Final = "the configuration has changed"
_STUCK: Final = "its process does not die, not even of SIGKILL"


class OpenStep(Struct, frozen=True):
    """A step that was begun and has not ended."""

    step: Step
    began_at: float
    asks: bool = False
    """Whether the answer of a node that was given parameters is awaited."""
    note: str = ""
    """How it is done, where that is not as planned."""


class Change(Struct, frozen=True, kw_only=True):
    """A change that is being carried out."""

    target: ReplayConfig
    phases: tuple[tuple[Step, ...], ...]
    limit: float
    open: tuple[OpenStep, ...] = ()
    has_failed: bool = False
    recalls: frozenset[str] = frozenset()
    """What an operator had stopped before it began; what it replaces of that is started."""


def dismissed(world: World, name: str) -> None:
    """Leave what an operator stops during a change stopped."""
    if world.change is not None:
        world.change = replace(world.change, recalls=world.change.recalls - {name})


def begin(step: Reduction, said: ChangeRequested) -> None:
    """Begin a change; what has to hold before a start is that of the target from now on."""
    world, target = step.world, said.target
    world.config = replace(
        world.config, start_rules=target.start_rules, managed=target.managed, stop=target.stop
    )
    for unit, managed in target.managed.items():
        if unit not in world.goals:
            world.put(Goal(unit=unit, config=managed))
    world.change = Change(
        target=target, phases=said.phases, limit=said.limit, recalls=world.dismissed
    )
    # What is taken out must not start because the target has no rule that holds it back.
    settle_confined(step)


def parameters_set(step: Reduction, said: ParametersSet) -> None:
    """A node took its parameters, or refused them: then it is replaced."""
    change = step.world.change
    if change is None:
        return
    found = next((each for each in change.open if each.step.id == said.step.id), None)
    if found is None or not found.asks:
        return
    others = tuple(each for each in change.open if each is not found)
    if not said.refusal:
        step.world.change = replace(change, open=others)
        _adopt(step.world, change, said.step)
        _end(step, found)
        return
    is_process = said.step.kind is PlanKind.PROCESS
    note = f"{'restarted' if is_process else 'reloaded'}: {said.refusal}"
    step.world.change = replace(change, open=(*others, replace(found, asks=False, note=note)))
    _replace(step.world, change, said.step)


def settle_confined(step: Reduction) -> None:
    """The same as `_settle`; an exception in it ends the change, and nothing else."""
    try:
        _settle(step)
    except Exception as error:  # noqa: BLE001 - the units go on
        step.effects.append(Raised("", error))
        change, step.world.change = step.world.change, None
        for each in change.open if change is not None else ():
            _end(step, each, "internal error")


def _settle(step: Reduction) -> None:
    """End the steps that are over, and begin those of the next phase."""
    world = step.world
    while (change := world.change) is not None:
        change = world.change = _judged(step, change)
        if change.open:
            return
        if not change.phases or change.has_failed:
            world.change = None
            return
        first, *rest = change.phases
        opened = tuple(_begin(step, change, each) for each in first)
        world.change = replace(change, phases=tuple(rest), open=opened)


def _judged(step: Reduction, change: Change) -> Change:
    still_open: list[OpenStep] = []
    has_failed = change.has_failed
    for each in change.open:
        failure = _result(step.world, change, each, step.now)
        if failure is None:
            still_open.append(each)
            continue
        has_failed = has_failed or bool(failure)
        if each.asks:  # its next load or start reads them
            _adopt(step.world, change, each.step)
        _end(step, each, failure)
    return replace(change, open=tuple(still_open), has_failed=has_failed)


def _end(step: Reduction, found: OpenStep, failure: str = "") -> None:
    outcome = StepOutcome(
        step=found.step,
        result=Result.FAILED if failure else Result.DONE,
        reason=failure or found.note,
        seconds=step.now - found.began_at,
    )
    step.effects.append(outcome)


def _result(world: World, change: Change, each: OpenStep, now: float) -> str | None:
    """Give why a step failed; empty: it is done; None: it is under way."""
    if world.is_stopping:
        return "the system is being stopped"
    result = None if each.asks else _result_in(world, each.step)
    if result is None and now >= each.began_at + change.limit:
        return f"it takes longer than {change.limit:g} s"
    return result


def _result_in(world: World, plan_step: Step) -> str | None:
    """The same, from the state of the unit of a step."""
    unit, action = world.find(plan_step.name), plan_step.action
    is_stuck = isinstance(unit, Process) and unit.is_stuck
    if plan_step.kind is PlanKind.SESSION:
        return ""
    if action is PlanAction.REMOVE:
        return "" if unit is None else _STUCK if is_stuck else None
    if plan_step.name in world.dismissed:
        return ""  # an operator stopped it meanwhile
    if unit is None:
        return "it is no longer declared"
    if action is PlanAction.ADOPT and not unit.is_requested:
        return ""
    if is_stuck and isinstance(unit, Process) and unit.next_config is not None:
        return _STUCK
    return None if unit.is_requested else unit_state(world, unit)


def next_deadline(world: World) -> float | None:
    """When a step is over at the latest."""
    change = world.change
    if change is None:
        return None
    return min((each.began_at + change.limit for each in change.open), default=None)


# What a step changes.


def _begin(step: Reduction, change: Change, plan_step: Step) -> OpenStep:
    opened, world = OpenStep(plan_step, step.now), step.world
    if plan_step.kind is PlanKind.SESSION:
        return opened
    match plan_step.action:
        case PlanAction.REMOVE:
            unit = world.find(plan_step.name)
            if isinstance(unit, Process):
                world.put(unit, is_removed=True, request_reason=_BECAUSE)
            elif unit is not None:
                world.put(unit, is_removed=True)
        case PlanAction.ADOPT | PlanAction.SET:
            if any(each.need is Need.SET for each in plan_step.changes):
                step.effects.append(SetParameters(plan_step))
                return replace(opened, asks=True)
            _adopt(world, change, plan_step)
        case _:
            _replace(world, change, plan_step)
    return opened


def _adopt(world: World, change: Change, plan_step: Step) -> None:
    unit, config = world.find(plan_step.name), change.target.parts[plan_step.name]
    if isinstance(unit, Node):
        world.put(unit, config=config, **node_rules.TRUSTED)
    elif unit is not None:
        world.put(unit, config=config)


def _replace(world: World, change: Change, plan_step: Step) -> None:
    """Have one run that is configured as in the target, anew if it runs."""
    unit, config = world.find(plan_step.name), change.target.parts[plan_step.name]
    nodes = config.composable_nodes if isinstance(config, ContainerConfig) else ()
    recalled = {plan_step.name, *(str(node.key) for node in nodes)}
    world.dismissed -= recalled & change.recalls
    anew = {"is_requested": True, "is_removed": False}
    if isinstance(unit, Node):
        world.put(unit, config=config, next_at=None, **anew, **node_rules.TRUSTED)
    elif unit is not None:
        world.put(unit, next_config=config, request_reason=_BECAUSE, **anew)
    else:
        world.declare(config)

"""The reducer: the only place that changes the world, from one input to the effects that follow.

Everything that follows from the state of the world alone is evaluated after each input: an input
that was missed costs a delay, never a hang.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, TypeVar

from play_launch.supervisor import change, goals, inputs, node_rules, process_rules, quarantine
from play_launch.supervisor.conditions import has_arrived, nothing_is_left, stopped_before
from play_launch.supervisor.transitions import IDLE
from play_launch.supervisor.world import INACTIVE, Phase, Process

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from play_launch.config.model import ContainerConfig
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

    def container_of(self, node: Node) -> ContainerConfig:
        config = self.process(node.key.container).container
        assert config is not None
        return config

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
    """Change the world as an input says, and give the effects that are to be carried out."""
    step = Reduction(world, now, chance)
    unit = said.unit if isinstance(said, inputs.UnitReport) else ""
    try:
        if not isinstance(said, inputs.UnitReport) or _is_current(world, said):
            _RULES[type(said)](step, said)
    except Exception as error:  # noqa: BLE001 - the other units continue
        step.effects.append(inputs.Raised(unit, error))
    try:
        _settle(step, is_about_all=isinstance(said, _ABOUT_ALL))
    except Exception as error:  # noqa: BLE001 - the effects until then are carried out
        step.effects.append(inputs.Raised("", error))
    # What is declared anew later is wanted.
    world.dismissed = frozenset(each for each in world.dismissed if world.find(each))
    return step.finish()


def deadline(world: World) -> float | None:
    """When the input `Time` is due next; None: time alone changes nothing."""
    times = (change.next_deadline(world), world.next_due())
    return min((at for at in times if at is not None), default=None)


def _is_current(world: World, said: inputs.UnitReport) -> bool:
    """Whether a report is about the latest start of a process; others change nothing."""
    process = world.processes.get(said.unit)
    return process is not None and process.attempt == said.start and process.is_present


def _due(step: Reduction, _: inputs.Time) -> None:
    _evaluate(step, _all(step.world), process_rules.due, node_rules.due)


def _found(step: Reduction, said: inputs.Found) -> None:
    step.world.met = said.met


def _stop(step: Reduction, said: inputs.StopRequested) -> None:
    world = step.world
    world.is_hurried |= said.is_hurried
    if not world.is_stopping and not said.is_hurried:
        world.stop_reason = said.reason
        world.stop_order = stopped_before(world)


def _operate(step: Reduction, said: inputs.StartRequested | inputs.EndRequested) -> None:
    """Note what an operator wants; it waits for no conditions."""
    world, unit = step.world, step.world.find(said.unit)
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
        idle = {*INACTIVE, Phase.STOPPING, Phase.BACKOFF, Phase.QUEUED}
        runs = was_wanted and unit.phase not in idle
        is_new = said.anew or not runs
        values["request_reason"] = said.reason if said.anew else ""
    else:
        is_new = said.anew or not was_wanted or unit.state in IDLE
        values |= {"next_at": None, "gives_up": ""}
    released_at = step.now if unit.released_at is None else unit.released_at
    is_requested = unit.is_requested or is_new
    world.put(unit, released_at=released_at, is_requested=is_requested, **values)


_RULES: Final[Mapping[type[Input], Callable[[Reduction, Any], None]]] = {
    inputs.Started: process_rules.started,
    inputs.NotStarted: process_rules.not_started,
    inputs.Greeted: process_rules.greeted,
    inputs.Faulty: process_rules.faulty,
    inputs.Exited: process_rules.exited,
    inputs.CleanedUp: process_rules.cleaned_up,
    inputs.Unkillable: process_rules.unkillable,
    inputs.Failed: process_rules.failed,
    inputs.NodeReported: node_rules.reported,
    inputs.HealthReported: node_rules.health,
    inputs.Probed: quarantine.probed,
    inputs.GoalReported: goals.reported,
    inputs.Time: _due,
    inputs.Found: _found,
    inputs.StopRequested: _stop,
    inputs.StartRequested: _operate,
    inputs.EndRequested: _operate,
    inputs.ChangeRequested: change.begin,
    inputs.ParametersSet: change.parameters_set,
}


def _settle(step: Reduction, *, is_about_all: bool) -> None:
    """Evaluate what follows from the state of the world until nothing more does."""
    world = step.world
    for _ in range(_ROUNDS):
        touched, world.touched = world.touched, set()
        before = (world.change, world.stop_reason)
        is_about_all = is_about_all or world.is_stopping or world.change is not None
        concerned = _all(world) if is_about_all else _concerned(world, touched)
        _evaluate(step, concerned, process_rules.settle, node_rules.settle)
        for name in list(world.goals):
            step.confine(name.partition(":")[0], goals.settle, name)
        change.settle_confined(step)
        if not world.is_stopping and nothing_is_left(world):
            process_rules.request_stop(step, "nothing is left to run")
        if not world.is_stopping:
            units = [unit for key in touched if (unit := world.find(key)) is not None]
            world.arrived.update(str(unit.key) for unit in units if has_arrived(world, unit))
        if not world.touched and before == (world.change, world.stop_reason):
            return
    raise AssertionError("the rules do not come to an end")


def _evaluate(
    step: Reduction,
    keys: list[UnitKey],
    of_process: Callable[[Reduction, str], None],
    of_node: Callable[[Reduction, NodeKey], None],
) -> None:
    for key in keys:
        if isinstance(key, str):
            if key in step.world.processes:
                step.confine(key, of_process, key)
        elif key in step.world.nodes:
            step.confine(key.container, of_node, key)


def _all(world: World) -> list[UnitKey]:
    return [*world.processes, *world.nodes]


def _concerned(world: World, touched: set[UnitKey]) -> list[UnitKey]:
    """Give the units whose rules may have another result than before, as declared."""
    found = touched | world.waiting
    for key in touched:
        if isinstance(key, str):
            found |= set(world.keys.get(key, ()))
    ordered = sorted(found & world.places.keys(), key=world.places.__getitem__)
    return sorted(ordered, key=lambda key: not isinstance(key, str))

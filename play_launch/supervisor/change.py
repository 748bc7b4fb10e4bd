"""Changes a running system to another configuration: phase by phase, and each step to its result.

A step changes what is wanted; what follows is the same as for a start. So a step is done when the
world has come to where the step leads.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from msgspec import Struct
from msgspec.structs import replace

from play_launch.config.model import ContainerConfig
from play_launch.config.node_key import NodeKey
from play_launch.supervisor.events import NodeState
from play_launch.supervisor.inputs import ChangeEnded, Raised, SetParameters
from play_launch.supervisor.plan import Need, PlanAction, PlanKind, Result, StepOutcome
from play_launch.supervisor.view import FAILED_STATES, described
from play_launch.supervisor.world import INACTIVE, STATE_OF_PHASE, Goal, Node, Phase, Process, Stage

if TYPE_CHECKING:
    from play_launch.config.model import ComposableNodeConfig, ProcessConfig, ReplayConfig
    from play_launch.supervisor.inputs import ChangeRequested, ParametersSet
    from play_launch.supervisor.plan import Step
    from play_launch.supervisor.reducer import Reduction
    from play_launch.supervisor.world import World

_BECAUSE = "the configuration has changed"


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
        _adopt(step.world, change.target, said.step)
        _end(step, found)
        return
    is_process = said.step.kind is PlanKind.PROCESS
    note = f"{'restarted' if is_process else 'reloaded'}: {said.refusal}"
    step.world.change = replace(change, open=(*others, replace(found, asks=False, note=note)))
    _replace(step.world, change.target, said.step)


def settle_confined(step: Reduction) -> None:
    """The same as `settle`; an exception in it ends the change, and nothing else."""
    try:
        settle(step)
    except Exception as error:  # noqa: BLE001 - the units go on
        step.effects.append(Raised("", error))
        change = step.world.change
        step.world.change = None
        for each in change.open if change is not None else ():
            _end(step, each, "internal error")
        step.effects.append(ChangeEnded())


def settle(step: Reduction) -> None:
    """End the steps that are over, and begin those of the next phase."""
    while (change := step.world.change) is not None and not change.open:
        if not change.phases or change.has_failed:
            step.world.change = None
            step.effects.append(ChangeEnded())
            return
        first, *rest = change.phases
        opened = tuple(_begin(step, change.target, each) for each in first)
        step.world.change = replace(change, phases=tuple(rest), open=opened)
        _judge(step)
    _judge(step)


def _judge(step: Reduction) -> None:
    world = step.world
    change = world.change
    if change is None:
        return
    still_open: list[OpenStep] = []
    has_failed = change.has_failed
    for each in change.open:
        failure = _result(world, change, each, step.now)
        if failure is None:
            still_open.append(each)
        else:
            has_failed = has_failed or bool(failure)
            if each.asks:  # its next load or start reads them
                _adopt(world, change.target, each.step)
            _end(step, each, failure)
    if len(still_open) != len(change.open):
        world.change = replace(change, open=tuple(still_open), has_failed=has_failed)


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
    settled = None if each.asks else _settled(world, each.step)
    if settled is None and now >= each.began_at + change.limit:
        return f"it takes longer than {change.limit:g} s"
    return settled


def next_deadline(world: World) -> float | None:
    """When a step is over at the latest."""
    change = world.change
    if change is None:
        return None
    return min((each.began_at + change.limit for each in change.open), default=None)


# What a step changes.


def _begin(step: Reduction, target: ReplayConfig, plan_step: Step) -> OpenStep:
    opened = OpenStep(plan_step, step.now)
    if plan_step.kind is PlanKind.SESSION:
        return opened
    if plan_step.action is PlanAction.REMOVE:
        _remove(step.world, plan_step)
    elif plan_step.action in {PlanAction.ADOPT, PlanAction.SET}:
        if any(change.need is Need.SET for change in plan_step.changes):
            step.effects.append(SetParameters(plan_step))
            return replace(opened, asks=True)
        _adopt(step.world, target, plan_step)
    else:
        _replace(step.world, target, plan_step)
    return opened


def _remove(world: World, plan_step: Step) -> None:
    if plan_step.kind is PlanKind.COMPONENT:
        if (node := world.nodes.get(NodeKey.parsed(plan_step.name))) is not None:
            world.put(node, is_removed=True)
    elif (process := world.processes.get(plan_step.name)) is not None:
        world.put(process, is_removed=True, request_reason=_BECAUSE)


def _adopt(world: World, target: ReplayConfig, plan_step: Step) -> None:
    config: Any = declared(target, plan_step)
    if plan_step.kind is PlanKind.COMPONENT:
        node = world.nodes[NodeKey.parsed(plan_step.name)]
        world.put(node, config=config, stage=Stage.TRUSTED, deaths=0)
    else:
        world.put(world.processes[plan_step.name], config=config)


def _replace(world: World, target: ReplayConfig, plan_step: Step) -> None:
    """Have one run that is configured as in the target, anew if it runs."""
    config: Any = declared(target, plan_step)
    nodes = config.composable_nodes if plan_step.kind is PlanKind.CONTAINER else ()
    if world.change is not None:
        recalled = {plan_step.name, *(str(node.key) for node in nodes)}
        world.dismissed -= recalled & world.change.recalls
    if plan_step.kind is PlanKind.COMPONENT:
        _replace_node(world, NodeKey.parsed(plan_step.name), config)
        return
    process = world.processes.get(plan_step.name)
    if process is None:
        world.put(Process(config=config))
        if isinstance(config, ContainerConfig):
            for each in config.composable_nodes:
                world.put(Node(config=each))
        return
    world.put(
        process,
        next_config=config,
        generation=process.generation + 1,
        is_removed=False,
        request_reason=_BECAUSE,
    )


def _replace_node(world: World, key: NodeKey, config: ComposableNodeConfig) -> None:
    node = world.nodes.get(key)
    if node is None:
        world.put(Node(config=config))
        return
    world.put(
        node,
        config=config,
        generation=node.generation + 1,
        is_removed=False,
        next_at=None,
        stage=Stage.TRUSTED,
        deaths=0,
    )


def declared(
    target: ReplayConfig, plan_step: Step
) -> ContainerConfig | ProcessConfig | ComposableNodeConfig:
    """Find what a step is about in the new configuration."""
    for container in target.containers:
        if plan_step.kind is PlanKind.CONTAINER and container.full_name == plan_step.name:
            return container
        if plan_step.kind is PlanKind.COMPONENT:
            for node in container.composable_nodes:
                if str(node.key) == plan_step.name:
                    return node
    for process in target.nodes:
        if plan_step.kind is PlanKind.PROCESS and process.full_name == plan_step.name:
            return process
    raise KeyError(plan_step.name)


# What a step leads to.


def _settled(world: World, plan_step: Step) -> str | None:
    """Give why what a step is about is not up; empty: it is, or is gone; None: not yet known."""
    if plan_step.kind is PlanKind.SESSION:
        return ""
    if plan_step.name in world.dismissed and plan_step.action is not PlanAction.REMOVE:
        return ""  # an operator stopped it meanwhile
    if plan_step.kind is PlanKind.COMPONENT:
        return _node_settled(world, plan_step)
    process = world.processes.get(plan_step.name)
    if plan_step.action is PlanAction.REMOVE:
        if process is None:
            return ""
        return "its process does not die, not even of SIGKILL" if process.is_stuck else None
    if process is None:
        return "it is no longer declared"
    if plan_step.action is PlanAction.ADOPT and process.generation <= process.attempted:
        return ""
    if process.next_config is not None and process.is_stuck:
        return "its process does not die, not even of SIGKILL"
    if process.generation > process.attempted:
        return None
    return _container_settled(world, process) if process.container else _process_settled(process)


def _process_settled(process: Process) -> str | None:
    if process.phase is Phase.RUNNING:
        return ""
    if process.phase not in INACTIVE:
        return None
    if process.phase is Phase.STOPPED and process.exit is not None and process.exit.is_ok:
        return ""
    text = process.exit.text if process.exit is not None else ""
    return process.reason or text or "it has failed"


def _container_settled(world: World, process: Process) -> str | None:
    if process.phase in INACTIVE:
        return described(STATE_OF_PHASE[process.phase], process.reason)
    if process.phase is not Phase.RUNNING:
        return None
    settled = {node.key: _load_settled(node) for node in world.nodes_of(process.name)}
    if None in settled.values():
        return None
    failed = [f"{key.name}: {reason}" for key, reason in settled.items() if reason]
    if not failed:
        return ""
    more = f", and {len(failed) - 1} more" if len(failed) > 1 else ""
    return f"{failed[0]}{more}"


def _node_settled(world: World, plan_step: Step) -> str | None:
    key = NodeKey.parsed(plan_step.name)
    node = world.nodes.get(key)
    if plan_step.action is PlanAction.REMOVE:
        return "" if node is None else None
    if node is None:
        return "it is no longer declared"
    if plan_step.action is PlanAction.ADOPT and node.generation <= node.attempted:
        return ""
    container = world.processes[key.container]
    if container.phase in INACTIVE:
        state = described(STATE_OF_PHASE[container.phase], container.reason)
        return f"its container is not there: {state}"
    return _load_settled(node)


def _load_settled(node: Node) -> str | None:
    if node.generation > node.attempted:
        return None
    if node.state is NodeState.LOADED:
        return ""
    is_absent = node.state in FAILED_STATES or node.state is NodeState.UNLOADED
    return described(node.state, node.reason) if is_absent else None

"""A plan: what differs from the running system, and what is done about each difference."""

from __future__ import annotations

from collections import defaultdict
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, TypeVar, cast

from msgspec import Struct
from msgspec.structs import replace

from play_launch.config.description import describe
from play_launch.config.model import ComposableNodeConfig, ContainerConfig, ProcessConfig

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from play_launch.config.model import ReplayConfig

_Part = TypeVar("_Part", ContainerConfig, ProcessConfig, ComposableNodeConfig)


class PlanKind(StrEnum):
    """What a step is about."""

    SESSION = "session"
    """The run itself: its recording, its limits."""
    CONTAINER = "container"
    COMPONENT = "component"
    """A composable node."""
    PROCESS = "process"


class Need(StrEnum):
    """What it takes to have one changed value hold, from the least to the most."""

    NOTHING = "nothing"
    """The supervisor takes it over; no process notices."""
    SET = "set"
    """A parameter: the node is asked to take it."""
    RELOAD = "reload"
    """It is read when a composable node is loaded."""
    RESTART = "restart"
    """It is read when a process is started."""
    NEXT_RUN = "next run"
    """It is read when `replay` is started."""


class PlanAction(StrEnum):
    """What is done about one member, node, or the session."""

    REMOVE = "remove"
    ADOPT = "adopt"
    """Changed values are taken over by the supervisor."""
    SET = "set"
    """Parameters are set; a node that refuses is reloaded or restarted."""
    RELOAD = "reload"
    RESTART = "restart"
    LOAD = "load"
    """A declared node that is not there is loaded."""
    START = "start"
    """A declared member that is not there is started."""
    ADD = "add"
    KEEP = "keep"
    """Nothing: the changed values hold from the next run on."""


PHASES: Final = (
    (PlanAction.REMOVE,),
    (PlanAction.ADOPT, PlanAction.SET),
    (PlanAction.RELOAD, PlanAction.RESTART),
    (PlanAction.LOAD, PlanAction.START, PlanAction.ADD),
)
"""Phases of a plan, in order, so that a name is free before it is taken again; the actions of one
phase are done at the same time."""

SIGNS: Final = {
    PlanAction.REMOVE: "-",
    PlanAction.LOAD: "+",
    PlanAction.START: "+",
    PlanAction.ADD: "+",
}
"""Marks in the output; all other actions change something that stays: ``~``."""


class ItemChange(Struct, frozen=True):
    """One value that differs; `before` and `after` are JSON values, None where one is missing.

    A parameter is ``{"type": ..., "value": ...}``.
    """

    path: str
    """Its key, or keys joined with dots."""
    before: object
    after: object
    need: Need


class Step(Struct, frozen=True, kw_only=True):
    """One member or node that differs.

    `name` is the full name, ``/container:/node`` for a composable node, empty for the session.
    """

    kind: PlanKind
    name: str
    action: PlanAction
    changes: tuple[ItemChange, ...] = ()
    reason: str = ""
    """Why, where the changes do not say it."""
    covered: bool = False
    """Whether it comes with the start or the end of its container, so has no action of its own."""

    @property
    def sign(self) -> str:
        return SIGNS.get(self.action, "~")

    @property
    def id(self) -> tuple[PlanKind, str]:
        """What it is about; no other step that is carried out is."""
        return self.kind, self.name


class Plan(Struct, frozen=True):
    """All that differs: containers with their nodes, processes, the session."""

    steps: tuple[Step, ...] = ()

    @property
    def differs(self) -> bool:
        return bool(self.steps)

    @property
    def to_do(self) -> tuple[Step, ...]:
        return tuple(
            step for step in self.steps if step.action is not PlanAction.KEEP and not step.covered
        )

    def phases(self) -> tuple[tuple[Step, ...], ...]:
        """Give the steps that are carried out, in their order; none of them is empty."""
        to_do = self.to_do
        phases = (tuple(step for step in to_do if step.action in phase) for phase in PHASES)
        return tuple(phase for phase in phases if phase)


class Result(StrEnum):
    """Result of one step."""

    DONE = "done"
    FAILED = "failed"
    """It was begun: what runs of it is configured as it was to be."""
    SKIPPED = "skipped"
    """It was not begun, because another one had failed: everything is as it was."""


class StepOutcome(Struct, frozen=True, kw_only=True):
    """Result of one step, and its duration in seconds."""

    step: Step
    result: Result
    reason: str = ""
    """Why it failed; of one that is done, how, where that is not as planned."""
    seconds: float = 0.0

    @property
    def holds(self) -> bool:
        """Whether the new configuration is that of the thing, up or not.

        What could not be taken out is still as it was.
        """
        failed = self.result is Result.FAILED
        return self.result is Result.DONE or (failed and self.step.action is not PlanAction.REMOVE)


class Applied(Struct, frozen=True, kw_only=True):
    """Result of a plan; `rollback` has the steps back to the configuration before."""

    plan: Plan
    outcomes: tuple[StepOutcome, ...] = ()
    rollback: tuple[StepOutcome, ...] | None = None

    @property
    def succeeded(self) -> bool:
        return all(each.result is Result.DONE for each in self.outcomes)


def after(running: ReplayConfig, target: ReplayConfig, done: Iterable[Step]) -> ReplayConfig:
    """Give the configuration after ``done``, some steps of the plan from one to the other."""
    actions = {step.id: step.action for step in done if step.action is not PlanAction.KEEP}

    def merged(
        kind: PlanKind, before: Iterable[_Part], target: Iterable[_Part]
    ) -> tuple[_Part, ...]:
        """Choose what a step has made of each; the new ones first, then those that are only old."""
        old: dict[str, _Part] = {_name(each): each for each in before}
        new: dict[str, _Part] = {_name(each): each for each in target}
        found: list[_Part] = []
        for name in dict.fromkeys((*new, *old)):
            was, is_, action = old.get(name), new.get(name), actions.get((kind, name))
            chosen = was if action is None else is_
            if (
                isinstance(was, ContainerConfig)
                and isinstance(is_, ContainerConfig)
                and isinstance(chosen, ContainerConfig)
                and action in {None, PlanAction.ADOPT}
            ):
                nodes = merged(PlanKind.COMPONENT, was.composable_nodes, is_.composable_nodes)
                chosen = replace(chosen, composable_nodes=nodes)
            if chosen is not None:
                found.append(chosen)
        return tuple(found)

    session = target if (PlanKind.SESSION, "") in actions else running
    return replace(
        running,
        stop=session.stop,
        start_rules=session.start_rules,
        managed=session.managed,
        containers=merged(PlanKind.CONTAINER, running.containers, target.containers),
        nodes=merged(PlanKind.PROCESS, running.nodes, target.nodes),
    )


def _name(part: ContainerConfig | ProcessConfig | ComposableNodeConfig) -> str:
    return str(part.key) if isinstance(part, ComposableNodeConfig) else part.full_name


_ACTIONS: Final = (
    (Need.RESTART, PlanAction.RESTART),
    (Need.RELOAD, PlanAction.RELOAD),
    (Need.SET, PlanAction.SET),
    (Need.NOTHING, PlanAction.ADOPT),
)
"""What is done when a change needs it; the first that one of them needs."""

_NOBODY: Final[Mapping[str, str]] = MappingProxyType({})
_PAIR: Final = 2
_IDENTITY: Final = {"key", "full_name", "name", "namespace", "line"}


def plan(running: ReplayConfig, target: ReplayConfig, absent: Mapping[str, str] = _NOBODY) -> Plan:
    """Compare the running system with what it is to become.

    Args:
        running: What the system was started with, or what was applied to it at last.
        target: What it is to become.
        absent: What is declared and not there, by its name as in `Step`, with the reason. All of
            it is brought up, whether or not its configuration differs.
    """
    before, after = describe(running), describe(target)
    steps = [
        *_containers(_by_name(before, "containers"), _by_name(after, "containers"), absent),
        *_members(PlanKind.PROCESS, _by_name(before, "nodes"), _by_name(after, "nodes"), absent),
        *_session(before, after),
    ]
    return Plan(tuple(_with_origins(steps, _nodes_of(before), _nodes_of(after))))


def _containers(
    before: Mapping[str, Described], after: Mapping[str, Described], absent: Mapping[str, str]
) -> Iterator[Step]:
    members = {step.name: step for step in _members(PlanKind.CONTAINER, before, after, absent)}
    for name in dict.fromkeys((*after, *before)):
        member = members.get(name)
        if member is not None:
            yield member
        # A process that is started loads what is declared by then.
        covered = member is not None and member.action is not PlanAction.ADOPT
        yield from (
            replace(step, covered=True) if covered else step
            for step in _members(
                PlanKind.COMPONENT,
                _components(before.get(name)),
                _components(after.get(name)),
                # What fails together with its container is no news.
                _NOBODY if covered else absent,
            )
        )


def _members(
    kind: PlanKind,
    before: Mapping[str, Described],
    after: Mapping[str, Described],
    absent: Mapping[str, str],
) -> Iterator[Step]:
    """Compare those of one kind by their names: those that stay or come, then those that go."""
    for name, described in after.items():
        if name not in before:
            yield Step(kind=kind, name=name, action=PlanAction.ADD)
            continue
        changes = differences(kind, before[name], described)
        needs = {change.need for change in changes}
        action = next((action for need, action in _ACTIONS if need in needs), None)
        if name in absent:
            action = _brought_up(kind, action)
        if action is not None:
            reason = absent.get(name, "")
            yield Step(kind=kind, name=name, action=action, changes=changes, reason=reason)
    for name in before:
        if name not in after:
            yield Step(kind=kind, name=name, action=PlanAction.REMOVE)


def _brought_up(kind: PlanKind, action: PlanAction | None) -> PlanAction:
    """Choose what also has the thing there; nothing can be set where nothing runs."""
    if action in {PlanAction.RESTART, PlanAction.RELOAD}:
        return action
    return PlanAction.LOAD if kind is PlanKind.COMPONENT else PlanAction.START


def _session(before: Described, after: Described) -> Iterator[Step]:
    changes = differences(PlanKind.SESSION, before, after)
    for need, action in ((Need.NOTHING, PlanAction.ADOPT), (Need.NEXT_RUN, PlanAction.KEEP)):
        if those := tuple(change for change in changes if change.need is need):
            # The two are apart, for one of them is done.
            yield Step(kind=PlanKind.SESSION, name="", action=action, changes=those)


def _with_origins(
    steps: Iterable[Step], before: Mapping[str, Described], after: Mapping[str, Described]
) -> Iterator[Step]:
    """Say which of those that are added is one that is removed, under another name or elsewhere."""
    steps = tuple(steps)
    alike: defaultdict[tuple[PlanKind, str], list[Step]] = defaultdict(list)
    for step in steps:
        described = {PlanAction.REMOVE: before, PlanAction.ADD: after}.get(step.action, {}).get(
            step.name
        )
        if described is not None:
            alike[step.kind, _likeness(described)].append(step)
    reasons: dict[tuple[PlanKind, str], str] = {}
    for pair in alike.values():
        if {step.action for step in pair} == {PlanAction.ADD, PlanAction.REMOVE} and len(
            pair
        ) == _PAIR:
            new, old = sorted(pair, key=lambda step: step.action is PlanAction.REMOVE)
            reasons |= {new.id: f"it was {old.name}", old.id: f"it becomes {new.name}"}
    for step in steps:
        reason = reasons.get(step.id)
        yield step if reason is None else replace(step, reason=reason)


def _likeness(described: Described) -> str:
    """What two nodes have in common that differ in their names and places only."""
    return repr({key: value for key, value in described.items() if key not in _IDENTITY})


def _by_name(config: Described, key: str) -> dict[str, Described]:
    members = cast("list[Described]", config[key])
    return {str(each["full_name"]): each for each in members}


def _components(container: Described | None) -> dict[str, Described]:
    if container is None:
        return {}
    nodes = cast("list[Described]", container["composable_nodes"])
    return {str(each["key"]): each for each in nodes}


def _nodes_of(config: Described) -> dict[str, Described]:
    """Give the composable nodes and processes; those of containers have a colon in their names."""
    containers = _by_name(config, "containers").values()
    nodes = {key: node for each in containers for key, node in _components(each).items()}
    return nodes | _by_name(config, "nodes")


Described = dict[str, object]

_SAFE: Final = {
    PlanKind.SESSION: Need.NEXT_RUN,
    PlanKind.CONTAINER: Need.RESTART,
    PlanKind.COMPONENT: Need.RELOAD,
    PlanKind.PROCESS: Need.RESTART,
}
"""What a changed value needs that is not taken over."""
_TAKEN_OVER: Final = {
    # What has to hold before a start is looked at when something is started.
    PlanKind.SESSION: {"stop", "start_rules", "managed"},
    PlanKind.CONTAINER: {"on_exit", "restart", "loading_timeout", "probe_timeout", "output"},
    PlanKind.COMPONENT: {"on_crash", "restart"},
    PlanKind.PROCESS: {"on_exit", "restart", "output"},
}
"""Keys whose values the supervisor takes over."""
_NO_DIFFERENCE: Final = {
    # Those of members are in their own descriptions. Where a file is makes no difference, nor does
    # the session's name, which is that of its file unless it is given.
    PlanKind.SESSION: {
        *("version", "name", "source", "included_files", "parameter_files", "taken"),
        *("environment", "containers", "nodes"),
    },
    PlanKind.CONTAINER: {"line", "file", "composable_nodes"},
    PlanKind.COMPONENT: {"line", "file", "key", "full_name"},
    PlanKind.PROCESS: {"line", "file"},
}
"""Keys that are not compared."""
_PARAMETERS: Final = "parameters"


def differences(kind: PlanKind, before: Described, after: Described) -> tuple[ItemChange, ...]:
    """Compare two descriptions of the same member, node or session."""
    found: list[ItemChange] = []
    for key in _keys(before, after):
        if key in _NO_DIFFERENCE[kind]:
            continue
        if key == _PARAMETERS:
            found += _parameters(kind, after, before.get(key), after.get(key))
        else:
            need = Need.NOTHING if key in _TAKEN_OVER[kind] else _SAFE[kind]
            found += _values(key, before.get(key), after.get(key), need)
    return tuple(found)


def _values(path: str, before: object, after: object, need: Need) -> Iterator[ItemChange]:
    if isinstance(before, dict) and isinstance(after, dict):
        for key in _keys(before, after):
            yield from _values(f"{path}.{key}", before.get(key), after.get(key), need)
    elif before != after:
        yield ItemChange(path, before, after, need)


def _parameters(
    kind: PlanKind, node: Described, before: object, after: object
) -> Iterator[ItemChange]:
    """Compare parameters.

    What a node was given cannot be taken back from it, and one whose name is not declared cannot
    be asked.
    """
    assert isinstance(before, dict)
    assert isinstance(after, dict)
    for name in _keys(before, after):
        was, is_ = before.get(name), after.get(name)
        if was != is_:
            settable = is_ is not None and bool(node.get("name"))
            yield ItemChange(
                f"{_PARAMETERS}.{name}", was, is_, Need.SET if settable else _SAFE[kind]
            )


def _keys(before: Mapping[str, object], after: Mapping[str, object]) -> list[str]:
    return list(dict.fromkeys((*before, *after)))

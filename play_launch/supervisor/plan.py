"""A plan: what differs from the running system, and what is done about each difference."""

from __future__ import annotations

from collections import defaultdict
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, TypeAlias, TypeVar

from msgspec import Struct
from msgspec.structs import asdict, replace

from play_launch.config.description import described
from play_launch.config.machines import in_any_copy
from play_launch.config.model import ComposableNodeConfig, ContainerConfig, ProcessConfig

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from play_launch.config.model import ReplayConfig

_Part = TypeVar("_Part", ContainerConfig, ProcessConfig, ComposableNodeConfig)
_Config: TypeAlias = "ContainerConfig | ProcessConfig | ComposableNodeConfig | ReplayConfig"
_Id: TypeAlias = "tuple[PlanKind, str]"


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
    def id(self) -> tuple[PlanKind, str]:
        """What it is about; no other step that is carried out is."""
        return self.kind, self.name


class Plan(Struct, frozen=True):
    """All that differs: containers with their nodes, processes, the session."""

    steps: tuple[Step, ...] = ()

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

_NONE: Final[Mapping[str, str]] = MappingProxyType({})
_IDENTITY: Final = {"key", "full_name", "name", "namespace", "line"}
_PARAMETERS: Final = "parameters"
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
    # Where a file is makes no difference, nor does the session's name, which is that of its file
    # unless it is given; the environment is that of members, in their own configurations.
    PlanKind.SESSION: {
        *("name", "source", "text", "included_files", "parameter_files", "taken", "environment"),
        *("containers", "nodes"),
    },
    PlanKind.CONTAINER: {"line", "file", "name", "namespace", "composable_nodes"},
    PlanKind.COMPONENT: {"line", "file", "key"},
    PlanKind.PROCESS: {"line", "file"},
}
"""Keys that are not compared."""


def plan(running: ReplayConfig, target: ReplayConfig, absent: Mapping[str, str] = _NONE) -> Plan:
    """Compare the running system with what it is to become.

    Args:
        running: What the system was started with, or what was applied to it at last.
        target: What it is to become.
        absent: What is declared and not there, by its name as in `Step`, with the reason. All of
            it is brought up, whether or not its configuration differs.
    """
    before, after = _parts(running), _parts(target)
    steps: list[Step] = []
    renewed: set[str] = set()
    for kind, name in _ordered(before, after):
        was, is_ = before.get((kind, name)), after.get((kind, name))
        # A process that is started loads what is declared by then, and what fails together with
        # its container is no news.
        covered = kind is PlanKind.COMPONENT and name.partition(":/")[0] in renewed
        if was is None or is_ is None:
            action = PlanAction.ADD if was is None else PlanAction.REMOVE
            found = [Step(kind=kind, name=name, action=action)]
        else:
            changes = tuple(differences(kind, was, is_))
            found = [*_steps(kind, name, changes, None if covered else absent.get(name))]
        steps += [replace(step, covered=covered) for step in found]
        if kind is PlanKind.CONTAINER:
            renewed |= {name for step in found if step.action is not PlanAction.ADOPT}
    return Plan(tuple(_with_origins(steps, before, after)))


def _parts(config: ReplayConfig) -> dict[_Id, _Config]:
    """Give containers, each before its nodes, processes, and the session."""
    found: dict[_Id, _Config] = {}
    for container in config.containers:
        found[PlanKind.CONTAINER, container.full_name] = container
        found |= {(PlanKind.COMPONENT, str(each.key)): each for each in container.composable_nodes}
    found |= {(PlanKind.PROCESS, each.full_name): each for each in config.nodes}
    return {**found, (PlanKind.SESSION, ""): config}


def _ordered(before: Iterable[_Id], after: Iterable[_Id]) -> list[_Id]:
    """Bring the parts of both into one order: those of a container together, old ones last."""
    found = list(dict.fromkeys((*after, *before)))
    containers = [name for kind, name in found if kind is PlanKind.CONTAINER]

    def place(part: _Id) -> tuple[int, int]:
        kind, name = part
        if kind in {PlanKind.SESSION, PlanKind.PROCESS}:
            return len(containers), kind is PlanKind.SESSION
        return containers.index(name.partition(":/")[0]), 0

    return sorted(found, key=place)


def _steps(
    kind: PlanKind, name: str, changes: tuple[ItemChange, ...], absent: str | None
) -> Iterator[Step]:
    """Choose what is done about a part that stays; ``absent`` is why it is not there."""
    needs = {change.need for change in changes}
    if kind is PlanKind.SESSION:
        for need, action in ((Need.NOTHING, PlanAction.ADOPT), (Need.NEXT_RUN, PlanAction.KEEP)):
            if those := tuple(change for change in changes if change.need is need):
                # The two are apart, for one of them is done.
                yield Step(kind=kind, name=name, action=action, changes=those)
        return
    chosen = next((action for need, action in _ACTIONS if need in needs), None)
    if absent is not None and chosen not in {PlanAction.RESTART, PlanAction.RELOAD}:
        # Nothing can be set where nothing runs.
        chosen = PlanAction.LOAD if kind is PlanKind.COMPONENT else PlanAction.START
    if chosen is not None:
        yield Step(kind=kind, name=name, action=chosen, changes=changes, reason=absent or "")


def _with_origins(
    steps: Iterable[Step], before: Mapping[_Id, _Config], after: Mapping[_Id, _Config]
) -> Iterator[Step]:
    """Say which of those that are added is one that is removed, under another name or elsewhere."""
    parts = {PlanAction.REMOVE: before, PlanAction.ADD: after}
    alike: defaultdict[tuple[PlanKind, str], list[Step]] = defaultdict(list)
    for step in steps:
        if step.action in parts and step.kind is not PlanKind.CONTAINER:
            values = asdict(parts[step.action][step.id]).items()
            likeness = repr({key: value for key, value in values if key not in _IDENTITY})
            alike[step.kind, likeness].append(step)
    reasons: dict[_Id, str] = {}
    for those in alike.values():
        pair = sorted(those, key=lambda step: step.action)
        if [step.action for step in pair] == [PlanAction.ADD, PlanAction.REMOVE]:
            new, old = pair
            reasons |= {new.id: f"it was {old.name}", old.id: f"it becomes {new.name}"}
    for step in steps:
        yield replace(step, reason=reasons[step.id]) if step.id in reasons else step


def differences(kind: PlanKind, before: _Config, after: _Config) -> Iterator[ItemChange]:
    """Compare two configurations of the same part."""
    for key in before.__struct_fields__:
        was, is_ = getattr(before, key), getattr(after, key)
        if key in _NO_DIFFERENCE[kind] or was == is_:
            continue
        was, is_ = described(key, was), described(key, is_)
        has_moved = in_any_copy(was) == in_any_copy(is_)
        if has_moved and kind is PlanKind.SESSION:
            continue
        if key != _PARAMETERS:
            need = Need.NOTHING if has_moved or key in _TAKEN_OVER[kind] else _SAFE[kind]
            yield from _values(key, was, is_, need)
            continue
        for name in dict.fromkeys((*was, *is_)):
            # What a node was given cannot be taken back from it, and one whose name is not
            # declared cannot be asked.
            need = Need.SET if name in is_ and after.name else _SAFE[kind]
            if was.get(name) != is_.get(name):
                yield ItemChange(f"{_PARAMETERS}.{name}", was.get(name), is_.get(name), need)


def _values(path: str, before: Any, after: Any, need: Need) -> Iterator[ItemChange]:
    if isinstance(before, dict) and isinstance(after, dict):
        for key in dict.fromkeys((*before, *after)):
            yield from _values(f"{path}.{key}", before.get(key), after.get(key), need)
    elif before != after:
        yield ItemChange(path, before, after, need)

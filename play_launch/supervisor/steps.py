"""A plan: what differs from the running system, and what is done about each difference."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Final, TypeVar

from msgspec import Struct
from msgspec.structs import replace

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from play_launch.config.model import ContainerConfig, ReplayConfig


class Kind(StrEnum):
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


class Action(StrEnum):
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
    (Action.REMOVE,),
    (Action.ADOPT, Action.SET),
    (Action.RELOAD, Action.RESTART),
    (Action.LOAD, Action.START, Action.ADD),
)
"""Phases of a plan, in order, so that a name is free before it is taken again; the actions of one
phase are done at the same time."""

SIGNS: Final = {
    Action.REMOVE: "-",
    Action.LOAD: "+",
    Action.START: "+",
    Action.ADD: "+",
}
"""Marks in the output; all other actions change something that stays: ``~``."""


class Change(Struct, frozen=True):
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

    kind: Kind
    name: str
    action: Action
    changes: tuple[Change, ...] = ()
    reason: str = ""
    """Why, where the changes do not say it."""
    covered: bool = False
    """Whether it comes with the start or the end of its container, so has no action of its own."""

    @property
    def sign(self) -> str:
        return SIGNS.get(self.action, "~")

    @property
    def id(self) -> tuple[Kind, str]:
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
            step for step in self.steps if step.action is not Action.KEEP and not step.covered
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
        return self.result is Result.DONE or (failed and self.step.action is not Action.REMOVE)


class Applied(Struct, frozen=True, kw_only=True):
    """Result of a plan; `rollback` has the steps back to the configuration before."""

    plan: Plan
    outcomes: tuple[StepOutcome, ...] = ()
    rollback: tuple[StepOutcome, ...] | None = None

    @property
    def succeeded(self) -> bool:
        return all(each.result is Result.DONE for each in self.outcomes)


_One = TypeVar("_One")
_Name = TypeVar("_Name")


def after(running: ReplayConfig, target: ReplayConfig, done: Iterable[Step]) -> ReplayConfig:
    """Give the configuration after ``done``, some steps of the plan from one to the other."""
    actions = {step.id: step.action for step in done if step.action is not Action.KEEP}
    is_adopted = (Kind.SESSION, "") in actions
    return replace(
        running,
        stop=target.stop if is_adopted else running.stop,
        start_rules=target.start_rules if is_adopted else running.start_rules,
        managed=target.managed if is_adopted else running.managed,
        containers=_merged(
            {each.full_name: each for each in running.containers},
            {each.full_name: each for each in target.containers},
            lambda name, old, new: _container(actions, name, old, new),
        ),
        nodes=_merged(
            {each.full_name: each for each in running.nodes},
            {each.full_name: each for each in target.nodes},
            lambda name, old, new: _chosen(actions.get((Kind.PROCESS, name)), old, new),
        ),
    )


def _container(
    actions: Mapping[tuple[Kind, str], Action],
    name: str,
    old: ContainerConfig | None,
    new: ContainerConfig | None,
) -> ContainerConfig | None:
    action = actions.get((Kind.CONTAINER, name))
    chosen = _chosen(action, old, new)
    if chosen is None or old is None or new is None or action not in {None, Action.ADOPT}:
        return chosen
    nodes = _merged(
        {node.key: node for node in old.composable_nodes},
        {node.key: node for node in new.composable_nodes},
        lambda key, was, is_: _chosen(actions.get((Kind.COMPONENT, str(key))), was, is_),
    )
    return replace(chosen, composable_nodes=nodes)


def _chosen(action: Action | None, old: _One | None, new: _One | None) -> _One | None:
    """Give the one that holds; without a step that is what was there, even if that is nothing."""
    return old if action is None else new


def _merged(
    old: Mapping[_Name, _One],
    new: Mapping[_Name, _One],
    choose: Callable[[_Name, _One | None, _One | None], _One | None],
) -> tuple[_One, ...]:
    """Choose for each name; in the order of the new ones, and then those that are only old."""
    chosen = (choose(name, old.get(name), new.get(name)) for name in dict.fromkeys((*new, *old)))
    return tuple(one for one in chosen if one is not None)

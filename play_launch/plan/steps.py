"""A plan: what differs from the running system, and what is done about each difference."""

from __future__ import annotations

from enum import StrEnum
from typing import Final

from msgspec import Struct


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
"""What is done one after the other, so that a name is free before somebody else takes it; what
stands together is done at the same time."""

SIGNS: Final = {
    Action.REMOVE: "-",
    Action.LOAD: "+",
    Action.START: "+",
    Action.ADD: "+",
}
"""For people; all others change something that stays: ``~``."""


class Change(Struct, frozen=True):
    """One value that differs; `before` and `after` are as JSON has them, None where there is none.

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
    """Whether it comes with the start or the end of its container, so is not done by itself."""

    @property
    def sign(self) -> str:
        """How it is marked for people."""
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
        """Whether the running system is another one."""
        return bool(self.steps)

    @property
    def to_do(self) -> tuple[Step, ...]:
        """The steps that are carried out."""
        return tuple(
            step for step in self.steps if step.action is not Action.KEEP and not step.covered
        )

    def phases(self) -> tuple[tuple[Step, ...], ...]:
        """Give the steps that are carried out, in their order; none of them is empty."""
        to_do = self.to_do
        phases = (tuple(step for step in to_do if step.action in phase) for phase in PHASES)
        return tuple(phase for phase in phases if phase)

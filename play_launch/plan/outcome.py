"""What became of the steps of a plan."""

from __future__ import annotations

from enum import StrEnum

from msgspec import Struct

from play_launch.plan.steps import Action, Plan, Step


class Result(StrEnum):
    """What became of one step."""

    DONE = "done"
    FAILED = "failed"
    """It was begun: what runs of it is configured as it was to be."""
    SKIPPED = "skipped"
    """It was not begun, because another one had failed: everything is as it was."""


class StepOutcome(Struct, frozen=True, kw_only=True):
    """What became of one step, and after how many seconds."""

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
    """What became of a plan; `rollback` is what was done to be back where it began."""

    plan: Plan
    outcomes: tuple[StepOutcome, ...] = ()
    rollback: tuple[StepOutcome, ...] | None = None

    @property
    def succeeded(self) -> bool:
        """Whether everything was done."""
        return all(each.result is Result.DONE for each in self.outcomes)

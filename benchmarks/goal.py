"""What was to be reached, and what was."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Goal:
    """One figure against its goal, in words; `met`: whether it is reached."""

    what: str
    goal: str
    measured: str
    met: bool


def markdown(goals: Iterable[Goal]) -> str:
    """A table; what is short is marked."""
    lines = ["| what | goal | measured | |", "| --- | --- | --- | --- |"]
    lines += [
        f"| {goal.what} | {goal.goal} | {goal.measured} | {'' if goal.met else '**short**'} |"
        for goal in goals
    ]
    return "\n".join(lines)

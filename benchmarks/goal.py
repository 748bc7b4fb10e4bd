"""What was to be reached, and what was."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Goal:
    """One figure against its goal, in words; `met`: whether it is reached."""

    what: str
    goal: str
    measured: str
    met: bool

    @property
    def line(self) -> str:
        """As it is printed."""
        missed = "" if self.met else "  <- missed"
        return f"{self.what}: {self.measured} (goal: {self.goal}){missed}"

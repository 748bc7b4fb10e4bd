"""How a container process ended, as far as it matters for what follows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from play_launch.core.restart import CONTEXT_EXIT_CODE, PERMANENT_EXIT_CODES

if TYPE_CHECKING:
    from play_launch.process.exit import Exit


@dataclass(frozen=True, slots=True)
class Death:
    """The end of a container process, or that it could not be started."""

    reason: str
    permanent: bool = False
    """The next start would only repeat it."""
    by_itself: bool = False
    """In order, because a node wanted it."""
    lived: float = 0.0
    """Seconds from its hello to its end."""


STOPPED_EARLY: Final = Death("it was stopped before it was started")


def death_of(exit_: Exit, killed_because: str, lived: float | None) -> Death:
    """Judge the end of a process.

    Args:
        exit_: Its exit status or signal.
        killed_because: Why the supervisor killed it; empty: it did not.
        lived: Seconds since its hello; None when it never said hello.
    """
    because = f"{killed_because}; " if killed_because else ""
    if lived is None:
        again = PERMANENT_EXIT_CODES.get(exit_.code, "")
        reason = f"{exit_}: {again}" if again else str(exit_)
        return Death(f"{because}{reason}", permanent=bool(again))
    if exit_.code == CONTEXT_EXIT_CODE:
        return Death("a node shut its ROS context down", by_itself=True)
    return Death(f"{because}{exit_}", lived=lived)

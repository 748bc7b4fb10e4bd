"""How a process ended, as far as it matters for what follows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.core.restart import CONTEXT_EXIT_CODE, PERMANENT_EXIT_CODES

if TYPE_CHECKING:
    from play_launch.process.exit import Exit


_NEVER_RAN: Final = frozenset({126, 127})
"""Exit codes that say that the program itself was not executed."""


class Death(Struct, frozen=True):
    """The end of a member's process, or that it could not be started."""

    reason: str
    permanent: bool = False
    """The next start would only repeat it."""
    by_itself: bool = False
    """It is over, and that is no failure of the member."""
    lived: float = 0.0
    """Seconds from being ready to its end."""


def death_of_container(exit_: Exit, killed_because: str, lived: float | None) -> Death:
    """Judge the end of a container's process.

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


def death_of_process(exit_: Exit, lived: float, *, respawn: bool) -> Death:
    """Judge the end of an ordinary executable, after so many seconds.

    Without ``respawn`` its end is no matter of restarting, whatever its status is.
    """
    if not respawn:
        return Death("", by_itself=True, lived=lived)
    if exit_.code in _NEVER_RAN:
        return Death(f"{exit_}: {PERMANENT_EXIT_CODES[exit_.code]}", permanent=True)
    return Death(str(exit_), lived=lived)

"""What follows when a node has crashed alone: its policy, and within which bounds."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING

from msgspec import Struct

from play_launch.core.restart import GiveUp, Restart, decide

if TYPE_CHECKING:
    from play_launch.core.restart import RestartHistory, RestartLimits


class OnCrash(StrEnum):
    """What follows when a node of an isolated container crashes: ``on_crash``."""

    RELOAD = "reload"
    IGNORE = "ignore"
    STOP_CONTAINER = "stop_container"
    SHUTDOWN = "shutdown"


class Ignore(Struct, frozen=True):
    """Nothing follows; the node stays away until its container is started anew."""


class StopContainer(Struct, frozen=True):
    """Its container is stopped for good."""


class Shutdown(Struct, frozen=True):
    """The whole system is stopped."""


FollowUp = Restart | GiveUp | Ignore | StopContainer | Shutdown


def follow_up(
    policy: OnCrash,
    history: RestartHistory,
    bounds: RestartLimits,
    *,
    now: float,
    lived: float,
    jitter: float,
) -> tuple[RestartHistory, FollowUp]:
    """Decide about a crash, or about a reload that failed.

    The arguments are those of :func:`play_launch.core.restart.decide`; ``lived`` is the time from
    loaded to the crash, 0 for a reload that failed.
    """
    match policy:
        case OnCrash.RELOAD:
            return decide(history, bounds, now=now, lived=lived, jitter=jitter)
        case OnCrash.IGNORE:
            return history, Ignore()
        case OnCrash.STOP_CONTAINER:
            return history, StopContainer()
        case OnCrash.SHUTDOWN:
            return history, Shutdown()

"""The memory that bounded restarting needs."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

from msgspec import Struct
from msgspec.structs import replace

from play_launch.core.crash import FollowUp, OnCrash, follow_up
from play_launch.core.member import MemberInput
from play_launch.core.restart import GiveUp, RestartHistory, RestartLimits, decide

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.actors.death import Death


class Sequel(Struct, frozen=True):
    """What follows from the end of a member's process."""

    said: MemberInput
    """The row of its table."""
    reason: str
    delay: float | None = None
    """Seconds to the next start; None: there is none."""


class Restarter:
    """Decides about the deaths of one container or process."""

    def __init__(self, limits: RestartLimits, jitter: Callable[[], float] = random.random) -> None:
        """Take the limits; ``jitter`` gives random numbers in [0, 1)."""
        self._limits = limits
        self._jitter = jitter
        self._history = RestartHistory()

    def limit(self, limits: RestartLimits) -> None:
        """Take other limits; what happened so far counts against them."""
        self._limits = limits

    @property
    def total(self) -> int:
        """Restarts so far."""
        return self._history.total

    def forget(self) -> None:
        """Somebody asked for a start: what was before that counts no more."""
        self._history = RestartHistory(total=self._history.total)

    def follow_up(
        self, death: Death, *, now: float, is_over: bool, counts: Callable[[], bool]
    ) -> Sequel:
        """Decide about a death now; see `core.restart`.

        Args:
            death: How its process ended.
            now: Seconds of a clock.
            is_over: Whether it is not started again, however it died.
            counts: Is asked, where it may be started again, whether that uses up a restart.
        """
        if is_over or death.permanent:
            return Sequel(MemberInput.DIED_FOR_GOOD, death.reason)
        if death.by_itself:
            return Sequel(MemberInput.ENDED, death.reason)
        self._history, verdict = decide(
            self._history,
            self._limits,
            now=now,
            lived=death.lived,
            jitter=self._jitter(),
            counts=counts(),
        )
        if isinstance(verdict, GiveUp):
            return Sequel(MemberInput.DIED_FOR_GOOD, f"{death.reason}; {verdict.reason}")
        return Sequel(MemberInput.DIED_RESTART, death.reason, verdict.delay)


class CrashFollower:
    """Decides about the crashes of one node; the first reload after a healthy life is at once."""

    def __init__(
        self,
        policy: OnCrash,
        limits: RestartLimits,
        jitter: Callable[[], float] = random.random,
    ) -> None:
        """Take policy and limits; ``jitter`` gives random numbers in [0, 1)."""
        self.limit(policy, limits)
        self._jitter = jitter
        self._history = RestartHistory()

    def limit(self, policy: OnCrash, limits: RestartLimits) -> None:
        """Take another policy and limits; what happened so far counts against them."""
        self._policy = policy
        self._limits = replace(limits, first_at_once=True)

    def forget(self) -> None:
        """Somebody asked for a load: what was before that counts no more."""
        self._history = RestartHistory(total=self._history.total)

    def follow_up(self, *, now: float, lived: float) -> FollowUp:
        """Decide about a crash now, after that many seconds of life; see `core.crash`."""
        self._history, verdict = follow_up(
            self._policy,
            self._history,
            self._limits,
            now=now,
            lived=lived,
            jitter=self._jitter(),
        )
        return verdict

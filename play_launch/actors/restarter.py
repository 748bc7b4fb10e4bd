"""The memory that bounded restarting needs."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

from msgspec.structs import replace

from play_launch.core.crash import FollowUp, OnCrash, follow_up
from play_launch.core.restart import GiveUp, Restart, RestartHistory, RestartLimits, decide

if TYPE_CHECKING:
    from collections.abc import Callable


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

    def decide(self, *, now: float, lived: float, counts: bool = True) -> Restart | GiveUp:
        """Decide about a death now, after that many seconds of life; see `core.restart`."""
        self._history, verdict = decide(
            self._history,
            self._limits,
            now=now,
            lived=lived,
            jitter=self._jitter(),
            counts=counts,
        )
        return verdict


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

"""The memory that bounded restarting needs."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

from play_launch.core.restart import GiveUp, Restart, RestartBounds, RestartHistory, decide

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.config.model import RestartLimits


class Restarter:
    """Decides about the deaths of one container, process or node."""

    def __init__(self, limits: RestartLimits, jitter: Callable[[], float] = random.random) -> None:
        """Take the limits; ``jitter`` gives random numbers in [0, 1)."""
        self._bounds = RestartBounds(
            max_restarts=limits.max_restarts,
            within=limits.within,
            initial=limits.initial,
            maximum=limits.maximum,
        )
        self._jitter = jitter
        self._history = RestartHistory()

    @property
    def total(self) -> int:
        """Restarts so far."""
        return self._history.total

    def decide(self, *, now: float, lived: float) -> Restart | GiveUp:
        """Decide about a death now, after that many seconds of life; see `core.restart`."""
        self._history, verdict = decide(
            self._history, self._bounds, now=now, lived=lived, jitter=self._jitter()
        )
        return verdict

"""What is counted while a node crashes again and again, from the events of its supervisor.

Synchronous and without a clock of its own: each call says when it happened, in nanoseconds of the
steady clock that the components use as well.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

MS = 1e6
"""Nanoseconds."""
SECOND = 1e9


@dataclass(slots=True)
class Tally:
    """Counts and times of one trial; times are lists, one entry per crash or restart."""

    crashes: int = 0
    """Deaths of the victim that the supervisor was told."""
    missed: int = 0
    """Deaths of the victim that it was not told, though the container lived on."""
    collateral: int = 0
    """Deaths of neighbours."""
    restarts: int = 0
    """Deaths of the container, and ..."""
    recovered: int = 0
    """... how often all nodes were loaded again after that."""
    undetected: int = 0
    """Restarts that needed us: nothing moved any more, and the supervisor did nothing."""
    doubtful: int = 0
    """Deaths that came with a remark that a thread may have held a lock."""
    leaked: int = 0
    """Dead nodes that could not be cleaned up after."""
    given_up: int = 0
    """Nodes or containers that the supervisor gave up."""
    stopped_hard: int = 0
    """Containers that did not end in order when all was over."""
    event_ms: list[float] = field(default_factory=list)
    """From the crash to its event at the supervisor, by the time that the dying node left."""
    loaded_ms: list[float] = field(default_factory=list)
    """From the crash to the node being loaded again, the container having lived on."""
    gap_ms: list[float] = field(default_factory=list)
    """Longest time between two beats of a neighbour, from one crash to the next."""
    detection_s: list[float] = field(default_factory=list)
    """To the decision that the container is beyond help: from the last crash, or from the last
    beat of a neighbour that had fallen silent before it."""
    recovery_s: list[float] = field(default_factory=list)
    """From the last crash to all nodes being loaded again, in a new container."""
    mechanism: str = ""
    """How the nodes were isolated."""
    reasons: Counter[str] = field(default_factory=Counter)
    """Why containers died and cleaning up failed."""

    _died_at: int = 0
    """0: that death is not measured."""
    _last_death: int = 0
    _is_alive: bool = False
    _coming_back: int = 0
    """Restarts after which not all nodes are loaded yet."""
    _loaded: set[str] = field(default_factory=set)

    @property
    def is_well(self) -> bool:
        """Whether no node is still missing because of a restart."""
        return self._coming_back == 0

    @property
    def survived(self) -> int:
        """Crashes after which the container was not touched."""
        return self.crashes - self.restarts

    def victim_loaded(self, now: int) -> None:
        if self._is_alive:
            self.missed += 1
        if self._died_at and not self._coming_back:
            self.loaded_ms.append((now - self._died_at) / MS)
        self._is_alive = True

    def victim_died(self, now: int, died_at: int, *, counts: bool = True) -> None:
        """`counts`: False for a death that only makes room for the next one."""
        self._is_alive = False
        self._died_at = died_at if counts else 0
        self._last_death = died_at
        if counts:
            self.crashes += 1
            self.event_ms.append((now - died_at) / MS)

    def neighbour_died(self) -> None:
        self.collateral += 1

    def container_condemned(self, now: int, silent_since: int) -> None:
        """The supervisor kills it. `silent_since`: when a neighbour fell silent; 0: none did."""
        began = min(filter(None, (self._last_death, silent_since)), default=0)
        if began:
            self.detection_s.append((now - began) / SECOND)

    def container_died(self, reason: str, *, by_us: bool) -> None:
        self.restarts += 1
        self.reasons[reason] += 1
        self.undetected += by_us
        self._is_alive = False
        self._coming_back += 1
        self._loaded.clear()

    def node_loaded(self, name: str, every_node: set[str], now: int) -> None:
        """Any node, the victim too (after victim_loaded)."""
        if not self._coming_back:
            return
        self._loaded.add(name)
        if self._loaded >= every_node:
            self.recovered += self._coming_back
            self._coming_back = 0
            if self._last_death:
                self.recovery_s.append((now - self._last_death) / SECOND)
            self._died_at = self._last_death = 0

    def neighbours_disturbed(self, longest_gap_ns: int) -> None:
        """Since the last call; 0: nothing is known."""
        if longest_gap_ns and not self._coming_back:
            self.gap_ms.append(longest_gap_ns / MS)

"""Which nodes may be loaded into a container that did not survive an earlier load.

A container loads many nodes at the same time, so when it dies, each node that was being loaded is
a suspect. What may be done with a suspect depends on how many deaths in a row it was there for:

* After the first one its library is loaded in a scratch process, which shows whether the library
  is to blame. If it cannot be loaded there, the node is not loaded; its library is probed again
  when the container starts anew, for it may have been replaced. If it can, the node is loaded as
  usual.
* After the second one the library is not to blame, but the constructor may be. The suspects are
  loaded one at a time, so that the next death has one suspect only.
* A node that was the only one being loaded at its second death, and any node at its third, is not
  loaded any more in this run.

A load that the container survives, whatever became of the node, clears it of all suspicion. So a
node that has nothing to do with the deaths is always loaded in the end.

The first death counts against the restart limits of the container. Those that follow while a
suspect is being loaded do not: they are how the culprit is found, and the stages bound their
number. A node that is suspected anew again and again excuses no more deaths in a run than one
inquiry needs.
"""

from __future__ import annotations

from collections import Counter
from enum import StrEnum, auto
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from play_launch.core.node_key import NodeKey

MOST_DEATHS: Final = 3
"""Deaths of its container after which a node is refused, whoever else was being loaded."""
_DEATHS_ALONE: Final = 2
"""The same for a node that was the only one being loaded, and from then on loaded one at a time."""


class Stage(StrEnum):
    """How far the inquiry about one node is."""

    TRUSTED = auto()
    """It is loaded whenever the container is ready."""
    PROBING = auto()
    """Its library is being loaded, or going to be loaded, in a scratch process."""
    CLEARED = auto()
    """Its library can be loaded; the node waits for its turn."""
    TRIED = auto()
    """It is being loaded."""
    CONDEMNED = auto()
    """Its library cannot be loaded; it is probed again when the container starts anew."""
    REFUSED = auto()
    """It took the container down too often."""


class Suspicion(Struct, frozen=True):
    """What is known about one node."""

    stage: Stage = Stage.TRUSTED
    deaths: int = 0
    """Of its container during its load, since the last load that the container survived."""

    @property
    def wants_to_be_alone(self) -> bool:
        """Whether no other node may be loaded at the same time."""
        return self.deaths >= _DEATHS_ALONE


def blamed(suspicion: Suspicion, *, alone: bool) -> Suspicion:
    """Return what is known after a death during the node's load; ``alone``: no other's."""
    deaths = suspicion.deaths + 1
    refused = deaths >= MOST_DEATHS or (alone and deaths >= _DEATHS_ALONE)
    return Suspicion(Stage.REFUSED if refused else Stage.PROBING, deaths)


class Suspects:
    """The nodes of one container. No I/O, no clock."""

    def __init__(self, nodes: Iterable[NodeKey]) -> None:
        """Trust all of them; where there is a choice, those that come first are taken first."""
        self._known = dict.fromkeys(nodes, Suspicion())
        self._excused: Counter[NodeKey] = Counter()

    def of(self, node: NodeKey) -> Suspicion:
        """Return what is known about a node."""
        return self._known[node]

    def trust(self, node: NodeKey) -> None:
        """Take a node in, or one whose declaration has changed: nothing is known about it."""
        self._known[node] = Suspicion()

    def forget(self, node: NodeKey) -> None:
        """Nobody is going to load this one any more."""
        del self._known[node]
        del self._excused[node]

    def excuse_death(self) -> bool:
        """Return whether a death now does not count as a restart; before `container_died`."""
        tried = [node for node, each in self._known.items() if each.stage is Stage.TRIED]
        excused = any(self._excused[node] < MOST_DEATHS - 1 for node in tried)
        self._excused.update(tried)
        return excused

    def container_died(self, under_way: Collection[NodeKey]) -> tuple[list[NodeKey], list[NodeKey]]:
        """Take the death of a container that was loading these nodes.

        Returns:
            The nodes to be probed, and those that are refused from now on.
        """
        probe, refused = [], []
        for node, before in self._known.items():
            if node in under_way:
                after = blamed(before, alone=len(under_way) == 1)
            elif before.stage is Stage.CONDEMNED:
                after = replace(before, stage=Stage.PROBING)
            elif before.stage is Stage.TRIED:  # its load was over
                after = Suspicion()
            else:
                after = before
            self._known[node] = after
            if after.stage is not before.stage or node in under_way:
                if after.stage is Stage.PROBING:
                    probe.append(node)
                elif after.stage is Stage.REFUSED:
                    refused.append(node)
        return probe, refused

    def probe_ended(self, node: NodeKey, *, loads: bool) -> None:
        """Take the result of the scratch process.

        Without one the library counts as one that loads: the number of deaths is bounded anyway.
        """
        before = self.of(node)
        if before.stage is Stage.PROBING:
            stage = Stage.CLEARED if loads else Stage.CONDEMNED
            self._known[node] = replace(before, stage=stage)

    def probes_cancelled(self) -> None:
        """Take that the scratch processes were stopped; without a result a library loads."""
        for node in [each for each in self._known if self.of(each).stage is Stage.PROBING]:
            self.probe_ended(node, loads=True)

    def survived(self, node: NodeKey) -> None:
        """The load came to an end, in whichever way, and the container lives."""
        self._known[node] = Suspicion()

    def holds(self, node: NodeKey) -> bool:
        """Whether a container that is ready does not get the node yet, or not at all."""
        return self.of(node).stage not in {Stage.TRUSTED, Stage.TRIED}

    def due(self, under_way: Collection[NodeKey]) -> list[NodeKey]:
        """Choose those that are loaded now, beside others; they count as sent."""
        if any(self.of(node).wants_to_be_alone for node in under_way):
            return []
        cleared = [node for node, each in self._known.items() if each.stage is Stage.CLEARED]
        chosen = [node for node in cleared if not self._known[node].wants_to_be_alone]
        if not chosen and not under_way:
            chosen = cleared[:1]
        for node in chosen:
            self._known[node] = replace(self._known[node], stage=Stage.TRIED)
        return chosen

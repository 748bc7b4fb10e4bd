"""What to ask a container that only has ROS's composition services, and what its answers mean.

Such a container (rclcpp's, or anybody's) sends no events. It constructs one node at a time and
answers nothing meanwhile; answers get lost, and what they say need not be so. These rules follow:

* One load at a time; the others wait in a queue that is ours.
* An answer is a claim. ListNodes, asked after it, is what counts: for a success, a failure and a
  missing answer alike. A list that lacks a node is believed only when a second one agrees.
* A load is never sent twice for one attempt. Whether a missing one may be sent under a new attempt
  depends on what kind of container it is: one that constructs in the callback of the service has
  nothing under construction while it answers ListNodes. One that constructs in the background may,
  so there silence stays silence, and the load's turn goes to the next.
* An answer that comes after its attempt was abandoned still counts: its node is taken for the
  attempt that followed, or unloaded (`AbandonedLoads`).

Nodes are matched by full name, where the declaration gives one, and by being new; a unique_id that
belongs to another node already is not believed.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from play_launch.runtime.stock.abandoned_loads import AbandonedLoads
from play_launch.runtime.stock.composition_words import (
    Action,
    AskList,
    Load,
    ReportFailed,
    ReportLoaded,
    ReportRejected,
    ReportUnloaded,
    SendLoad,
    SendUnload,
    Stage,
    Wanted,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

LOOK_AGAIN: Final = 0.5
"""Seconds until a list that was not as expected is asked for once more."""
_ENOUGH: Final = 2
"""That many lists without the node are believed."""


@dataclass(slots=True)
class Composition:
    """The loads of one container process; ``serially`` is whether it constructs in its callback.

    Every method returns what has to be done next, in this order.
    """

    serially: bool = True
    _loads: dict[int, Load] = field(default_factory=dict)
    _queue: deque[Load] = field(default_factory=deque)
    _current: Load | None = None
    _listed: Mapping[int, str] = field(default_factory=dict)
    """The latest list."""
    _latest: int = 0
    _serial: int = 0
    _is_listing: bool = False
    _list_again: float | None = None
    """The delay of the list after the open one; None when none is needed."""
    _abandoned: AbandonedLoads = field(default_factory=AbandonedLoads)
    _rejecting: dict[int, str] = field(default_factory=dict)
    """Nodes that were not unloaded and why; the list is to show whether they are there."""
    is_stopping: bool = False
    """Whether no further loads are sent."""

    def begin(self, nodes: Iterable[tuple[int, str]]) -> None:
        """Take the first list: what is there before anything is loaded."""
        self._listed = dict(nodes)

    @property
    def current(self) -> Load | None:
        """The load that the container is busy with."""
        return self._current

    @property
    def is_asking(self) -> bool:
        """Whether the list is to decide about a silent load."""
        return any(
            load.is_asked_about and load.stage is Stage.SENT for load in self._loads.values()
        )

    def stage(self, attempt: int) -> Stage | None:
        """Where an attempt is; None when it is not, or no longer, known."""
        load = self._loads.get(attempt)
        return None if load is None else load.stage

    def find(self, attempt: int) -> Load | None:
        """Look an attempt up."""
        return self._loads.get(attempt)

    def loaded(self) -> list[Load]:
        """The nodes that are there, in the order of their attempts."""
        return [load for load in self._loads.values() if load.stage is Stage.LOADED]

    def unfinished(self) -> list[Load]:
        """What is being loaded or unloaded, or is there and came by us."""
        return [
            load
            for load in self._loads.values()
            if load.stage is not Stage.QUEUED and not (load.stage is Stage.LOADED and load.adopted)
        ]

    def stop(self) -> None:
        """Send no further loads; what was sent takes its course."""
        self.is_stopping = True
        self._queue.clear()
        if self._current is not None and self._current.stage is Stage.NEXT:
            self._current.stage = Stage.QUEUED
            self._current = None

    def load(self, attempt: int, wanted: Wanted) -> list[Action]:
        """Have a node loaded, or take one that is there already for it."""
        load = Load(attempt, wanted)
        self._loads[attempt] = load
        if late := self._abandoned.find(wanted):
            return self._presume(load, late[0])
        if wanted.full_name and (found := self._adoptable(wanted)):
            load.adopted = True
            return self._presume(load, found[0])
        self._queue.append(load)
        return self._go_on()

    def sent(self, attempt: int) -> None:
        """LoadNode has been sent."""
        load = self._loads.get(attempt)
        if load is not None and load.stage is Stage.NEXT:
            load.stage = Stage.SENT
            load.before = frozenset(self._listed)

    def answered(
        self, attempt: int, *, success: bool, unique_id: int, full_name: str, reason: str
    ) -> list[Action]:
        """LoadNode was answered, at whatever time."""
        load = self._loads.get(attempt)
        if load is None:
            return self._answered_late(attempt, success=success, unique_id=unique_id)
        if load.stage is not Stage.SENT:
            return []
        if load.absent and success:
            # It answered a list while it constructed this.
            self.serially = False
        load.stage = Stage.SAID_LOADED if success else Stage.SAID_FAILED
        load.unique_id, load.full_name, load.reason = unique_id, full_name, reason
        return self._doubt(load)

    def ask_about(self, attempts: Iterable[int]) -> list[Action]:
        """Nothing was heard of these for too long."""
        about = set(attempts)
        silent = [
            load
            for load in self._loads.values()
            if load.attempt in about and load.stage is Stage.SENT and not load.is_asked_about
        ]
        for load in silent:
            load.is_asked_about = True
            load.list_from = self._serial + 1
        return self._list() if silent else []

    def look(self) -> list[Action]:
        """Compare what is known with the list, unasked."""
        return self._list()

    def listed(self, serial: int, nodes: Iterable[tuple[int, str]]) -> list[Action]:
        """ListNodes was answered."""
        ids = dict(nodes)
        actions: list[Action] = []
        if serial >= self._latest:
            self._latest, self._listed = serial, ids
        is_open = self._is_listing and serial != self._serial
        self._is_listing = True  # so that one further list is asked for, whoever needs it
        actions += self._abandoned.listed(serial, ids)
        for load in [each for each in self._loads.values() if serial >= each.list_from]:
            actions += self._compare(load, ids)
        self._is_listing = is_open
        if self._list_again is not None and not is_open:
            actions += self._list(self._list_again)
        return actions + self._go_on()

    def list_unanswered(self, serial: int) -> list[Action]:
        """ListNodes was not answered in time; its answer may still come."""
        if serial != self._serial:
            return []
        self._is_listing, self._list_again = False, None
        for load in self._loads.values():
            if load.stage is Stage.SENT:
                # It is asked about again when its next question is due.
                load.is_asked_about = False
                load.absent = 0
        is_awaited = any(
            load.stage in _CLAIMED or load.unique_id in self._rejecting
            for load in self._loads.values()
        )
        return self._list() if is_awaited else []

    def unload(self, unique_id: int) -> list[Action]:
        """Have a loaded node unloaded."""
        for load in self._loads.values():
            if load.unique_id == unique_id and load.stage in {Stage.LOADED, Stage.UNLOADING}:
                load.stage = Stage.UNLOADING
                return [SendUnload(unique_id)]
        return [ReportRejected(unique_id, "there is no such node")]

    def unload_answered(self, unique_id: int, *, success: bool, reason: str) -> list[Action]:
        """UnloadNode was answered, or nobody answered it: then without success."""
        if self._abandoned.is_leaving(unique_id):
            self._abandoned.unload_answered(unique_id, success=success, list_from=self._serial + 1)
            return []
        self._abandoned.take(unique_id)
        for load in self._loads.values():
            if load.unique_id == unique_id and load.stage is Stage.UNLOADING:
                if success:
                    return [self._is_gone(load, "")]
                self._rejecting[unique_id] = reason
                load.list_from = self._serial + 1
                load.absent = 0
                return self._list()
        return []

    def _go_on(self) -> list[Action]:
        if self.is_stopping or self._current is not None or not self._queue:
            return []
        self._current = load = self._queue.popleft()
        load.stage = Stage.NEXT
        return [SendLoad(load.attempt)]

    def _list(self, delay: float = 0.0) -> list[Action]:
        """Ask for a list that is younger than this moment."""
        if self._is_listing:
            again = self._list_again
            self._list_again = delay if again is None else min(again, delay)
            return []
        self._is_listing, self._list_again = True, None
        self._serial += 1
        return [AskList(self._serial, delay)]

    def _presume(self, load: Load, unique_id: int) -> list[Action]:
        """Take a node that may be there already for this load, if the list agrees."""
        load.stage, load.unique_id, load.is_presumed = Stage.SAID_LOADED, unique_id, True
        return self._doubt(load)

    def _doubt(self, load: Load) -> list[Action]:
        load.absent = 0
        load.list_from = self._serial + 1
        return self._list()

    def _compare(self, load: Load, ids: Mapping[int, str]) -> list[Action]:
        match load.stage:
            case Stage.SENT if load.is_asked_about:
                return self._compare_silent(load, ids)
            case Stage.SAID_LOADED:
                return self._compare_claimed(load, ids)
            case Stage.SAID_FAILED:
                if found := self._matches(load, ids):
                    remark = f"the container said that it failed ({load.reason}), but lists it"
                    return self._is_there(
                        load, found[0], "list_nodes", _several(found, remark, load.wanted)
                    )
                return self._failed(load, load.reason or "the container does not say why")
            case Stage.LOADED:
                if ids.get(load.unique_id) == load.full_name:
                    load.absent = 0
                    return []
                if self._once_more(load):
                    return self._list(LOOK_AGAIN)
                reason = "the container does not list it any more; we did not unload it"
                return [self._is_gone(load, reason)]
            case Stage.UNLOADING if load.unique_id in self._rejecting:
                reason = self._rejecting.pop(load.unique_id)
                if load.unique_id not in ids:
                    return [self._is_gone(load, "")]
                load.stage = Stage.LOADED
                return [ReportRejected(load.unique_id, reason)]
            case _:
                return []

    def _compare_silent(self, load: Load, ids: Mapping[int, str]) -> list[Action]:
        if found := self._matches(load, ids):
            remark = "LoadNode was not answered, but the container lists it"
            return self._is_there(
                load, found[0], "list_nodes", _several(found, remark, load.wanted)
            )
        if self._once_more(load):
            return self._list(LOOK_AGAIN)
        load.is_asked_about = False
        if not self.serially:
            self._leave(load)
            return []
        self._forget(load)
        self._abandoned.abandon(load.attempt, load.wanted)
        return []

    def _compare_claimed(self, load: Load, ids: Mapping[int, str]) -> list[Action]:
        claimed = load.unique_id
        listed_as = ids.get(claimed)
        is_new = not self._belongs(claimed, load)
        if listed_as is not None and is_new:
            is_called_so = load.wanted.is_called(listed_as)
            if load.adopted and is_called_so:
                found = sorted(
                    {claimed, *self._adoptable(load.wanted)}, key=lambda each: each != claimed
                )
                remark = _several(found, "it was there already", load.wanted)
                return self._is_there(load, claimed, "list_nodes", remark)
            if is_called_so or listed_as == load.full_name:
                remark = "" if is_called_so else f"it calls itself {listed_as}"
                return self._is_there(load, claimed, "", remark)
        if found := self._matches(load, ids):
            remark = f"the container said that its unique_id is {claimed}, but lists {found[0]}"
            return self._is_there(
                load, found[0], "list_nodes", _several(found, remark, load.wanted)
            )
        if self._once_more(load):
            return self._list(LOOK_AGAIN)
        self._abandoned.take(claimed)
        if load.is_presumed:
            load.stage, load.unique_id = Stage.QUEUED, 0
            load.adopted = load.is_presumed = False
            self._queue.append(load)
            return []
        return self._failed(load, "the container said that it is loaded, and does not list it")

    def _matches(self, load: Load, ids: Mapping[int, str]) -> list[int]:
        """The listed nodes that may be the one of this load; several only by their name."""
        name = load.full_name
        found = [
            id_
            for id_, listed_as in ids.items()
            if id_ not in load.before
            and not self._belongs(id_, load)
            and (listed_as == name if name else load.wanted.is_called(listed_as))
        ]
        others = any(each is not load and each.stage is Stage.SENT for each in self._loads.values())
        certain = bool(name or load.wanted.full_name)
        if not certain and others:
            return []
        return sorted(found) if certain or len(found) == 1 else []

    def _adoptable(self, wanted: Wanted) -> list[int]:
        return sorted(
            id_
            for id_, name in self._listed.items()
            if wanted.is_called(name)
            and not self._belongs(id_, None)
            and not self._abandoned.is_kept(id_)
        )

    def _belongs(self, unique_id: int, load: Load | None) -> bool:
        """Whether a unique_id is that of another node of ours, or of one that has to go."""
        return self._abandoned.is_leaving(unique_id) or any(
            each is not load
            and each.unique_id == unique_id
            and each.stage in {Stage.LOADED, Stage.UNLOADING}
            for each in self._loads.values()
        )

    def _once_more(self, load: Load) -> bool:
        load.absent += 1
        load.list_from = self._serial + 1
        return load.absent < _ENOUGH

    def _is_there(self, load: Load, unique_id: int, confirmed_by: str, remark: str) -> list[Action]:
        load.stage = Stage.LOADED
        load.unique_id = unique_id
        load.full_name = self._listed.get(unique_id, load.full_name or load.wanted.full_name)
        load.absent = 0
        load.list_from = self._serial + 1
        self._leave(load)
        actions: list[Action] = [
            ReportLoaded(
                load.attempt, unique_id, load.full_name, confirmed_by, remark, load.adopted
            )
        ]
        self._abandoned.take(unique_id)
        return actions + self._abandoned.clear(load.wanted)

    def _failed(self, load: Load, reason: str) -> list[Action]:
        self._forget(load)
        return [ReportFailed(load.attempt, reason), *self._abandoned.clear(load.wanted)]

    def _is_gone(self, load: Load, reason: str) -> ReportUnloaded:
        self._forget(load)
        self._listed = {id_: name for id_, name in self._listed.items() if id_ != load.unique_id}
        return ReportUnloaded(load.attempt, load.unique_id, load.full_name, reason)

    def _forget(self, load: Load) -> None:
        self._loads.pop(load.attempt, None)
        self._leave(load)

    def _leave(self, load: Load) -> None:
        if self._current is load:
            self._current = None

    def _answered_late(self, attempt: int, *, success: bool, unique_id: int) -> list[Action]:
        wanted = self._abandoned.answered(attempt)
        if wanted is None or not success:
            return []
        if self._belongs(unique_id, None):
            return []
        self.serially = False
        self._abandoned.keep(unique_id, wanted)
        for load in self._loads.values():
            if load.wanted == wanted and load.stage in _UNDECIDED:
                if load.stage is not Stage.QUEUED:
                    return []  # what it comes to decides
                self._queue.remove(load)
                return self._presume(load, unique_id)
        return self._abandoned.clear(wanted)


_CLAIMED: Final = frozenset({Stage.SAID_LOADED, Stage.SAID_FAILED})
_UNDECIDED: Final = frozenset({Stage.QUEUED, Stage.NEXT, Stage.SENT, *_CLAIMED})


def _several(found: list[int], remark: str, wanted: Wanted) -> str:
    if len(found) < 2:
        return remark
    others = ", ".join(map(str, found[1:]))
    name = wanted.full_name or "its name"
    return f"{remark}; other nodes are called {name} as well: unique_id {others}"

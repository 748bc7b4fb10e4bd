"""A container for one node, and the wires to it, that a test can play tricks with."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from play_launch.core.node_table import NodeInput
from play_launch.core.questions import NodeStatusState


@dataclass(frozen=True)
class Load:
    attempt: int


@dataclass(frozen=True)
class Query:
    query_id: int
    unique_ids: tuple[int, ...]


@dataclass(frozen=True)
class Unload:
    """Both UNLOAD and CANCEL."""

    unique_id: int


@dataclass(frozen=True)
class Word:
    said: NodeInput
    attempt: int
    unique_id: int


@dataclass(frozen=True)
class Listed:
    unique_id: int
    attempt: int
    state: int


@dataclass(frozen=True)
class Status:
    query_id: int
    listed: tuple[Listed, ...]


@dataclass
class Held:
    """One node that the container constructs or holds."""

    attempt: int
    unique_id: int
    loaded: bool = False
    cancelled: bool = False


@dataclass
class ModelContainer:
    """Tells the truth, in order; what becomes of its words is the wires' business."""

    held: dict[int, Held] = field(default_factory=dict)
    seen: dict[int, int] = field(default_factory=dict)
    answers: list[Word | Status] = field(default_factory=list)
    requests: deque[Load | Query | Unload] = field(default_factory=deque)
    next_id: int = 1

    def take(self, *, reject: bool = False) -> Load | Query | Unload:
        request = self.requests.popleft()
        self.handle(request, reject=reject)
        return request

    def handle(self, request: Load | Query | Unload, *, reject: bool = False) -> None:
        match request:
            case Load(attempt) if attempt in self.seen:
                self._say(NodeInput.ACCEPTED, attempt, self.seen[attempt])
            case Load(attempt) if reject:
                self._say(NodeInput.REJECTED, attempt, 0)
            case Load(attempt):
                unique_id = self.seen[attempt] = self.next_id
                self.next_id += 1
                self.held[unique_id] = Held(attempt, unique_id)
                self._say(NodeInput.ACCEPTED, attempt, unique_id)
                self._say(NodeInput.LOADING, attempt, unique_id)
            case Query(query_id, unique_ids):
                wanted = [
                    h for h in self.held.values() if not unique_ids or h.unique_id in unique_ids
                ]
                self.answers.append(Status(query_id, tuple(_listed(h) for h in wanted)))
            case Unload(unique_id):
                self._unload(unique_id)

    def finish(self, unique_id: int, said: NodeInput) -> None:
        """The constructor returns, fails or crashes; or a loaded node crashes or is unloaded."""
        held = self.held[unique_id]
        if said is NodeInput.LOADED and not held.cancelled:
            held.loaded = True
        else:
            said = NodeInput.UNLOADED if held.cancelled else said
            del self.held[unique_id]
        self._say(said, held.attempt, unique_id)

    def die(self) -> None:
        self.held.clear()
        self.seen.clear()
        self.requests.clear()
        self.next_id = 1

    def _unload(self, unique_id: int) -> None:
        held = self.held.get(unique_id)
        if held is None:
            self._say(NodeInput.UNLOAD_REJECTED, 0, unique_id)
        elif held.loaded:
            self.finish(unique_id, NodeInput.UNLOADED)
        else:
            held.cancelled = True

    def _say(self, said: NodeInput, attempt: int, unique_id: int) -> None:
        self.answers.append(Word(said, attempt, unique_id))


def _listed(held: Held) -> Listed:
    state = NodeStatusState.LOADED if held.loaded else NodeStatusState.CONSTRUCTING
    if held.cancelled:
        state = NodeStatusState.UNLOADING
    return Listed(unique_id=held.unique_id, attempt=held.attempt, state=state)

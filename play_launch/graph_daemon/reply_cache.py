"""Replies that were already written, for as long as the graph did not change."""

from __future__ import annotations

from typing import Final

_OVERHEAD: Final = 256
"""Bytes that an entry costs besides its request and reply, roughly."""


class ReplyCache:
    """Replies by request body, all of one generation of the graph.

    A reply is also dropped by age: should the middleware ever change its graph without saying so,
    an answer is wrong for ``longest`` seconds and not for ever.

    Args:
        capacity: Bytes that it holds at most; when they do not suffice it starts anew.
        longest: Seconds that a reply is used for at most.
    """

    def __init__(self, *, capacity: int = 32 * 1024 * 1024, longest: float = 1.0) -> None:
        self._capacity = capacity
        self._longest = longest
        self._generation = -1
        self._replies: dict[bytes, tuple[float, bytes]] = {}
        self._size = 0

    @property
    def size(self) -> int:
        """Bytes that are held, with an allowance for what Python adds."""
        return self._size

    def get(self, request: bytes, generation: int, now: float) -> bytes | None:
        """Return the reply to ``request`` if it was given in ``generation``, and lately.

        ``now`` is in seconds of any clock that never jumps.
        """
        if generation != self._generation:
            self._restart(generation)
            return None
        entry = self._replies.get(request)
        if entry is None or now - entry[0] > self._longest:
            return None
        return entry[1]

    def put(self, request: bytes, reply: bytes, generation: int, now: float) -> None:
        """Keep a reply.

        ``generation`` and ``now`` are those of before the graph was looked at: what changed
        meanwhile may not be in the reply.
        """
        if generation < self._generation:
            return
        if generation > self._generation:
            self._restart(generation)
        known = self._replies.pop(request, None)
        if known is not None:
            self._size -= _cost(request, known[1])
        cost = _cost(request, reply)
        if cost > self._capacity:
            return
        if self._size + cost > self._capacity:
            self._restart(generation)
        self._replies[request] = (now, reply)
        self._size += cost

    def _restart(self, generation: int) -> None:
        self._replies.clear()
        self._size = 0
        self._generation = generation


def _cost(request: bytes, reply: bytes) -> int:
    return len(request) + len(reply) + _OVERHEAD

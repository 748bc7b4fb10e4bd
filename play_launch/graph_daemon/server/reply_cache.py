"""Replies that were already written, for as long as the graph did not change.

And a little longer where writing them takes long: while sixty processes start, the graph changes
all the time, and a daemon that wrote each answer anew for each client would fall behind. A reply
that took time ``t`` is used for another `HOLD` times ``t`` whatever happens, within `LONGEST_HOLD`,
so that the same question takes a fifth of one processor at most.
"""

from __future__ import annotations

from typing import Final, NamedTuple

HOLD: Final = 4.0
LONGEST_HOLD: Final = 0.25
_OVERHEAD: Final = 256
"""Bytes that an entry takes besides its request and reply, roughly."""


class _Entry(NamedTuple):
    reply: bytes
    generation: int
    asked: float
    held_until: float


class ReplyCache:
    """Replies by request body.

    A reply is also dropped by age: should the middleware ever change its graph without saying so,
    an answer is wrong for ``longest`` seconds and not for ever.

    Args:
        capacity: Bytes that it holds at most; when they do not suffice it starts anew.
        longest: Seconds that a reply is used for at most.
        hold: For how many times the time that it took a reply is used after a change.
        longest_hold: Seconds after which it is not, however long it took.
    """

    def __init__(
        self,
        *,
        capacity: int = 32 * 1024 * 1024,
        longest: float = 1.0,
        hold: float = HOLD,
        longest_hold: float = LONGEST_HOLD,
    ) -> None:
        self._capacity = capacity
        self._longest = longest
        self._hold = hold
        self._longest_hold = longest_hold
        self._entries: dict[bytes, _Entry] = {}
        self._size = 0

    @property
    def size(self) -> int:
        """Bytes that are held, with an allowance for what Python adds."""
        return self._size

    def get(self, request: bytes, generation: int, now: float) -> bytes | None:
        """Return the reply to ``request`` if it is of ``generation``, or still held.

        ``now`` is in seconds of any clock that never jumps.
        """
        entry = self._entries.get(request)
        if entry is None or now - entry.asked > self._longest:
            return None
        if entry.generation != generation and now >= entry.held_until:
            return None
        return entry.reply

    def put(
        self, request: bytes, reply: bytes, generation: int, asked: float, answered: float
    ) -> None:
        """Keep a reply.

        ``generation`` is that of before the graph was looked at: what changed meanwhile may not be
        in the reply. ``asked`` and ``answered`` are the times before and after.
        """
        known = self._entries.pop(request, None)
        if known is not None:
            self._size -= _size_of(request, known.reply)
        size = _size_of(request, reply)
        if size > self._capacity:
            return
        if self._size + size > self._capacity:
            self._entries.clear()
            self._size = 0
        hold = min(self._hold * (answered - asked), self._longest_hold)
        self._entries[request] = _Entry(reply, generation, asked, answered + hold)
        self._size += size


def _size_of(request: bytes, reply: bytes) -> int:
    return len(request) + len(reply) + _OVERHEAD

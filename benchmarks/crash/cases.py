"""What can be tried: how a node dies, where, in which company and in which container."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

MODES = ("isolated", "isolated_mt")
_WAYS = ("segv", "abrt", "exception", "kill")
_PLACES = ("callback", "constructor", "thread", "malloc")


@dataclass(frozen=True, slots=True)
class Kind:
    """A way to die, and where.

    `where`: in a callback, in the constructor, in a thread of the node's own, in a callback while
    other threads of the node allocate (malloc) or another thread of the node publishes over DDS
    all the time (publishing), or by a signal from outside at a random instant, with (dds) or
    without (outside) such a thread.
    The kind none/nowhere does not die at all: what the neighbours notice then is the machine's.
    """

    how: str
    where: str

    @property
    def name(self) -> str:
        return f"{self.how}/{self.where}"

    @property
    def is_kill(self) -> bool:
        """Whether the node has no chance to prepare for its death."""
        return self.how == "kill"

    @property
    def is_sent(self) -> bool:
        """Whether another process sends the signal."""
        return self.where in {"outside", "dds"}

    @property
    def publishes(self) -> bool:
        """Whether a thread of the node is in the middleware nearly always."""
        return self.where in {"publishing", "dds"}

    @property
    def is_crash(self) -> bool:
        return self != QUIET


QUIET = Kind("none", "nowhere")
KINDS = (
    *(Kind(how, where) for where in _PLACES for how in _WAYS),
    Kind("segv", "publishing"),
    Kind("segv", "outside"),
    Kind("kill", "outside"),
    Kind("segv", "dds"),
    Kind("kill", "dds"),
)
_DEADLY = KINDS[-1]


@dataclass(frozen=True, slots=True)
class Case:
    """A trial to be done.

    Attributes:
        mode: Of the container.
        kind: What happens to the node.
        count: Crashes.
        quiesced: False: the node dies with all its threads wherever they are.
    """

    mode: str
    kind: Kind
    count: int
    quiesced: bool = True

    @property
    def name(self) -> str:
        return f"{self.mode} {self.kind.name}{'' if self.quiesced else ', not quiesced'}"


def choose(patterns: Iterable[str]) -> list[Kind]:
    """The kinds whose names match one of the patterns, such as segv/callback or kill/*.

    Raises:
        ValueError: When a pattern matches nothing.
    """
    chosen: set[Kind] = set()
    for pattern in patterns:
        matching = {kind for kind in KINDS if fnmatch.fnmatchcase(kind.name, pattern)}
        if not matching:
            names = ", ".join(kind.name for kind in KINDS)
            raise ValueError(f"{pattern!r} matches none of {names}")
        chosen |= matching
    return [kind for kind in KINDS if kind in chosen]


def plan(
    modes: Sequence[str],
    kinds: Sequence[Kind],
    unquiesced: Sequence[Kind],
    *,
    count: int,
) -> Iterator[Case]:
    """The trials, in the order in which they are done.

    `count` crashes in each; a fifth of that without quiescing, and a tenth where nearly every crash
    costs a container, and thereby seconds.
    """
    few, fewest = max(1, count // 5), max(1, count // 10)
    for mode in modes:
        yield Case(mode, QUIET, count)
        for kind in kinds:
            yield Case(mode, kind, fewest if kind == _DEADLY else count)
        for kind in unquiesced:
            # SIGKILL leaves no time for quiescing in any case.
            if not kind.is_kill:
                yield Case(mode, kind, fewest if kind.publishes else few, quiesced=False)

"""Which members and nodes a person means by names and patterns."""

from __future__ import annotations

from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Final

from play_launch.config.node_key import NodeKey
from play_launch.control.protocol import Code, ControlError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from play_launch.supervisor.view import SystemView

Target = NodeKey | str
"""A composable node, or the full name of a container or ordinary process."""
_MOST_LISTED: Final = 10
_WILD: Final = frozenset("*?[")


def members_of(view: SystemView, processes: Iterable[str]) -> list[Target]:
    """List the containers and ordinary processes, as declared."""
    return list(dict.fromkeys([*view.containers, *processes, *view.processes]))


def nodes_of(view: SystemView) -> list[Target]:
    """List the composable nodes, as declared."""
    return [key for container in view.containers.values() for key in container.nodes]


def chosen(
    wanted: Sequence[str],
    candidates: Sequence[Target],
    others: Sequence[Target] = (),
    hint: str = "",
) -> list[Target]:
    """Find what is meant, in the order of the candidates, each once.

    Args:
        wanted: Full names, names without their namespace where only one has it, or patterns (``*``,
            ``?`` and ``[]`` as in a shell, over the full name). A composable node can also be
            written with its container, ``/container:/node``.
        candidates: What can be meant.
        others: What exists as well, but is not for this operation.
        hint: What to do about one of those.

    Raises:
        ControlError: When one of them means nothing, or several where it is no pattern.
    """
    found: set[Target] = set()
    for word in wanted:
        named = _named(word, candidates)
        meant = named or _matching(word, candidates)
        if not meant:
            if elsewhere := _named(word, others) or _matching(word, others):
                raise ControlError(
                    Code.BAD_ARGUMENTS, f"{full_name(elsewhere[0])} {hint}", name=word
                )
            raise ControlError(
                Code.UNKNOWN_NAME,
                f"nothing is called {word or '(an empty name)'}{_proposal(word, candidates)}",
                name=word,
            )
        if len(named) > 1:
            listed = ", ".join(map(str, named[:_MOST_LISTED]))
            raise ControlError(
                Code.AMBIGUOUS_NAME, f"{word} may be {len(named)} things: {listed}", name=word
            )
        found.update(meant)
    return [each for each in candidates if each in found]


def full_name(target: Target) -> str:
    """The name in the graph; of a node that has none, its label."""
    return target if isinstance(target, str) else target.name


def _named(word: str, candidates: Sequence[Target]) -> list[Target]:
    """Find those that are called so, in full or without what stands before a slash."""
    exact = [each for each in candidates if word in {full_name(each), str(each)}]
    return exact or [each for each in candidates if full_name(each).endswith(f"/{word}")]


def _matching(word: str, candidates: Sequence[Target]) -> list[Target]:
    written = str if ":" in word else full_name
    return [each for each in candidates if fnmatchcase(written(each), word)]


def _proposal(word: str, candidates: Sequence[Target]) -> str:
    if _matching(full := f"*/{word}", candidates) and set(word) & _WILD:
        return f"; patterns are over full names: '{full}'"
    from difflib import get_close_matches  # noqa: PLC0415 - for mistakes only

    names = [full_name(each) for each in candidates]
    if similar := get_close_matches(word, names, 1, 0.5):
        return f"; did you mean {similar[0]}?"
    tails = {name.rpartition("/")[2]: name for name in names}
    if similar := get_close_matches(word.rpartition("/")[2], tails, 1, 0.5):
        return f"; did you mean {tails[similar[0]]}?"
    return "; play-launch ps lists what there is"

"""Command lines in attributes: split at spaces, but not within what a substitution gives."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Final

from play_launch.launch_files.markup.template import Call, parse
from play_launch.launch_files.markup.trouble import Trouble

if TYPE_CHECKING:
    from play_launch.launch_files.markup.context import Context


LONGEST: Final = 128 * 2**10
"""Characters of a command line between two substitutions; Linux takes no longer word."""


def words_of(text: str, context: Context) -> list[str]:
    """Return the words of a command line, as launch splits it.

    Raises:
        Trouble: When quotes are not closed, or it is too long.
    """
    words: list[str] = []
    word: list[str] = []

    def finish() -> None:
        words.append("".join(word))
        word.clear()

    for part in parse(text):
        if isinstance(part, Call):
            word.append(context.carried_out((part,)))
            continue
        tokens = split(part)
        if not tokens:
            # Nothing but spaces: two substitutions are two words.
            finish()
            continue
        if part[0].isspace() and word:
            finish()
        word.append(tokens[0])
        if len(tokens) > 1:
            finish()
            words.extend(tokens[1:-1])
            word.append(tokens[-1])
        if part[-1].isspace():
            finish()
    if word:
        finish()
    return words


def split(text: str) -> list[str]:
    """Return the words of a text as a shell splits it.

    Raises:
        Trouble: When quotes are not closed, or it is too long.
    """
    if len(text) > LONGEST:
        raise Trouble(f"a command line of {len(text)} characters; at most {LONGEST}")
    try:
        return shlex.split(text)
    except ValueError as error:
        raise Trouble(f"{text!r}: {error}") from error

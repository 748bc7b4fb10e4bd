"""A command line as it is being typed: its words, and how a candidate is written into it."""

from __future__ import annotations

from typing import Final, NamedTuple

_SPACE: Final = " \t\n"
_PLAIN: Final = frozenset(
    "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-+=./:@%,"
)
"""What bash takes as it is."""


class Line(NamedTuple):
    """The words before the cursor, and the one at it, which may be empty."""

    words: tuple[str, ...]
    current: str
    quote: str = ""
    """The quotation mark that is open at the cursor."""


def read_line(text: str) -> Line:
    """Split a line up to the cursor as shells do: quotation marks and backslashes."""
    words: list[str] = []
    current = quote = ""
    is_word = is_escaped = False
    for each in text:
        if is_escaped:
            # In double quotes a backslash stands for itself, but before these.
            kept = "\\" if quote and each not in '"\\$`' else ""
            current, is_escaped = current + kept + each, False
        elif each == "\\" and quote != "'":
            is_word = is_escaped = True
        elif each == quote:
            quote = ""
        elif quote:
            current += each
        elif each in "'\"":
            quote, is_word = each, True
        elif each in _SPACE:
            if is_word:
                words.append(current)
            current, is_word = "", False
        else:
            current, is_word = current + each, True
    return Line(tuple(words), current, quote)


def for_bash(candidate: str, line: Line, breaks: str) -> str:
    """Write a candidate as readline puts it in place of what it takes for the current word.

    Args:
        candidate: The whole word.
        line: Where it goes.
        breaks: At which characters readline begins a new word, outside of quotation marks.
    """
    if line.quote:
        return candidate
    begin = 1 + max(line.current.rfind(each) for each in breaks or "\n")
    is_same = candidate.startswith(line.current[:begin])
    rest = candidate[begin:] if is_same else candidate
    return "".join(each if each in _PLAIN else f"\\{each}" for each in rest)

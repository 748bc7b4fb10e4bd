"""Text in the cells of a terminal: foreign text made harmless, and cut to a number of cells."""

from __future__ import annotations

from typing import Final

from rich.cells import cell_len, set_cell_size

from play_launch.cli.show.terminal import printable

LONGEST: Final = 2000
"""Characters of a text that are kept; a line of output may have a million."""
_REPLACEMENT: Final = "\N{REPLACEMENT CHARACTER}"
_SELECTORS: Final = dict.fromkeys((*range(0xFE00, 0xFE10), *range(0xE0100, 0xE01F0)))
"""Variation selectors: terminals disagree about the width of what stands before them."""


def clean(text: str) -> str:
    """Make one line of foreign text, without anything that moves, colours or turns around.

    Sequences of control characters go; a tab or line end becomes a space; what has no shape of its
    own, such as marks for the direction of writing or a half of a surrogate pair, becomes U+FFFD.
    """
    shown = printable(text[:LONGEST], colour=False)
    if not shown.isprintable():
        shown = "".join(map(_one, shown))
    if not shown.isascii():
        shown = shown.translate(_SELECTORS)
    return f"{shown}…" if len(text) > LONGEST else shown


def fit(text: str, cells: int, *, keeps_end: bool = False) -> str:
    """Cut or fill a clean text to exactly so many cells; an ellipsis is where something is missing.

    Args:
        text: What `clean` gave.
        cells: How many.
        keeps_end: Leave out the beginning: of the name of a node, the end says which one it is.
    """
    if cells <= 0:
        return ""
    if cell_len(text) <= cells:
        return set_cell_size(text, cells)
    if not keeps_end:
        return f"{set_cell_size(text, cells - 1)}…"
    start = max(len(text) - cells, 0)
    while cell_len(text[start:]) > cells - 1:
        start += 1
    return set_cell_size(f"…{text[start:]}", cells)


def right(text: str, cells: int) -> str:
    """Put a short text flush right; what does not fit is cut."""
    missing = cells - cell_len(text)
    return f"{' ' * missing}{text}" if missing >= 0 else fit(text, cells)


def wrapped(text: str, cells: int) -> list[str]:
    """Break a clean text into lines of at most so many cells; one at least."""
    if cell_len(text) <= cells:
        return [text]
    lines: list[str] = []
    line, used = "", 0
    for character in text:
        size = cell_len(character)
        if used + size > cells and line:
            lines.append(line)
            line, used = "", 0
        line += character
        used += size
    return [*lines, line]


def _one(character: str) -> str:
    if character.isprintable():
        return character
    return " " if character.isspace() else _REPLACEMENT

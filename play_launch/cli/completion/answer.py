"""``play-launch completion --answer SHELL LINE``: what a shell's script asks at each key."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from play_launch.cli.completion.candidates import candidates, place_of
from play_launch.cli.completion.commands import FILES, FOLDERS, LAUNCH_FILE, program
from play_launch.cli.completion.line import for_bash, read_line
from play_launch.control.sessions import glance

if TYPE_CHECKING:
    from collections.abc import Sequence


def main(arguments: Sequence[str]) -> int:
    """Print ``files``, ``folders``, or ``words`` and a candidate on each line; else nothing.

    ``parts`` in place of ``words`` are words that go on, so that no space follows.

    What is not bash gets the meaning of a candidate as well, after a tab.

    Args:
        arguments: The shell, the line up to the cursor, and for bash what ``COMP_WORDBREAKS`` is.
    """
    shell, text, *rest = arguments
    line = read_line(text)
    place = place_of(line.words[1:], line.current, program())
    if place is None:
        return 0
    if place.value.kind in {FILES, FOLDERS}:
        sys.stdout.write(f"{place.value.kind}\n")
        return 0
    kind = "words"
    if place.value.kind == LAUNCH_FILE:
        from play_launch.cli.completion.launch_files import launch_words  # noqa: PLC0415 - slow

        words = launch_words(place.given, place.typed)
        if words is None:
            sys.stdout.write(f"{FILES}\n")
            return 0
        kind, found = "parts" if words.goes_on else kind, words.candidates
    else:
        found = candidates(place, glance)
    if shell == "bash":
        shown = [for_bash(each.word, line, rest[0] if rest else "") for each in found]
    else:
        shown = [f"{each.word}\t{each.about}" if each.about else each.word for each in found]
    lines = (kind, *(each.replace("\n", " ") for each in shown))
    sys.stdout.write("".join(f"{each}\n" for each in lines if found))
    return 0

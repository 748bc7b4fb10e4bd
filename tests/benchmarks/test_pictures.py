"""What a terminal shows becomes a picture that needs nothing else."""

from __future__ import annotations

import sys
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import pytest
from rich.style import Style

from benchmarks.pictures import drawn, seen, style_of
from tests.support.terminal import on_terminal

COLOURED = "print('\\x1b[1;34mblue\\x1b[0m <plain> \\x1b[38;5;208;7morange\\x1b[0m')"


class Cell(NamedTuple):
    """A cell of the emulator, as far as it has a style."""

    fg: str = "default"
    bg: str = "default"
    bold: bool = False
    italics: bool = False
    reverse: bool = False


@pytest.mark.parametrize(
    ("cell", "expected"),
    [
        (Cell(), ""),
        (Cell(fg="brown", bold=True), "bold yellow"),
        (Cell(fg="brightblack", bg="red"), "bright_black on red"),
        (Cell(fg="ff8700", reverse=True, italics=True), "italic reverse #ff8700"),
    ],
)
def test_the_style_of_a_cell(cell: Any, expected: str) -> None:
    assert style_of(cell) == Style.parse(expected)


def test_a_picture_of_a_terminal() -> None:
    with on_terminal(sys.executable, "-c", COLOURED) as terminal:
        assert terminal.end() == 0
        text = seen(terminal)
    assert text.plain == "blue <plain> orange\n"
    picture = drawn(text, "title & more")
    root = ET.fromstring(picture)
    written = "".join("".join(each.itertext()) for each in root.iter() if "text" in each.tag)
    assert "title & more" in written.replace("\xa0", " ")
    assert "blue" in written
    assert "http" not in picture.replace('xmlns="http://www.w3.org/2000/svg"', "").replace(
        "https://www.textualize.io", ""
    )

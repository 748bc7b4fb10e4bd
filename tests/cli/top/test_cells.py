from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len

from play_launch.cli.top.cells import LONGEST, clean, fit, right, wrapped

TEXTS = st.text(max_size=300) | st.text("ab猫🤖\u0301\u202e\x1b[2J\t\ud83d\ufe0f", max_size=60)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("\x1b[31mred\x1b[0m", "red"),
        ("\x1b]52;c;Zm9v\x07clipboard", "clipboard"),
        ("one\ttwo\nthree", "one two three"),
        ("abc\u202edcba", "abc\N{REPLACEMENT CHARACTER}dcba"),
        ("half \ud83d of a pair", "half \N{REPLACEMENT CHARACTER} of a pair"),
        ("heart \u2764\ufe0f", "heart \u2764"),
        ("猫 grüßt", "猫 grüßt"),
        ("x" * (LONGEST + 1), f"{'x' * LONGEST}…"),
    ],
)
def test_foreign_text_is_one_harmless_line(text: str, shown: str) -> None:
    assert clean(text) == shown


@given(TEXTS)
def test_whatever_is_clean_is_printable_and_can_be_written(text: str) -> None:
    shown = clean(text)
    assert shown.isprintable()
    shown.encode()
    assert clean(shown) == shown


@pytest.mark.parametrize(
    ("text", "cells", "keeps_end", "expected"),
    [
        ("talker", 6, False, "talker"),
        ("talker", 8, False, "talker  "),
        ("talker", 4, False, "tal…"),
        ("talker", 4, True, "…ker"),
        ("猫猫猫", 4, False, "猫 …"),
        ("猫猫猫", 4, True, "…猫 "),
        ("talker", 1, False, "…"),
        ("talker", 0, True, ""),
    ],
)
def test_a_text_is_cut_where_its_use_is_least(
    text: str, cells: int, keeps_end: bool, expected: str
) -> None:
    assert fit(text, cells, keeps_end=keeps_end) == expected


@given(TEXTS.map(clean), st.integers(0, 50), st.booleans())
def test_a_cell_is_exactly_as_wide_as_its_column(text: str, cells: int, keeps_end: bool) -> None:
    assert cell_len(fit(text, cells, keeps_end=keeps_end)) == cells
    assert cell_len(right(text, cells)) == cells


@given(TEXTS.map(clean), st.integers(2, 50))
def test_a_broken_line_loses_nothing(text: str, cells: int) -> None:
    lines = wrapped(text, cells)
    assert "".join(lines) == text
    assert lines
    assert all(cell_len(line) <= cells for line in lines)

"""Foreign text does not disturb a page."""

from __future__ import annotations

import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.postmortem.report.page import shown

DIRECTIONS = {"LRE", "RLE", "RLO", "LRO", "PDF", "LRI", "RLI", "FSI", "PDI"}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("plain", "plain"),
        ("tab\tand\nline", "tab\tand\nline"),
        ("\x1b[31mred\x1b[0m", "red"),
        ("\x1b[2J\x1b[Hcleared", "cleared"),
        ("\x1b]0;title\x07after", "after"),
        ("\x1b]52;c;ZXZpbA==\x1b\\after", "after"),
        ("a\0b", "a\u2400b"),
        ("a\x7fb\x9b31m", "a\u2421b\\x9b31m"),
        ("\u202ereversed\u202c", "\\u202ereversed\\u202c"),
        ("no UTF-8 \udcff", "no UTF-8 \\udcff"),
        ("شهادة", "شهادة"),
        ("</script><b>", "</script><b>"),  # a matter of how it is embedded
    ],
)
def test_what_is_invisible_is_shown_or_left_out(text: str, expected: str) -> None:
    assert shown(text) == expected


@given(st.text())
def test_nothing_is_left_that_commands(text: str) -> None:
    found = shown(text)
    kinds = {unicodedata.category(letter) for letter in found if letter not in "\n\t"}
    assert "Cc" not in kinds
    assert not DIRECTIONS & {unicodedata.bidirectional(letter) for letter in found}
    assert shown(found) == found

"""Words of a line that is being typed, and candidates written into it."""

from __future__ import annotations

import shlex
import subprocess

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.cli.completion.line import Line, for_bash, read_line

BREAKS = " \t\n\"'><=;|&(:@"
NAMES = st.text(st.sampled_from("ab/:=*[] '\"\\$~{}#!"), min_size=1, max_size=8)


@given(st.lists(NAMES, max_size=5), NAMES)
def test_quoted_words_are_what_was_quoted(words: list[str], last: str) -> None:
    line = " ".join(map(shlex.quote, [*words, last]))
    assert read_line(line) == Line(tuple(words), last)
    assert read_line(f"{line} ") == Line((*words, last), "")


@given(st.text(max_size=30))
def test_any_line_has_words(text: str) -> None:
    line = read_line(text)
    assert line.quote in {"", "'", '"'}
    # What is complete for a shell is read as a shell does.
    lexer = shlex.shlex(text, posix=True, punctuation_chars=False)
    lexer.whitespace, lexer.whitespace_split, lexer.commenters = " \t\n", True, ""
    try:
        expected = list(lexer)
    except ValueError:
        return
    if not any(each in text for each in "\\\"'"):
        assert [*line.words, *([line.current] if line.current else [])] == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("ps", Line((), "ps")),
        ("ps ", Line(("ps",), "")),
        ("ps '/a b", Line(("ps",), "/a b", "'")),
        ('ps "/a\\"', Line(("ps",), '/a"', '"')),
        ("ps /a\\ b", Line(("ps",), "/a b")),
        ("ps '' ", Line(("ps", ""), "")),
        ("ps /a'b'c", Line(("ps",), "/abc")),
        ("ps \\", Line(("ps",), "")),
    ],
)
def test_what_is_at_the_cursor(text: str, expected: Line) -> None:
    assert read_line(text) == expected


@given(NAMES, st.integers(0, 8))
def test_bash_reads_what_is_written_for_it(name: str, typed: int) -> None:
    begun = name[:typed]
    written = for_bash(name, Line((), begun), BREAKS)
    kept = begun[: 1 + max(begun.rfind(each) for each in BREAKS)]
    # Readline keeps what stands before the last of its breaks; that is written as it was typed.
    assert name == kept + read_line(written).current


def test_readline_replaces_what_stands_behind_its_last_break() -> None:
    line = read_line("play-launch ps /chat:/ta")
    assert for_bash("/chat:/talker", line, BREAKS) == "/talker"
    assert for_bash("/chat:/talker", line, " \t\n") == "/chat:/talker"
    assert for_bash("/chat:/talker", read_line("play-launch ps '/chat:/ta"), BREAKS) == (
        "/chat:/talker"
    )
    assert for_bash("/sensing/*", read_line("play-launch ps /s"), BREAKS) == "/sensing/\\*"
    # A pattern that was typed is replaced by a name.
    assert for_bash("/chat:/talker", read_line("play-launch ps /c*:/ta"), BREAKS) == (
        "/chat:/talker"
    )


def test_bash_knows_these_breaks() -> None:
    shown = subprocess.run(
        ["bash", "--norc", "-i", "-c", 'printf %s "$COMP_WORDBREAKS"'],
        check=True,
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
    )
    assert set(BREAKS) == set(shown.stdout)

from __future__ import annotations

import io

import pytest

from play_launch.cli.output import duration, printable, wants_colour


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("text", "plain", "coloured"),
    [
        ("grüße\tund", "grüße\tund", "grüße\tund"),
        ("\x1b[31mred\x1b[0m", "red", "\x1b[31mred\x1b[0m\x1b[0m"),
        ("\x1b[31mred", "red", "\x1b[31mred\x1b[0m"),
        ("\x1b[2Jgone\x1b[1A", "gone", "gone"),
        ("\x1b[?25l\x1b[?1049h", "", ""),
        ("\x1b]0;title\x07text", "text", "text"),
        ("\x1b]52;c;Zm9v\x1b\\text", "text", "text"),
        ("\x1bPq#0\x1b\\text", "text", "text"),
        ("over\rwritten\x08\x07", "overwritten", "overwritten"),
        ("\x9b31mc1", "31mc1", "31mc1"),
        ("end\x1b", "end", "end"),
        ("end\x1b[", "end", "end"),
        ("/talker\u202egnp.\u2069", "/talkergnp.", "/talkergnp."),
    ],
)
def test_foreign_text_cannot_disturb_the_terminal(text: str, plain: str, coloured: str) -> None:
    assert printable(text, colour=False) == plain
    assert printable(text, colour=True) == coloured


@pytest.mark.parametrize(
    ("environment", "terminal", "expected"),
    [
        ({}, True, True),
        ({}, False, False),
        ({"NO_COLOR": "1"}, True, False),
        ({"NO_COLOR": ""}, True, True),
        ({"NO_COLOR": "1", "FORCE_COLOR": "1"}, True, False),
        ({"FORCE_COLOR": "1"}, False, True),
        ({"TERM": "dumb"}, True, False),
    ],
)
def test_colours_are_for_terminals_that_want_them(
    environment: dict[str, str],
    terminal: bool,
    expected: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("NO_COLOR", "FORCE_COLOR", "TERM"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert wants_colour(Terminal() if terminal else io.StringIO()) is expected


def test_a_closed_stream_is_no_terminal() -> None:
    stream = io.StringIO()
    stream.close()
    assert not wants_colour(stream)


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [
        (0.0004, "0 ms"),
        (0.9994, "999 ms"),
        (0.9996, "1.0 s"),
        (9.96, "10 s"),
        (59.6, "1 min 0 s"),
        (200, "3 min 20 s"),
        (7500, "2 h 5 min"),
    ],
)
def test_durations_are_for_people(seconds: float, expected: str) -> None:
    assert duration(round(seconds * 1e9)) == expected

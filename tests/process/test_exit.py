"""How an end is told."""

from __future__ import annotations

import signal

import pytest

from play_launch.process.exit import Exit


@pytest.mark.parametrize(
    ("end", "text"),
    [
        (Exit(), "exited with status 0"),
        (Exit(code=3), "exited with status 3"),
        (Exit(signal=11), "exited with signal 11 (SIGSEGV)"),
        (Exit(signal=6, core_dumped=True), "exited with signal 6 (SIGABRT, core dumped)"),
        (
            Exit(signal=signal.SIGRTMIN + 2),
            f"exited with signal {signal.SIGRTMIN + 2} (SIGRTMIN+2)",
        ),
        (Exit.lost(), "ended, with an unknown exit status"),
    ],
)
def test_an_end_is_told_in_words(end: Exit, text: str) -> None:
    assert str(end) == text
    assert repr(end) == f"<Exit: {text}>"


def test_only_status_0_is_ok() -> None:
    assert Exit().ok
    assert not Exit(code=1).ok
    assert not Exit(signal=15).ok
    assert not Exit.lost().ok

from __future__ import annotations

from typing import Any

import pytest

from play_launch.cli.session_model import (
    LeastLevel,
    LogFilter,
    LogLine,
    RowLines,
    line_of,
)
from play_launch.config.node_key import NodeKey
from play_launch.control.event_words import OWN_NAME
from play_launch.control.units import target_of
from tests.cli.top.rows import node, row


def event(
    text: str, kind: str = "output", source: str = "/chat", level: int = 20
) -> dict[str, Any]:
    return {"event": kind, "stamp_ns": 7, "source": source, "text": text, "level": level}


def line(text: str, *, level: int = 20, process: str = "/chat", logger: str = "") -> LogLine:
    return LogLine(0, level, process, logger, text)


@pytest.mark.parametrize(
    ("received", "expected"),
    [
        (event("plain"), LogLine(7, 20, "/chat", "", "plain")),
        (
            event("[ERROR] [17.5] [ns.talker.sub]: it\tis", level=40),
            LogLine(7, 40, "/chat", "ns.talker.sub", "it is"),
        ),
        (event("\x1b[33m[WARN] [1.0] [a]: w\x1b[0m"), LogLine(7, 20, "/chat", "a", "w")),
        (event("b\x1b[2Jad", "log", OWN_NAME, 40), LogLine(7, 40, OWN_NAME, "", "bad")),
    ],
)
def test_lines_are_read_from_events(received: dict[str, Any], expected: LogLine) -> None:
    assert line_of(received) == expected


@pytest.mark.parametrize(
    ("wanted", "texts"),
    [
        (LogFilter(), ["c", "t", "sub", "other", "own", "elsewhere"]),
        (LogFilter(target="/chat"), ["c", "t", "sub", "other"]),
        (LogFilter(target=NodeKey("/chat", "/ns/talker")), ["t", "sub"]),
        (LogFilter(target=NodeKey("/gone", "/ns/talker")), []),
        (LogFilter(level=LeastLevel.WARN), ["sub", "own"]),
        (LogFilter(level=LeastLevel.ERROR, target="/chat"), ["sub"]),
        (LogFilter(level=LeastLevel.FATAL), []),
    ],
)
def test_lines_are_chosen_by_node_and_level(wanted: LogFilter, texts: list[str]) -> None:
    lines = [
        line("c"),
        line("t", logger="ns.talker"),
        line("sub", logger="ns.talker.sub", level=40),
        line("other", logger="ns.talker_2"),
        line("own", process=OWN_NAME, level=30),
        line("elsewhere", process="/else", logger="ns.talker"),
    ]
    assert [each.text for each in lines if wanted.wants(each)] == texts


def test_every_row_has_its_last_line() -> None:
    last = RowLines()
    rows = [row("/chat"), node("/ns/talker", "/chat"), node("/ns", "/chat"), row("/other")]
    last.declare(rows)
    for each in (
        line("first", logger="ns.talker"),
        line("of a logger below", logger="ns.talker.sub"),
        line("of the outer", logger="ns.elsewhere"),
        line("of no node", logger="unknown"),
        line("of another container", logger="ns.talker", process="/else"),
        line("own", process=OWN_NAME),
    ):
        last.add(each)
    assert [last.last.get(target_of(each), "") for each in rows] == [
        "of no node", "of a logger below", "of the outer", "",
    ]  # fmt: skip
    last.declare(rows[:1])
    assert target_of(rows[1]) not in last.last
    assert "/else" not in last.last, "what is not declared is not kept"

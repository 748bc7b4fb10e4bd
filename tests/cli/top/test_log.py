from __future__ import annotations

from typing import Any

import pytest

from play_launch.cli.top.log import (
    OWN_NAME,
    LeastLevel,
    LogFilter,
    LogLine,
    RowLines,
    line_of,
)
from play_launch.cli.top.rows import RowId
from tests.cli.top.rows import node, row


def output(text: str, process: str = "/chat", stream: str = "stdout") -> dict[str, Any]:
    return {"event": "output", "stamp_ns": 7, "process": process, "text": text, "stream": stream}


def line(text: str, *, level: int = 20, process: str = "/chat", logger: str = "") -> LogLine:
    return LogLine(0, level, process, logger, text)


@pytest.mark.parametrize(
    ("event", "expected"),
    [
        (output("plain"), LogLine(7, 20, "/chat", "", "plain")),
        (output("plain", stream="stderr"), LogLine(7, 30, "/chat", "", "plain")),
        (
            output("[ERROR] [17.5] [ns.talker.sub]: it\tis"),
            LogLine(7, 40, "/chat", "ns.talker.sub", "it is"),
        ),
        (output("\x1b[33m[WARN] [1.0] [a]: w\x1b[0m"), LogLine(7, 30, "/chat", "a", "w")),
        (
            {"event": "log", "stamp_ns": 7, "level": 40, "message": "b\x1b[2Jad"},
            LogLine(7, 40, OWN_NAME, "", "bad"),
        ),
    ],
)
def test_lines_are_read_from_events(event: dict[str, Any], expected: LogLine) -> None:
    assert line_of(event) == expected


@pytest.mark.parametrize(
    ("wanted", "texts"),
    [
        (LogFilter(), ["c", "t", "sub", "other", "own", "elsewhere"]),
        (LogFilter(subject=RowId(None, "/chat")), ["c", "t", "sub", "other"]),
        (LogFilter(subject=RowId("/chat", "/ns/talker")), ["t", "sub"]),
        (LogFilter(subject=RowId("/gone", "/ns/talker")), []),
        (LogFilter(level=LeastLevel.WARN), ["sub", "own"]),
        (LogFilter(level=LeastLevel.ERROR, subject=RowId(None, "/chat")), ["sub"]),
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


def test_levels_follow_each_other_in_a_circle() -> None:
    assert [level.next() for level in LeastLevel] == [*list(LeastLevel)[1:], LeastLevel.ALL]


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
    assert [last.of(each.subject) for each in rows] == [
        "of no node", "of a logger below", "of the outer", "",
    ]  # fmt: skip
    last.declare(rows[:1])
    assert last.of(rows[1].subject) == ""
    assert last.of(RowId(None, "/else")) == "", "what is not declared is not kept"

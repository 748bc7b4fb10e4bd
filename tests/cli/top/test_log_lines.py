from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.cli.top.log_lines import (
    MOST_LINES,
    MOST_TEXT,
    OWN_NAME,
    LastLines,
    Level,
    LogBuffer,
    LogFilter,
    LogLine,
    line_of,
    page,
    scrolled,
)
from play_launch.cli.top.rows import Subject
from tests.cli.top.rows import node, row


def output(text: str, process: str = "/chat", stream: str = "stdout") -> dict[str, Any]:
    return {"event": "output", "stamp_ns": 7, "process": process, "text": text, "stream": stream}


def line(text: str, *, level: int = 20, process: str = "/chat", logger: str = "") -> LogLine:
    return LogLine(0, level, process, logger, text)


def filled(*lines: LogLine) -> LogBuffer:
    buffer = LogBuffer()
    for each in lines:
        buffer.append(each)
    return buffer


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
        ({"event": "node", "stamp_ns": 7}, None),
    ],
)
def test_lines_are_read_from_events(event: dict[str, Any], expected: LogLine | None) -> None:
    assert line_of(event) == expected


@pytest.mark.parametrize(
    ("wanted", "texts"),
    [
        (LogFilter(), ["c", "t", "sub", "other", "own", "elsewhere"]),
        (LogFilter(subject=Subject(None, "/chat")), ["c", "t", "sub", "other"]),
        (LogFilter(subject=Subject("/chat", "/ns/talker")), ["t", "sub"]),
        (LogFilter(subject=Subject("/gone", "/ns/talker")), []),
        (LogFilter(level=Level.WARN), ["sub", "own"]),
        (LogFilter(level=Level.ERROR, subject=Subject(None, "/chat")), ["sub"]),
        (LogFilter(level=Level.FATAL), []),
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
    assert [level.next() for level in Level] == [*list(Level)[1:], Level.ALL]


def test_what_gives_way_is_counted() -> None:
    buffer = filled(*(line(str(number)) for number in range(MOST_LINES + 10)))
    assert (len(buffer), buffer.gone, buffer.end) == (MOST_LINES, 10, MOST_LINES + 10)
    numbers = [number for number, _ in buffer.before(buffer.end, LogFilter())]
    assert numbers == list(range(MOST_LINES + 9, 9, -1))


def test_text_is_bounded_as_well_as_lines() -> None:
    buffer = filled(*(line("x" * 2000) for _ in range(1000)))
    assert len(buffer) == MOST_TEXT // 2000
    assert len(buffer) + buffer.gone == 1000


@given(
    st.lists(st.tuples(st.text(max_size=60), st.sampled_from([10, 20, 30, 40])), max_size=30),
    st.sampled_from(Level), st.integers(1, 40), st.integers(0, 12),
)  # fmt: skip
def test_a_page_shows_the_newest_wanted_lines_from_below(
    lines: list[tuple[str, int]], level: Level, width: int, height: int
) -> None:
    kept = [line("".join(filter(str.isprintable, text)), level=level) for text, level in lines]
    buffer = filled(*kept)
    found = page(buffer, LogFilter(level), buffer.end, width, height)
    assert len(found) <= height
    wanted = [each for each in kept if each.level >= level]
    shown = [each for each, _ in found]
    distinct = [each for at, each in enumerate(shown) if at == 0 or shown[at - 1] is not each]
    assert distinct == (wanted[-len(distinct) :] if distinct else [])
    if len(found) < height:
        assert len(distinct) == len(wanted)


@given(st.lists(st.sampled_from([-7, -3, -1, 1, 2, 5]), max_size=30))
def test_scrolling_stays_within_the_wanted_lines(moves: list[int]) -> None:
    buffer = filled(*(line(str(number), level=20 + number % 2 * 20) for number in range(20)))
    wanted = LogFilter(Level.ERROR)
    end, place = None, 0
    for move in moves:
        end = scrolled(buffer, wanted, end, move)
        place = max(0, min(place - move, 9))
        assert (end is None) == (place == 0)
        newest = next(iter(buffer.before(buffer.end if end is None else end, wanted)))
        assert newest[0] == 19 - 2 * place
        assert end is None or buffer.after(end, wanted) == place


def test_scrolling_where_nothing_is_wanted_follows() -> None:
    assert scrolled(filled(line("a")), LogFilter(Level.FATAL), None, -5) is None
    assert scrolled(LogBuffer(), LogFilter(), None, -5) is None


def test_every_row_has_its_last_line() -> None:
    last = LastLines()
    rows = [row("/chat"), node("/ns/talker", "/chat"), node("/ns", "/chat"), row("/other")]
    last.declare(rows)
    for each in (
        line("first", logger="ns.talker"),
        line("of a logger below", logger="ns.talker.sub"),
        line("of the outer", logger="ns.elsewhere"),
        line("of nobody", logger="nobody"),
        line("of another container", logger="ns.talker", process="/else"),
        line("own", process=OWN_NAME),
    ):
        last.see(each)
    assert [last.of(each.subject) for each in rows] == [
        "of nobody", "of a logger below", "of the outer", "",
    ]  # fmt: skip
    last.declare(rows[:1])
    assert last.of(rows[1].subject) == ""
    assert last.of(Subject(None, "/else")) == "", "what is not declared is not kept"

from __future__ import annotations

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.cli.session_model import (
    Order,
    cells_of,
    machine_width,
    matching,
    memory,
    ordered,
    uptime,
)
from play_launch.control.messages import UnitRow
from play_launch.control.units import Health, health, health_counts
from tests.cli.top.rows import NOTHING, node, row


def test_rows_are_read_from_an_answer_whatever_else_is_in_it() -> None:
    known = {"name": "/a", "kind": "process", "state": "running", "cpu_percent": 3}
    answer = [{**NOTHING, **known, "new": [1]}]
    assert msgspec.convert(answer, list[UnitRow], strict=False) == [
        row("/a", kind="process", cpu_percent=3.0)
    ]


@pytest.mark.parametrize("answer", [None, {}, [1], [{"name": "/a"}], [{"name": None}]])
def test_what_is_no_list_of_rows_is_an_error(answer: object) -> None:
    with pytest.raises(ValueError, match=r"Expected|missing"):
        msgspec.convert(answer, list[UnitRow], strict=False)


@pytest.mark.parametrize(
    ("what", "expected"),
    [
        (row("/a", "running"), Health.UP),
        (row("/a", "exited", "process", exit_code=0), Health.INACTIVE),
        (row("/a", "exited", "process", exit_code=3), Health.FAILED),
        (row("/a", "exited", "process", signal=11), Health.FAILED),
        (node("/a", "/c", "crashed"), Health.FAILED),
        (node("/a", "/c", "unloaded"), Health.INACTIVE),
        (node("/a", "/c", "loading"), Health.CHANGING),
        (row("/a", "of a later version"), Health.CHANGING),
    ],
)
def test_a_state_is_judged(what: UnitRow, expected: Health) -> None:
    assert health(what) is expected


@pytest.mark.parametrize(
    ("order", "is_reversed", "names"),
    [
        (Order.DECLARED, False, ["/c", "/b", "/d", "/a"]),
        (Order.DECLARED, True, ["/a", "/d", "/b", "/c"]),
        (Order.NAME, False, ["/a", "/b", "/c", "/d"]),
        (Order.NAME, True, ["/d", "/c", "/b", "/a"]),
        (Order.STATE, False, ["/d", "/b", "/c", "/a"]),
        (Order.CPU, False, ["/a", "/c", "/b", "/d"]),
        (Order.CPU, True, ["/c", "/a", "/b", "/d"]),
        (Order.MEMORY, False, ["/d", "/c", "/b", "/a"]),
        (Order.RESTARTS, False, ["/b", "/c", "/d", "/a"]),
        (Order.UPTIME, False, ["/a", "/c", "/b", "/d"]),
    ],
)
def test_what_is_looked_for_comes_first(order: Order, is_reversed: bool, names: list[str]) -> None:
    rows = [
        row("/c", cpu_percent=1.0, uptime_s=9.0),
        row("/b", "starting", restarts=2),
        row("/d", "gave up", memory_bytes=5),
        row("/a", "stopped", cpu_percent=80.0, uptime_s=1.0),
    ]
    assert [each.name for each in ordered(rows, order, is_reversed=is_reversed)] == names


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("", ["/chat", "/talker", "/sensing/Camera"]),
        ("  ", ["/chat", "/talker", "/sensing/Camera"]),
        ("CAM", ["/sensing/Camera"]),
        ("alk", ["/talker"]),
        ("/sensing/*", ["/sensing/Camera"]),
        ("camera*", []),
        ("/chat:", ["/talker"]),
        ("/chat:*", ["/talker"]),
        ("[", []),
        ("absent", []),
    ],
)
def test_rows_are_chosen_by_name(pattern: str, names: list[str]) -> None:
    rows = [row("/chat"), node("/talker", "/chat"), row("/sensing/Camera", kind="process")]
    assert [each.name for each in matching(rows, pattern)] == names


def test_machines_have_a_column_and_choose_their_rows() -> None:
    rows = [row("/a", machine="h2"), row("/b", machine="a_long_name_of_a_computer"), row("/c")]
    assert machine_width(rows) == 13
    assert [str(cells_of(each, each.name, 16, "", 13)[0]) for each in rows] == [
        "h2",
        "a_long_name_",
        "",
    ]
    assert [each.name for each in matching(rows, "H2")] == ["/a"]
    assert machine_width(rows[2:]) == 0
    assert str(cells_of(rows[2], "/c", 16, "")[0]) == "/c"


def test_a_system_is_summed_up() -> None:
    rows = [row("/a"), row("/b", "stopped"), row("/c", "gave up"), row("/d", "starting")]
    assert health_counts(rows) == "1 of 4 up, 1 failed, 1 changing, 1 inactive"
    assert health_counts([row("/a")]) == "1 of 1 up"
    assert health_counts([]) == "0 of 0 up"


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (None, "-"), (-1.0, "0ms"), (0.9, "900ms"), (59.4, "59s"), (60.0, "1m0s"),
        (3599.0, "59m59s"), (3600.0, "1h0m"), (86399.0, "23h59m"), (86400.0, "1d0h"),
        (8639999.0, "99d23h"),
    ],
)  # fmt: skip
def test_a_time_is_short(seconds: float | None, text: str) -> None:
    assert uptime(seconds) == text


@pytest.mark.parametrize(
    ("count", "text"),
    [
        (None, "-"), (0, "0"), (999, "999"), (1000, "1k"), (15_540_000, "15.5M"),
        (99_960_000, "100M"), (999_600_000, "1G"), (10**12, "1T"),
    ],
)  # fmt: skip
def test_a_size_is_short(count: int | None, text: str) -> None:
    assert memory(count) == text


@given(st.integers(0, 10**15), st.floats(0, 8.6e6))
def test_figures_fit_their_columns(count: int, seconds: float) -> None:
    assert len(memory(count)) <= 5
    assert len(uptime(seconds)) <= 6

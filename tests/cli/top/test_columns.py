from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.cells import cell_len

from play_launch.cli.top.columns import (
    Column,
    cells_of,
    columns_at,
    memory,
    titles,
    uptime,
)
from play_launch.cli.top.rows import Row
from tests.cli.top.rows import node, systems

N, S, P, U, R, C, M, L = Column


@pytest.mark.parametrize(
    ("width", "columns"),
    [
        (200, [N, S, P, U, R, C, M, L]),
        (80, [N, S, P, U, R, C, M, L]),
        (72, [N, S, P, U, R, C, M]),
        (58, [N, S, P, U, C, M]),
        (50, [N, S, P, C, M]),
        (44, [N, S, P, C]),
        (36, [N, S, C]),
        (30, [N, S]),
        (20, [N]),
        (1, [N]),
    ],
)
def test_at_each_width_what_matters_most_is_shown(width: int, columns: list[Column]) -> None:
    assert list(columns_at(width, 20)) == columns


@given(st.integers(0, 400), st.integers(0, 300))
def test_columns_fill_the_width_and_never_come_and_go(width: int, longest: int) -> None:
    columns = columns_at(width, longest)
    assert sum(columns.values()) + len(columns) - 1 == width
    assert all(cells >= 0 for cells in columns.values())
    assert set(columns) <= set(columns_at(width + 1, longest))


def test_names_leave_room_for_the_last_line() -> None:
    assert columns_at(80, 9)[N] == 9
    assert columns_at(80, 200)[L] >= 12
    assert columns_at(80, 200)[N] >= 20


@settings(max_examples=25)
@given(systems(), st.integers(1, 200), st.text(max_size=80), st.booleans())
def test_a_line_is_as_wide_as_the_table(
    rows: list[Row], width: int, last: str, is_tree: bool
) -> None:
    columns = columns_at(width, 30)
    lines = [titles(columns)]
    lines += [
        cells_of(each, columns, last if last.isprintable() else "", is_tree=is_tree)
        for each in rows
    ]
    for line in lines:
        assert [cell_len(cell) for cell in line] == list(columns.values())


def test_a_row_is_laid_out() -> None:
    row = node(
        "/sensing/camera", "/sensing/container", pid=4711, restarts=2, uptime_s=200.0,
        cpu_percent=12.34, memory_bytes=15_500_000,
    )  # fmt: skip
    columns = columns_at(80, 17)
    assert " ".join(cells_of(row, columns, "hello", is_tree=True)) == (
        "  /sensing/camera loaded         4711  3m20s    2  12.3 15.5M hello             "
    )
    assert cells_of(row, columns, "", is_tree=False)[0] == "/sensing/camera  "


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (None, "-"), (-1.0, "0s"), (0.9, "0s"), (59.9, "59s"), (60.0, "1m00s"), (3599.0, "59m59s"),
        (3600.0, "1h00m"), (86399.0, "23h59m"), (86400.0, "1d00h"), (8639999.0, "99d23h"),
        (8640000.0, "100d"), (1e18, "99999d"),
    ],
)  # fmt: skip
def test_a_time_is_short(seconds: float | None, text: str) -> None:
    assert uptime(seconds) == text


@pytest.mark.parametrize(
    ("count", "text"),
    [
        (None, "-"), (0, "0"), (999, "999"), (1000, "1.0k"), (15_540_000, "15.5M"),
        (99_940_000, "99.9M"), (99_960_000, "100M"), (999_600_000, "1.0G"), (10**12, "1.0T"),
        (10**18, "9999T"),
    ],
)  # fmt: skip
def test_a_size_is_short(count: int | None, text: str) -> None:
    assert memory(count) == text


@given(st.integers(0, 10**20), st.floats(0, 1e20))
def test_figures_fit_their_columns(count: int, seconds: float) -> None:
    assert len(memory(count)) <= 5
    assert len(uptime(seconds)) <= 6

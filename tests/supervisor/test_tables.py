"""A table of a life is total and states nothing twice, or it cannot be imported."""

from __future__ import annotations

from enum import StrEnum, auto
from typing import Any

import pytest

from play_launch.supervisor.transitions import Fact, table
from play_launch.supervisor.world import Phase


class Light(StrEnum):
    RED = auto()
    GREEN = auto()


class Signal(StrEnum):
    GO = auto()
    HALT = auto()


WHOLE: tuple[tuple[Any, Any, Light | None], ...] = (
    (Light.RED, Signal.GO, Light.GREEN),
    (Light.GREEN, Signal.GO, None),
    ({Light.RED, Light.GREEN}, Signal.HALT, Light.RED),
)


def test_each_cell_is_as_stated() -> None:
    assert table(Light, Signal, *WHOLE) == {
        Light.RED: {Signal.GO: Light.GREEN, Signal.HALT: Light.RED},
        Light.GREEN: {Signal.GO: None, Signal.HALT: Light.RED},
    }


@pytest.mark.parametrize("row", range(len(WHOLE)))
def test_a_missing_row_raises(row: int) -> None:
    with pytest.raises(ValueError, match="not stated"):
        table(Light, Signal, *WHOLE[:row], *WHOLE[row + 1 :])


@pytest.mark.parametrize("then", [None, Light.RED, Light.GREEN])
def test_a_cell_that_is_stated_twice_raises(then: Light | None) -> None:
    with pytest.raises(ValueError, match="stated twice"):
        table(Light, Signal, *WHOLE, (Light.RED, {Signal.GO}, then))


@pytest.mark.parametrize("cell", [(Light.RED, Fact.START), (Phase.QUEUED, Signal.GO)])
def test_a_state_or_fact_of_something_else_raises(cell: tuple[Any, Any]) -> None:
    with pytest.raises(TypeError, match="no cell of"):
        table(Light, Signal, *WHOLE, (*cell, None))

"""Rows to try things on."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st

from play_launch.cli.top.model import Row
from play_launch.supervisor.events import ContainerState, NodeState

STATES = sorted(
    {state.value for state in (*ContainerState, *NodeState)} | {"exited", "waiting", "unheard of"}
)


def row(name: str, state: str = "running", kind: str = "container", **fields: Any) -> Row:
    return Row(name=name, kind=kind, state=state, **fields)


def node(name: str, container: str, state: str = "loaded", **fields: Any) -> Row:
    return row(name, state, "component", container=container, **fields)


@st.composite
def systems(draw: st.DrawFn) -> list[Row]:
    """Rows as the session gives them: containers, each before its nodes, and processes."""
    found: list[Row] = []
    for number in range(draw(st.integers(0, 2))):
        container = f"/container_{number}"
        found.append(draw(_rows(container, "container", None)))
        found += [
            draw(_rows(f"/n{number}/node_{each}", "component", container))
            for each in range(draw(st.integers(0, 2)))
        ]
    found += [
        draw(_rows(f"/process_{number}", "process", None))
        for number in range(draw(st.integers(0, 2)))
    ]
    return found


def _rows(name: str, kind: str, container: str | None) -> st.SearchStrategy[Row]:
    return st.builds(
        Row,
        name=st.just(name),
        kind=st.just(kind),
        container=st.just(container),
        state=st.sampled_from(STATES),
        pid=st.none() | st.integers(1, 2**22),
        restarts=st.integers(0, 10**6),
        uptime_s=st.none() | st.floats(0, 1e10),
        exit_code=st.none() | st.integers(0, 255),
        signal=st.none() | st.integers(1, 64),
        cpu_percent=st.none() | st.floats(0, 1e5),
        memory_bytes=st.none() | st.integers(0, 10**14),
    )

"""A fixed set of seeds: at least 200,000 inputs, no invariant breaks, and `explain` agrees."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import pytest

from play_launch import ExitCode
from play_launch.postmortem.findings import is_wrong
from play_launch.supervisor.events import (
    ContainerState,
    ProcessEvent,
    ProcessEventKind,
    SubjectKind,
)
from play_launch.supervisor.outcome import Cause
from tests.postmortem.scenes import Scene, story_of

from .machine import Machine, lived
from .search import report, searched, shortened

if TYPE_CHECKING:
    from play_launch.postmortem.timeline import Timeline
    from play_launch.supervisor.view import SystemView

SHARES: Final = 16
SEEDS: Final = 140
"""Of each share."""
INPUTS: Final = 12_500
"""Of each share, at least: 200,000 of all."""
FOUND: Final = (5929, 6401, 6634, 7281, 9927, 11602, 16320, 18112, 20133)
"""Seeds that broke an invariant once."""


@pytest.mark.parametrize("share", range(SHARES))
def test_no_invariant_breaks(share: int) -> None:
    inputs, found = searched(range(share * SEEDS, (share + 1) * SEEDS))
    if found is not None:
        pytest.fail(report(shortened(found)), pytrace=False)
    assert inputs >= INPUTS


@pytest.mark.parametrize("seed", FOUND)
def test_what_broke_once_holds(seed: int) -> None:
    _, found = searched(range(seed, seed + 1))
    assert found is None, found.text


@pytest.mark.parametrize("first", range(0, 200, 25))
def test_the_recording_tells_what_was_shown_and_explains_what_failed(
    first: int, tmp_path: Path
) -> None:
    failed = 0
    for seed in range(first, first + 25):
        machine = lived(Machine(seed))
        path = Scene(events=machine.events).record(tmp_path / f"{seed}.mcap")
        story = story_of(path)
        assert _remembered(story.timeline) == _shown(machine.view), f"seed {seed}"
        causes = {
            each.cause
            for each in machine.events
            if isinstance(each, ProcessEvent)
            and each.kind is ProcessEventKind.EXITED
            and each.name in machine.view.containers
        }
        assert Cause.NONE not in causes, f"seed {seed}: a container never is done"
        kinds = {each.kind for each in story.findings}
        if machine.exit_code == ExitCode.OK:
            assert not kinds & {"not_loaded", "not_started", "left"}, f"seed {seed}"
        containers = machine.before_stop.containers.values()
        is_early = any(each.state is ContainerState.STARTING for each in containers)
        is_missing = machine.exit_code == ExitCode.NODES_MISSING and not is_early
        if machine.exit_code != ExitCode.NODE_FAILED and not is_missing:
            continue
        failed += 1
        assert is_wrong(story.findings), f"seed {seed}"
    assert failed > 5


def _remembered(timeline: Timeline) -> dict[str, tuple[object, ...]]:
    known = (each for each in timeline.units if each.is_known and not each.is_withdrawn)
    # A process that was given up and exits then is shown as given up.
    return {
        each.key: (None if each.kind is SubjectKind.PROCESS else each.state, each.restarts)
        for each in known
    }


def _shown(view: SystemView) -> dict[str, tuple[object, ...]]:
    containers = view.containers.values()
    nodes = (node for each in containers for node in each.nodes.values())
    return (
        {each.name: (each.state, each.process.restarts) for each in containers}
        | {str(each.key): (each.state, each.reloads) for each in nodes}
        | {name: (None, each.restarts) for name, each in view.processes.items()}
    )

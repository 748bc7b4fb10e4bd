"""Phases and lines of status, without any manager."""

from __future__ import annotations

import itertools

from hypothesis import given
from hypothesis import strategies as st

from play_launch.deploy.phase import ANNOUNCED, Phase, following, status
from play_launch.supervisor.events import ContainerState, NodeState, ProcessEventKind
from play_launch.supervisor.view import SystemView
from tests.cli.scenes import container, node, process, view

FACTS = st.fixed_dictionaries(
    {"is_up": st.booleans(), "changes": st.booleans(), "ends": st.booleans()}
)


def announced(seen: list[dict[str, bool]]) -> list[Phase]:
    """The phases that are announced while this is seen, one after the other."""
    phase, found = Phase.STARTING, []
    for facts in seen:
        while (after := following(phase, **facts)) is not phase:
            phase = after
            found.append(phase)
            assert len(found) <= 3 * len(seen), "it does not come to rest"
    return found


@given(st.lists(FACTS, max_size=20))
def test_what_a_manager_hears_makes_sense(seen: list[dict[str, bool]]) -> None:
    # A manager accepts no other order, see sd_notify(3).
    found = announced(seen)
    assert all(phase in ANNOUNCED for phase in found)
    if Phase.STOPPING in found:
        assert found.index(Phase.STOPPING) == len(found) - 1
        assert any(facts["ends"] for facts in seen)
    ready = [each for each in found if each is not Phase.STOPPING]
    for one, other in itertools.pairwise(ready):
        assert {one, other} == {Phase.READY, Phase.RELOADING}
    assert not ready or ready[0] is Phase.READY
    came_up = any(
        facts["is_up"] and not any(each["ends"] and not each["is_up"] for each in seen[:place])
        for place, facts in enumerate(seen)
    )
    assert bool(ready) is came_up


def test_a_system_that_is_over_at_once_was_ready() -> None:
    assert announced([{"is_up": True, "changes": False, "ends": True}]) == [
        Phase.READY,
        Phase.STOPPING,
    ]


SYSTEM = view(
    container("/a"),
    node("/a", 0, NodeState.LOADED),
    node("/a", 1, NodeState.LOADING),
    node("/a", 2, NodeState.LOAD_FAILED),
    container("/b", ContainerState.GAVE_UP),
    node("/b", 0, NodeState.PENDING),
    process("/p", ProcessEventKind.STARTED),
    process("/q", ProcessEventKind.EXITED, exit_code=3),
)


def test_the_status_says_how_it_goes() -> None:
    pending = ["/a:/a/n1", "/c", "/d", "/e", "/f"]
    assert status(Phase.STARTING, SYSTEM, pending) == (
        "starting, pending: /a:/a/n1, /c, /d and 2 more; 1 of 4 nodes loaded, "
        "1 of 2 containers and 1 of 2 processes running; failed: /b, /a/n2, /q"
    )
    assert status(Phase.READY, SystemView(), []) == ""
    assert status(Phase.STOPPING, SystemView(), [], reason="signal 15") == "stopping: signal 15"
    assert status(Phase.READY, view(container("/a")), [], health_problem="/a: x") == (
        "health problem: /a: x; 1 of 1 containers running"
    )


@given(st.sampled_from(Phase), st.lists(st.text()), st.text(), st.text())
def test_a_status_is_one_line(
    phase: Phase, pending: list[str], reason: str, health_problem: str
) -> None:
    text = status(phase, SYSTEM, pending, reason=reason, health_problem=health_problem)
    assert text.isprintable()
    assert len(text) <= 400

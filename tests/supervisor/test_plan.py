"""A plan leads from any system to any other, and touches nothing that is the same in both."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from play_launch.config.load import parse_config
from play_launch.config.model import RestartLimits
from play_launch.supervisor.plan import Need, PlanAction, PlanKind, after, plan

from .configurations import configurations
from .operator import Operated, things

if TYPE_CHECKING:
    from pathlib import Path

    from play_launch.config.model import ReplayConfig
    from play_launch.supervisor.plan import Plan, Step

A_FEW = settings(max_examples=100, deadline=None)


@st.composite
def situations(draw: st.DrawFn) -> tuple[ReplayConfig, set[str], ReplayConfig]:
    """A running system, what is not there of it, and what it is to become."""
    running = draw(configurations())
    names = sorted(name for kind, name in things(running) if kind is not PlanKind.SESSION)
    absent = draw(st.sets(st.sampled_from(names))) if names else set()
    # Often almost the same, so that each difference comes alone, too.
    target = draw(st.one_of(configurations(), st.just(running)))
    return running, absent, target


def made(running: ReplayConfig, absent: set[str], target: ReplayConfig) -> Plan:
    return plan(running, target, dict.fromkeys(absent, "it crashed"))


@A_FEW
@given(situations())
def test_a_plan_leads_to_its_target_from_anywhere(
    situation: tuple[ReplayConfig, set[str], ReplayConfig],
) -> None:
    running, absent, target = situation
    system = Operated(running, absent)
    system.carry_out(made(running, absent, target), target)
    assert system.things == things(target)
    assert not system.absent & {name for _, name in things(target)}


@A_FEW
@given(situations())
def test_what_did_not_change_is_not_touched(
    situation: tuple[ReplayConfig, set[str], ReplayConfig],
) -> None:
    running, absent, target = situation
    before, then = things(running), things(target)
    system = Operated(running, absent)
    system.carry_out(made(running, absent, target), target)

    def may_live_on(kind: PlanKind, name: str) -> bool:
        container = name.partition(":/")[0]
        whole = (
            before.get((PlanKind.CONTAINER, container)),
            then.get((PlanKind.CONTAINER, container)),
        )
        keeps_container = kind is not PlanKind.COMPONENT or (
            container not in absent and _read_at_start(whole[0]) == _read_at_start(whole[1])
        )
        is_same = before.get((kind, name)) == then.get((kind, name))
        return is_same and keeps_container and name not in absent

    untouched = {identity for identity in before if may_live_on(*identity)}
    assert not untouched & system.touched
    assert all(system.lives[identity] == 1 for identity in untouched)


def _read_at_start(container: object) -> object:
    """What a container's process reads; the rest can change while it runs."""
    if not isinstance(container, dict):
        return container
    policy = {"restart", "loading_timeout", "probe_timeout", "output"}
    return {key: value for key, value in container.items() if key not in policy}


@A_FEW
@given(situations())
def test_applied_twice_does_nothing(
    situation: tuple[ReplayConfig, set[str], ReplayConfig],
) -> None:
    running, absent, target = situation
    first = made(running, absent, target)
    then = after(running, target, first.to_do)
    assert plan(then, target).to_do == ()
    assert not plan(target, target).steps


@A_FEW
@given(situations(), st.data())
def test_a_plan_that_was_cut_short_goes_on_where_it_stopped(
    situation: tuple[ReplayConfig, set[str], ReplayConfig], data: st.DataObject
) -> None:
    running, _, target = situation
    first = plan(running, target)
    done = [step for step in first.to_do if data.draw(st.booleans())]
    then = after(running, target, done)
    left = [step.id for step in plan(then, target).to_do]
    assert sorted(left) == sorted(step.id for step in first.to_do if step not in done)
    # And back again: what was done is all that differs from before.
    back = {step.id for step in plan(then, running).to_do}
    assert back == {step.id for step in done}


@A_FEW
@given(situations())
def test_every_step_says_why(situation: tuple[ReplayConfig, set[str], ReplayConfig]) -> None:
    running, absent, target = situation
    for step in made(running, absent, target).steps:
        assert step.action in {PlanAction.ADD, PlanAction.REMOVE} or step.changes or step.reason
        needs = {change.need for change in step.changes}
        assert step.action is PlanAction.KEEP or Need.NEXT_RUN not in needs
        if step.action is PlanAction.SET:
            assert needs <= {Need.SET, Need.NOTHING}
        if step.action is PlanAction.ADOPT:
            assert needs == {Need.NOTHING}


@A_FEW
@given(situations())
def test_each_name_has_one_step(situation: tuple[ReplayConfig, set[str], ReplayConfig]) -> None:
    steps = made(*situation).to_do
    assert len({step.id for step in steps}) == len(steps)


BEFORE = """
version: 1
containers:
  - name: box
    container_type: isolated
    composable_nodes:
      - {package: demo, plugin: "demo::Talker", name: talker, parameters: {rate: 1.0}}
      - {package: demo, plugin: "demo::Listener", name: listener}
  - name: other
    container_type: isolated
    composable_nodes: []
nodes:
  - {command: [run], name: runner, parameters: {speed: 1}}
"""


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("rate: 1.0", "rate: 2.0", {"/box:/talker": PlanAction.SET}),
        ("rate: 1.0", "rate: one", {"/box:/talker": PlanAction.SET}),
        ("rate: 1.0", "rate: 1.0, depth: 2", {"/box:/talker": PlanAction.SET}),
        (", parameters: {rate: 1.0}", "", {"/box:/talker": PlanAction.RELOAD}),
        (
            "name: listener",
            "name: listener, log_level: debug",
            {"/box:/listener": PlanAction.RELOAD},
        ),
        (
            "name: listener",
            "name: listener, on_crash: ignore",
            {"/box:/listener": PlanAction.ADOPT},
        ),
        (
            "name: listener",
            "name: hearer",
            {"/box:/hearer": PlanAction.ADD, "/box:/listener": PlanAction.REMOVE},
        ),
        ("speed: 1", "speed: 2", {"/runner": PlanAction.SET}),
        ("[run]", "[run, --fast]", {"/runner": PlanAction.RESTART}),
        ("name: runner", "name: runner, on_exit: restart", {"/runner": PlanAction.ADOPT}),
        ("name: runner", "name: runner, environment: {A: b}", {"/runner": PlanAction.RESTART}),
        ("version: 1", "version: 1\nrecord: {sync: 2}", {"": PlanAction.KEEP}),
        ("version: 1", "version: 1\nstop: {ask: 9}", {"": PlanAction.ADOPT}),
        ("version: 1", "# a remark\nversion: 1", {}),
        (
            "name: box\n    container_type: isolated",
            "name: box\n    container_type: standard",
            {"/box": PlanAction.RESTART},
        ),
        ("name: box\n", "name: box\n    loading_timeout: 1s\n", {"/box": PlanAction.ADOPT}),
    ],
)
def test_an_edit_and_what_follows(
    tmp_path: Path, old: str, new: str, expected: dict[str, PlanAction]
) -> None:
    assert old in BEFORE
    running, target = read(BEFORE, tmp_path), read(BEFORE.replace(old, new, 1), tmp_path)
    steps = plan(running, target).steps
    assert {step.name: step.action for step in steps if not step.covered} == expected


def test_a_node_that_moves_or_is_renamed_says_where_it_was(tmp_path: Path) -> None:
    line = '      - {package: demo, plugin: "demo::Listener", name: listener}\n'
    moved = BEFORE.replace(line, "").replace("composable_nodes: []", f"composable_nodes:\n{line}")
    found = plan(read(BEFORE, tmp_path), read(moved, tmp_path))
    assert by_name(found)["/other:/listener"].reason == "it was /box:/listener"
    assert by_name(found)["/box:/listener"].reason == "it becomes /other:/listener"
    # It has left before it comes back: two nodes of one name disturb each other.
    assert [step.action for phase in found.phases() for step in phase] == [
        PlanAction.REMOVE,
        PlanAction.ADD,
    ]


def test_what_comes_with_its_container_is_named_and_not_done_twice(tmp_path: Path) -> None:
    target = BEFORE.replace("name: box", "name: crate")
    found = plan(read(BEFORE, tmp_path), read(target, tmp_path))
    assert [step.name for step in found.to_do] == ["/crate", "/box"]
    assert {step.name for step in found.steps if step.covered} == {
        "/crate:/talker",
        "/crate:/listener",
        "/box:/talker",
        "/box:/listener",
    }


def test_what_is_absent_is_brought_up_and_not_asked_to_take_a_parameter(tmp_path: Path) -> None:
    running = read(BEFORE, tmp_path)
    target = read(BEFORE.replace("rate: 1.0", "rate: 2.0"), tmp_path)
    steps = by_name(plan(running, target, {"/box:/talker": "it crashed", "/runner": "exit 1"}))
    assert steps["/box:/talker"].action is PlanAction.LOAD
    assert steps["/box:/talker"].reason == "it crashed"
    assert [change.path for change in steps["/box:/talker"].changes] == ["parameters.rate"]
    assert steps["/runner"].action is PlanAction.START


def test_limits_of_one_member_alone_are_taken_over(tmp_path: Path) -> None:
    running = read(BEFORE, tmp_path)
    box, other = running.containers
    target = replace(
        running, containers=(replace(box, restart=RestartLimits(max_restarts=1)), other)
    )
    (step,) = plan(running, target).steps
    assert (step.name, step.action) == ("/box", PlanAction.ADOPT)
    assert [(each.path, each.before, each.after) for each in step.changes] == [
        ("restart.max_restarts", 5, 1)
    ]


def by_name(found: Plan) -> dict[str, Step]:
    return {step.name: step for step in found.steps}


def read(text: str, folder: Path) -> ReplayConfig:
    return parse_config(text.encode(), folder / "test.yaml")

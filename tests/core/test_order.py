"""Who may start when: never before its conditions hold, and always when they do."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise

from hypothesis import given, settings
from hypothesis import strategies as st

from play_launch.core.dependency import (
    Condition,
    Dependency,
    DependencyGraph,
    Otherwise,
    StartRule,
    strongly_connected,
)
from play_launch.core.order import Look, OrderRecord, Standing, decide, forget, release, want

HOLDS, OPEN = Look(Standing.HOLDS), Look(Standing.OPEN)
FOREVER = math.inf


def on(unit: str, timeout: float = FOREVER, otherwise: Otherwise = Otherwise.FAIL) -> Dependency:
    return Dependency(condition=Condition.STARTED, unit=unit, timeout=timeout, otherwise=otherwise)


def rule(*units: str, delay: float = 0.0) -> StartRule:
    return StartRule(dependencies=tuple(map(on, units)), delay=delay)


class Bench:
    """Units of which some have rules; those that start are up at once."""

    def __init__(self, rules: Mapping[str, StartRule]) -> None:
        self.rules = rules
        self.record = OrderRecord()
        self.looks: dict[str, Look] = {}
        self.now = 0.0
        self.next_at: float | None = None
        self.started: list[str] = []
        self.failed: dict[str, str] = {}
        self.waived: dict[str, str] = {}
        self.missing: Mapping[str, tuple[Dependency, ...]] = {}

    def want(self, *units: str) -> None:
        for unit in units:
            self.record = want(self.record, unit, self.now)

    def look(self, dependency: Dependency) -> Look:
        return self.looks.get(dependency.unit, OPEN)

    def decide(self) -> None:
        decision = decide(self.rules, self.record, self.look, self.now)
        self.record, self.missing, self.next_at = (
            decision.record,
            decision.missing,
            decision.next_at,
        )
        for verdict in decision.verdicts:
            if verdict.fails:
                self.failed[verdict.unit] = verdict.reason
                self.looks[verdict.unit] = Look(Standing.NEVER, "it gave up")
            else:
                self.started.append(verdict.unit)
                self.waived[verdict.unit] = verdict.reason
        if decision.verdicts:
            self.decide()

    def comes(self, *units: str) -> None:
        self.looks |= dict.fromkeys(units, HOLDS)
        self.decide()

    def wait_until(self, when: float) -> None:
        while self.next_at is not None and self.next_at <= when:
            self.now = self.next_at
            self.decide()
        self.now = when


NAMES = [f"/u{number}" for number in range(8)]


@st.composite
def graphs(draw: st.DrawFn) -> dict[str, StartRule]:
    """Acyclic: a unit depends on earlier ones only, in any mixture."""
    return {
        name: StartRule(
            dependencies=tuple(
                on(
                    other,
                    draw(st.sampled_from([FOREVER, 1.0, 5.0])),
                    draw(st.sampled_from(Otherwise)),
                )
                for other in draw(st.lists(st.sampled_from(NAMES[:index]), unique=True, max_size=4))
            )
            if index
            else (),
            delay=draw(st.sampled_from([0.0, 0.5, 3.0])),
        )
        for index, name in enumerate(NAMES)
    }


@settings(deadline=None)
@given(graphs(), st.permutations(NAMES), st.data())
def test_nothing_starts_before_its_conditions_hold(
    rules: dict[str, StartRule], order: list[str], data: st.DataObject
) -> None:
    bench = Bench(rules)
    bench.want(*order)
    bench.decide()
    held_before: set[str] = set()
    for _ in range(12):
        count = len(bench.started)
        if data.draw(st.booleans()) and (up := set(bench.started) - held_before):
            name = data.draw(st.sampled_from(sorted(up)))
            held_before.add(name)
            bench.comes(name)
        else:
            bench.wait_until(bench.now + data.draw(st.sampled_from([0.1, 1.0, 6.0])))
            bench.decide()
        for unit in bench.started[count:]:
            unmet = [each for each in rules[unit].dependencies if bench.look(each) is not HOLDS]
            assert all(each.otherwise is Otherwise.START for each in unmet)
            assert bool(unmet) is bool(bench.waived[unit])


@settings(deadline=None)
@given(graphs(), st.permutations(NAMES))
def test_it_always_goes_on_when_what_starts_comes_up(
    rules: dict[str, StartRule], order: list[str]
) -> None:
    bench = Bench(rules)
    bench.want(*order)
    bench.decide()
    while bench.record.waiting:
        count = len(bench.started)
        bench.comes(*bench.started)
        if bench.record.waiting and len(bench.started) == count:
            assert bench.next_at is not None, "it waits, and nothing is going to happen"
            assert bench.next_at > bench.now
            bench.wait_until(bench.next_at)
    assert not bench.failed, "whoever is waited for came at once, so no time ran out"
    position = {unit: index for index, unit in enumerate(bench.started)}
    assert len(position) == len(NAMES)
    for unit, each in rules.items():
        assert all(position[one.unit] < position[unit] for one in each.dependencies)


@settings(deadline=None)
@given(graphs(), st.sampled_from(NAMES))
def test_nobody_hangs_on_one_that_gave_up(rules: dict[str, StartRule], lost: str) -> None:
    bench = Bench(rules)
    bench.looks[lost] = Look(Standing.NEVER, "it gave up")
    bench.want(*(name for name in NAMES if name != lost))
    bench.decide()
    while bench.record.waiting:
        count = len(bench.started)
        bench.comes(*bench.started)
        if bench.record.waiting and len(bench.started) == count:
            assert bench.next_at is not None, "it hangs"
            bench.wait_until(bench.next_at)
    for unit, reason in bench.failed.items():
        assert "it gave up" in reason
        assert any(bench.look(each).standing is Standing.NEVER for each in rules[unit].dependencies)


def test_what_needs_nothing_starts_at_the_same_moment() -> None:
    bench = Bench({"/a": rule("/x"), "/b": rule("/x"), "/c": rule("/x", "/y")})
    bench.want("/c", "/b", "/a")
    bench.decide()
    assert bench.started == []
    bench.comes("/x")
    assert bench.started == ["/b", "/a"]
    assert [str(each) for each in bench.missing["/c"]] == ["/y to be started"]
    bench.comes("/y")
    assert bench.started == ["/b", "/a", "/c"]


def test_the_delay_begins_when_the_conditions_hold_and_anew_when_they_cease() -> None:
    bench = Bench({"/a": rule("/x", delay=2.0)})
    bench.want("/a")
    bench.decide()
    assert bench.next_at is None
    bench.wait_until(10.0)
    bench.comes("/x")
    assert bench.next_at == 12.0
    assert bench.missing["/a"] == ()
    bench.now = 11.0
    bench.looks["/x"] = OPEN
    bench.decide()
    bench.comes("/x")
    bench.wait_until(12.5)
    assert bench.started == []
    bench.wait_until(13.0)
    assert bench.started == ["/a"]


def test_the_time_begins_when_what_it_is_about_does_not_wait_itself_any_more() -> None:
    rules = {
        "/b": rule("/x"),
        "/c": StartRule(dependencies=(on("/b", timeout=5.0),)),
    }
    bench = Bench(rules)
    bench.want("/b", "/c")
    bench.decide()
    bench.wait_until(100.0)
    bench.decide()
    assert set(bench.record.waiting) == {"/b", "/c"}
    bench.comes("/x")
    assert bench.next_at == 105.0
    bench.wait_until(105.0)
    assert bench.failed == {"/c": "it waited for /b to be started: not within 5 s"}


def test_who_is_started_by_somebody_waits_no_longer_and_who_is_forgotten_waits_anew() -> None:
    bench = Bench({"/a": StartRule(dependencies=(on("/x", timeout=5.0),)), "/b": rule("/a")})
    bench.want("/a", "/b")
    bench.record = release(bench.record, "/b", 1.0)
    bench.record = forget(bench.record, "/a")
    assert not bench.record.waiting
    assert "/b" in bench.record.released
    bench.now = 50.0
    bench.want("/a")
    bench.decide()
    assert bench.next_at == 55.0


@st.composite
def any_graph(draw: st.DrawFn) -> dict[str, tuple[str, ...]]:
    return {
        name: tuple(draw(st.lists(st.sampled_from(NAMES), unique=True, max_size=3)))
        for name in NAMES
    }


def reachable(edges: Mapping[str, tuple[str, ...]], start: str) -> set[str]:
    found: set[str] = set()
    todo = list(edges[start])
    while todo:
        name = todo.pop()
        if name not in found:
            found.add(name)
            todo += edges[name]
    return found


@given(any_graph())
def test_components_are_those_that_reach_each_other(edges: dict[str, tuple[str, ...]]) -> None:
    components = strongly_connected(edges)
    assert sorted(name for component in components for name in component) == NAMES
    reach = {name: reachable(edges, name) | {name} for name in NAMES}
    for component in components:
        for one in component:
            assert component == {other for other in reach[one] if one in reach[other]}


@given(any_graph())
def test_a_cycle_is_found_if_and_only_if_there_is_one(edges: dict[str, tuple[str, ...]]) -> None:
    graph = DependencyGraph(
        {name: rule(*others) for name, others in edges.items()}, dict.fromkeys(NAMES, ())
    )
    cycles = graph.cycles()
    assert bool(cycles) == any(name in reachable(edges, name) for name in NAMES)
    for cycle in cycles:
        assert cycle[0] == cycle[-1]
        assert len(set(cycle)) == len(cycle) - 1
        for unit, other in pairwise(cycle):
            assert other in edges[unit]


@given(any_graph())
def test_dependents_are_stopped_first_and_nobody_waits_for_ever(
    edges: dict[str, tuple[str, ...]],
) -> None:
    graph = DependencyGraph(
        {name: rule(*others) for name, others in edges.items()}, dict.fromkeys(NAMES, ())
    )
    before = graph.stopped_after()
    stopped: set[str] = set()
    while len(stopped) < len(NAMES):
        ready = {name for name in NAMES if name not in stopped and before[name] <= stopped}
        assert ready, "whoever is left waits for another one of them"
        for name in ready:
            for other in edges[name]:
                back = name in reachable(edges, other) or other == name
                assert back or other not in stopped | ready, "it was stopped before its dependent"
        stopped |= ready


def test_nodes_of_two_containers_that_need_each_other_are_stopped_together() -> None:
    members = {"/c": ("/c:/a", "/c:/b"), "/d": ("/d:/a", "/d:/b"), "/e": ()}
    rules = {"/c:/b": rule("/d:/a"), "/d:/b": rule("/c:/a"), "/e": rule("/c")}
    graph = DependencyGraph(rules, members)
    assert graph.cycles() == []
    assert graph.stopped_after() == {
        "/c": frozenset({"/e"}),
        "/d": frozenset({"/e"}),
        "/e": frozenset(),
    }


def test_a_node_cannot_wait_for_all_nodes_of_its_own_container() -> None:
    loaded = Dependency(condition=Condition.LOADED, unit="/c")
    rules = {"/c:/b": StartRule(dependencies=(loaded,))}
    graph = DependencyGraph(rules, {"/c": ("/c:/a", "/c:/b")})
    assert graph.cycles() == [["/c:/b", "/c:/b"]]

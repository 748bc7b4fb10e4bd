"""Nobody takes the container down for ever, and nobody stays away without a reason."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from play_launch.core.restart import Restart, RestartHistory, RestartLimits, decide
from play_launch.core.suspects import MOST_DEATHS, Stage, Suspects

NODES = range(6)


def test_a_suspect_is_probed_and_then_loaded() -> None:
    suspects = Suspects()
    assert suspects.container_died([2, 1]) == ([1, 2], [])
    assert suspects.holds(1)
    assert not suspects.holds(0)
    assert suspects.due([]) == []
    suspects.probe_ended(1, loads=True)
    suspects.probe_ended(2, loads=False)
    assert suspects.due([0]) == [1]
    assert suspects.due([0, 1]) == [], "once"
    suspects.survived(1)
    assert suspects.of(1).deaths == 0
    assert suspects.of(2).stage is Stage.CONDEMNED


def test_what_was_condemned_is_probed_again_for_the_next_container() -> None:
    suspects = Suspects()
    suspects.container_died([1])
    suspects.probe_ended(1, loads=False)
    assert suspects.container_died([]) == ([1], [])
    suspects.probe_ended(1, loads=True)
    assert suspects.due([]) == [1]


def test_the_only_one_is_refused_at_its_second_death() -> None:
    suspects = Suspects()
    suspects.container_died([1])
    suspects.probe_ended(1, loads=True)
    assert suspects.due([]) == [1]
    assert suspects.container_died([1]) == ([], [1])
    assert suspects.holds(1)
    assert suspects.container_died([]) == ([], [])


def test_after_two_deaths_suspects_are_loaded_one_at_a_time() -> None:
    suspects = Suspects()
    for _ in range(2):
        assert suspects.container_died([1, 2]) == ([1, 2], [])
        suspects.probe_ended(1, loads=True)
        suspects.probe_ended(2, loads=True)
        chosen = suspects.due([])
    assert chosen == [1]
    assert suspects.due([1]) == []
    suspects.survived(1)
    assert suspects.due([]) == [2]


def test_one_that_waits_for_its_probe_is_not_blamed_for_another_death() -> None:
    suspects = Suspects()
    suspects.container_died([1])
    assert suspects.container_died([2]) == ([2], [])
    assert suspects.of(1).deaths == 1


@given(
    libraries=st.sets(st.sampled_from(NODES)),
    constructors=st.sets(st.sampled_from(NODES)),
    choices=st.data(),
)
def test_every_innocent_node_is_loaded_and_the_deaths_are_bounded(
    libraries: set[int], constructors: set[int], choices: st.DataObject
) -> None:
    """A container of which any node that is being loaded may bring the end first."""
    suspects = Suspects()
    history = RestartHistory()
    once = RestartLimits(max_restarts=1, within=60.0, initial=0.1, maximum=1.0)
    deaths = 0
    loaded: set[int] = set()
    probing: list[int] = []
    under_way: list[int] = []
    deadly = libraries | constructors
    while True:  # one container process
        under_way = [index for index in NODES if not suspects.holds(index)]
        died = False
        while not died:
            for index in probing:
                suspects.probe_ended(index, loads=index not in libraries)
            probing = []
            under_way += suspects.due(under_way)
            if not under_way:
                break
            index = choices.draw(st.sampled_from(under_way))
            if index in deadly:
                died = True
            else:
                under_way.remove(index)
                loaded.add(index)
                suspects.survived(index)
        if not died:
            break
        loaded.clear()
        deaths += 1
        counts = not suspects.excuse_death()
        history, verdict = decide(history, once, now=0.0, lived=0.0, jitter=0.0, counts=counts)
        assert isinstance(verdict, Restart), "one restart is enough, whoever is to blame"
        probing, _ = suspects.container_died(under_way)
    assert loaded == set(NODES) - deadly
    assert deaths <= MOST_DEATHS * len(deadly)
    if not constructors:
        assert deaths <= 1, "libraries are found out at once"
    for index in deadly:
        expected = Stage.CONDEMNED if index in libraries else Stage.REFUSED
        assert suspects.of(index).stage is expected


def test_the_first_death_counts_and_the_next_one_does_not() -> None:
    suspects = Suspects()
    assert not suspects.excuse_death()
    suspects.container_died([1, 2])
    assert not suspects.excuse_death(), "nobody is being loaded"
    suspects.probe_ended(1, loads=True)
    assert suspects.due([]) == [1]
    assert suspects.excuse_death()


SETS = st.integers(0, 2 ** len(NODES) - 1).map(lambda bits: {i for i in NODES if bits >> i & 1})


@given(st.lists(st.tuples(SETS, SETS, SETS, SETS), max_size=40))
def test_a_run_excuses_a_bounded_number_of_deaths(
    lives: list[tuple[set[int], set[int], set[int], set[int]]],
) -> None:
    """Whoever is loaded when, and whichever loads the container survives."""
    suspects = Suspects()
    excused = 0
    for wanted, probed, good, survivors in lives:
        under_way = [index for index in wanted if not suspects.holds(index)]
        for index in probed:
            suspects.probe_ended(index, loads=index in good)
        under_way += suspects.due(under_way)
        for index in survivors.intersection(under_way):
            under_way.remove(index)
            suspects.survived(index)
        excused += suspects.excuse_death()
        suspects.container_died(under_way)
    assert excused <= (MOST_DEATHS - 1) * len(NODES)

"""Nobody takes the container down for ever, and nobody stays away without a reason."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from play_launch.core.node_key import NodeKey
from play_launch.core.restart import Restart, RestartHistory, RestartLimits, decide
from play_launch.core.suspects import MOST_DEATHS, Stage, Suspects

NODES = tuple(NodeKey("/c", f"/n{number}") for number in range(6))
ZERO, ONE, TWO, *_ = NODES


def test_a_suspect_is_probed_and_then_loaded() -> None:
    suspects = Suspects(NODES)
    assert suspects.container_died([TWO, ONE]) == ([ONE, TWO], [])
    assert suspects.holds(ONE)
    assert not suspects.holds(ZERO)
    assert suspects.due([]) == []
    suspects.probe_ended(ONE, loads=True)
    suspects.probe_ended(TWO, loads=False)
    assert suspects.due([ZERO]) == [ONE]
    assert suspects.due([ZERO, ONE]) == [], "once"
    suspects.survived(ONE)
    assert suspects.of(ONE).deaths == 0
    assert suspects.of(TWO).stage is Stage.CONDEMNED


def test_what_was_condemned_is_probed_again_for_the_next_container() -> None:
    suspects = Suspects(NODES)
    suspects.container_died([ONE])
    suspects.probe_ended(ONE, loads=False)
    assert suspects.container_died([]) == ([ONE], [])
    suspects.probe_ended(ONE, loads=True)
    assert suspects.due([]) == [ONE]


def test_the_only_one_is_refused_at_its_second_death() -> None:
    suspects = Suspects(NODES)
    suspects.container_died([ONE])
    suspects.probe_ended(ONE, loads=True)
    assert suspects.due([]) == [ONE]
    assert suspects.container_died([ONE]) == ([], [ONE])
    assert suspects.holds(ONE)
    assert suspects.container_died([]) == ([], [])


def test_after_two_deaths_suspects_are_loaded_one_at_a_time() -> None:
    suspects = Suspects(NODES)
    for _ in range(2):
        assert suspects.container_died([ONE, TWO]) == ([ONE, TWO], [])
        suspects.probe_ended(ONE, loads=True)
        suspects.probe_ended(TWO, loads=True)
        chosen = suspects.due([])
    assert chosen == [ONE]
    assert suspects.due([ONE]) == []
    suspects.survived(ONE)
    assert suspects.due([]) == [TWO]


def test_one_that_waits_for_its_probe_is_not_blamed_for_another_death() -> None:
    suspects = Suspects(NODES)
    suspects.container_died([ONE])
    assert suspects.container_died([TWO]) == ([TWO], [])
    assert suspects.of(ONE).deaths == 1


@given(
    libraries=st.sets(st.sampled_from(NODES)),
    constructors=st.sets(st.sampled_from(NODES)),
    choices=st.data(),
)
def test_every_innocent_node_is_loaded_and_the_deaths_are_bounded(
    libraries: set[NodeKey], constructors: set[NodeKey], choices: st.DataObject
) -> None:
    """A container of which any node that is being loaded may bring the end first."""
    suspects = Suspects(NODES)
    history = RestartHistory()
    once = RestartLimits(max_restarts=1, within=60.0, initial=0.1, maximum=1.0)
    deaths = 0
    loaded: set[NodeKey] = set()
    probing: list[NodeKey] = []
    under_way: list[NodeKey] = []
    deadly = libraries | constructors
    while True:  # one container process
        under_way = [node for node in NODES if not suspects.holds(node)]
        died = False
        while not died:
            for node in probing:
                suspects.probe_ended(node, loads=node not in libraries)
            probing = []
            under_way += suspects.due(under_way)
            if not under_way:
                break
            node = choices.draw(st.sampled_from(under_way))
            if node in deadly:
                died = True
            else:
                under_way.remove(node)
                loaded.add(node)
                suspects.survived(node)
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
    for node in deadly:
        expected = Stage.CONDEMNED if node in libraries else Stage.REFUSED
        assert suspects.of(node).stage is expected


def test_the_first_death_counts_and_the_next_one_does_not() -> None:
    suspects = Suspects(NODES)
    assert not suspects.excuse_death()
    suspects.container_died([ONE, TWO])
    assert not suspects.excuse_death(), "nobody is being loaded"
    suspects.probe_ended(ONE, loads=True)
    assert suspects.due([]) == [ONE]
    assert suspects.excuse_death()


SETS = st.integers(0, 2 ** len(NODES) - 1).map(
    lambda bits: {node for number, node in enumerate(NODES) if bits >> number & 1}
)


@given(st.lists(st.tuples(SETS, SETS, SETS, SETS), max_size=40))
def test_a_run_excuses_a_bounded_number_of_deaths(
    lives: list[tuple[set[NodeKey], set[NodeKey], set[NodeKey], set[NodeKey]]],
) -> None:
    """Whoever is loaded when, and whichever loads the container survives."""
    suspects = Suspects(NODES)
    excused = 0
    for wanted, probed, good, survivors in lives:
        under_way = [node for node in wanted if not suspects.holds(node)]
        for node in probed:
            suspects.probe_ended(node, loads=node in good)
        under_way += suspects.due(under_way)
        for node in survivors.intersection(under_way):
            under_way.remove(node)
            suspects.survived(node)
        excused += suspects.excuse_death()
        suspects.container_died(under_way)
    assert excused <= (MOST_DEATHS - 1) * len(NODES)

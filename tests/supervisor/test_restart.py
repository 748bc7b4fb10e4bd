from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from play_launch.config.model import OnExit, RestartLimits
from play_launch.supervisor import inputs
from play_launch.supervisor.outcome import RestartHistory, decide
from play_launch.supervisor.reducer import reduce
from play_launch.supervisor.world import Exit, Phase, World
from tests.runtime import fakes

BOUNDS = st.builds(
    RestartLimits,
    max_restarts=st.integers(0, 6),
    within=st.floats(0.1, 100),
    initial=st.floats(0.001, 2),
    maximum=st.floats(0.001, 60),
    first_at_once=st.booleans(),
)
JITTER = st.floats(0, 1, exclude_max=True)


@given(BOUNDS, st.lists(st.tuples(st.floats(0, 0.6), JITTER), max_size=60))
def test_no_window_holds_more_restarts_than_allowed(
    bounds: RestartLimits, lives: list[tuple[float, float]]
) -> None:
    history, now, restarts = RestartHistory(), 0.0, []
    for part, jitter in lives:
        lived = part * bounds.within
        now += lived
        history, verdict = decide(history, bounds, now=now, lived=lived, jitter=jitter)
        if isinstance(verdict, str):
            break
        assert 0 <= verdict <= bounds.maximum
        now += verdict
        restarts.append(now)
        recent = [due for due in restarts if now - due < bounds.within]
        assert len(recent) <= bounds.max_restarts
    assert history.total == len(restarts)


@given(BOUNDS, st.lists(st.tuples(st.floats(0, 100), st.booleans()), max_size=40))
def test_what_does_not_count_always_restarts_and_uses_nothing_up(
    bounds: RestartLimits, deaths: list[tuple[float, bool]]
) -> None:
    """A history with uncounted deaths decides about the counted ones as one without them."""
    everything, counted = RestartHistory(), RestartHistory()
    now = 0.0
    for lived, counts in deaths:
        now += lived
        everything, verdict = decide(
            everything, bounds, now=now, lived=0.0, jitter=0.0, counts=counts
        )
        if counts:
            # The same pauses, so that only the counting is compared.
            like = replace(counted, streak=everything.streak - isinstance(verdict, float))
            counted, expected = decide(like, bounds, now=now, lived=0.0, jitter=0.0)
            assert verdict == expected
        else:
            assert isinstance(verdict, float) == (bounds.max_restarts > 0)


def test_the_first_restart_can_be_at_once() -> None:
    bounds = RestartLimits(
        max_restarts=100, within=60.0, initial=0.1, maximum=0.3, first_at_once=True
    )
    history, delays = RestartHistory(), []
    for lived in (0.0, 0.0, 0.0, 0.0, 0.0, 60.0, 0.0):
        history, verdict = decide(history, bounds, now=0.0, lived=lived, jitter=0.0)
        assert isinstance(verdict, float)
        delays.append(round(verdict, 3))
    assert delays == [0.0, 0.05, 0.1, 0.15, 0.15, 0.0, 0.05]


def test_giving_up_says_why() -> None:
    never = RestartLimits(max_restarts=0, within=60.0, initial=0.1, maximum=1.0)
    _, verdict = decide(RestartHistory(), never, now=0.0, lived=5.0, jitter=0.0)
    assert verdict == "restarting is switched off"


def test_a_start_while_a_process_waits_for_its_turn_counts_restarts_anew() -> None:
    limits = RestartLimits(max_restarts=1, initial=0.0, maximum=0.0)
    config = fakes.process("p", on_exit=OnExit.RESTART)
    world = World(fakes.system(replace(config, restart=limits)))
    crash = Exit("exited with signal 11", signal=11)

    def post(*said: inputs.Input) -> None:
        for each in said:
            reduce(world, each, 1.0, 0.0)

    def phase() -> Phase:
        return world.processes["/p"].phase

    def start() -> None:
        number = world.processes["/p"].attempt
        post(
            inputs.Started(unit="/p", start=number, pid=1, start_time=1),
            inputs.Exited(unit="/p", start=number, exit=crash),
        )

    post(inputs.Time())
    start()
    post(inputs.Time())
    assert phase() is Phase.QUEUED, "what is left of the first is awaited"
    post(inputs.StartRequested(unit="/p"), inputs.CleanedUp(unit="/p", start=1))
    start()
    assert phase() is not Phase.GAVE_UP

"""What follows from the end of a member's process."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from play_launch.actors.death import Death
from play_launch.actors.restarter import Restarter
from play_launch.core.member import DEATHS, MemberInput
from play_launch.core.restart import RestartLimits

deaths = st.builds(
    Death,
    reason=st.text(max_size=9),
    permanent=st.booleans(),
    by_itself=st.booleans(),
    lived=st.floats(0, 1e6),
)


@given(st.lists(st.tuples(deaths, st.booleans(), st.booleans()), max_size=20), st.integers(0, 3))
def test_a_death_has_one_sequel_and_a_restart_is_used_up_by_those_that_count(
    lives: list[tuple[Death, bool, bool]], most: int
) -> None:
    restarter = Restarter(RestartLimits(max_restarts=most), jitter=lambda: 0.5)
    used = 0
    for death, is_over, counts in lives:
        asked: list[bool] = []

        def answer(counts: bool = counts, asked: list[bool] = asked) -> bool:
            asked.append(counts)
            return counts

        sequel = restarter.follow_up(death, now=1.0, is_over=is_over, counts=answer)
        assert sequel.said in DEATHS
        assert sequel.reason.startswith(death.reason)
        assert (sequel.delay is not None) == (sequel.said is MemberInput.DIED_RESTART)
        may_restart = not (is_over or death.permanent or death.by_itself)
        assert asked == [counts] * may_restart, "nobody is excused who is not started again"
        if is_over or death.permanent:
            assert sequel.said is MemberInput.DIED_FOR_GOOD
        elif death.by_itself:
            assert sequel.said is MemberInput.ENDED
        used += counts and sequel.said is MemberInput.DIED_RESTART
        assert used <= most

"""What goes when only so much is to be kept."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from play_launch.config.model import KeepConfig
from play_launch.postmortem.archive import SessionEntry, sessions_to_remove

SESSIONS = st.lists(
    st.builds(
        SessionEntry,
        name=st.text("0123456789-", min_size=1),
        size=st.integers(0, 1000),
        is_running=st.booleans(),
        is_pinned=st.booleans(),
    ),
    unique_by=lambda session: session.name,
    max_size=12,
)
LIMITS = st.builds(
    KeepConfig,
    sessions=st.none() | st.integers(1, 12),
    size=st.none() | st.integers(1, 5000),
)


def fits(sessions: list[SessionEntry], keep: KeepConfig) -> bool:
    counted = [one for one in sessions if not one.is_pinned]
    return (keep.sessions is None or len(counted) <= keep.sessions) and (
        keep.size is None or sum(one.size for one in counted) <= keep.size
    )


@given(SESSIONS, LIMITS)
def test_what_stays_fits_or_cannot_go(sessions: list[SessionEntry], keep: KeepConfig) -> None:
    removed = sessions_to_remove(sessions, keep)
    stays = [one for one in sessions if one not in removed]
    assert not any(one.is_running or one.is_pinned for one in removed)
    assert fits(stays, keep) or all(one.is_running or one.is_pinned for one in stays)


@given(SESSIONS, LIMITS)
def test_no_more_goes_than_has_to(sessions: list[SessionEntry], keep: KeepConfig) -> None:
    removed = sessions_to_remove(sessions, keep)
    for last in removed[-1:]:
        stays = [one for one in sessions if one not in removed] + [last]
        assert not fits(stays, keep)


@given(SESSIONS, LIMITS)
def test_the_oldest_go_first(sessions: list[SessionEntry], keep: KeepConfig) -> None:
    removed = sessions_to_remove(sessions, keep)
    could_go = [one for one in sessions if not one.is_running and not one.is_pinned]
    assert list(removed) == could_go[: len(removed)]


@given(SESSIONS)
def test_without_limits_nothing_goes(sessions: list[SessionEntry]) -> None:
    assert sessions_to_remove(sessions, KeepConfig()) == ()


@given(SESSIONS, LIMITS)
def test_a_second_time_nothing_goes(sessions: list[SessionEntry], keep: KeepConfig) -> None:
    removed = sessions_to_remove(sessions, keep)
    assert sessions_to_remove([one for one in sessions if one not in removed], keep) == ()

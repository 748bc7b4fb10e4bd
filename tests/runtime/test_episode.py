"""A burst is told when it begins and when it is over, and no more often."""

from __future__ import annotations

from play_launch.runtime.watch import Burst


def told(counts: list[int], *, quiet: float = 3.0) -> list[tuple[int, int]]:
    """When, at one look a second, something is told, and which number then."""
    episode = Burst(quiet=quiet)
    return [(now, episode.count) for now, count in enumerate(counts) if episode.see(count, now)]


def test_nothing_is_told_of_nothing() -> None:
    assert told([0] * 10) == []


def test_a_single_growth_is_told_once() -> None:
    assert told([0, 1, *[1] * 20]) == [(1, 1)]


def test_a_burst_is_told_at_its_beginning_and_with_its_sum() -> None:
    assert told([0, 2, 3, 5, 5, 9, *[9] * 20]) == [(1, 2), (8, 9)]


def test_the_next_burst_is_told_again() -> None:
    assert told([1, 1, 1, 1, 1, 4, *[4] * 10]) == [(0, 1), (5, 4)]


def test_while_it_goes_on_it_is_not_over() -> None:
    assert told(list(range(1, 100))) == [(0, 1)]

"""What a trial counts, from a scripted supervisor."""

from __future__ import annotations

from benchmarks.crash.tally import Tally

MS, SECOND = 1_000_000, 1_000_000_000
EVERYBODY = {"/victim", "/left", "/right"}


def load(tally: Tally, now: int, *names: str) -> None:
    for name in names:
        if name == "/victim":
            tally.victim_loaded(now)
        tally.node_loaded(name, EVERYBODY, now)


def test_a_crash_that_is_survived() -> None:
    tally = Tally()
    load(tally, 0, *EVERYBODY)
    tally.victim_died(12 * MS, 10 * MS)
    load(tally, 17 * MS, "/victim")
    assert (tally.crashes, tally.survived, tally.restarts, tally.missed) == (1, 1, 0, 0)
    assert (tally.event_ms, tally.loaded_ms) == ([2.0], [7.0])


def test_a_death_that_makes_room_for_the_next_one_does_not_count() -> None:
    tally = Tally()
    load(tally, 0, *EVERYBODY)
    tally.victim_died(12 * MS, 10 * MS, counts=False)
    load(tally, 17 * MS, "/victim")
    assert tally.crashes == 0
    assert tally.event_ms == tally.loaded_ms == []


def test_a_death_that_nobody_told() -> None:
    tally = Tally()
    load(tally, 0, *EVERYBODY)
    load(tally, 17 * MS, "/victim")
    assert tally.missed == 1


def test_a_poisoned_container() -> None:
    tally = Tally()
    load(tally, 0, *EVERYBODY)
    tally.victim_died(11 * SECOND, 10 * SECOND)
    tally.container_condemned(14 * SECOND, 0)
    tally.container_died("frozen", by_us=False)
    tally.neighbours_disturbed(3 * SECOND)  # not while it is being started again
    load(tally, 15 * SECOND, "/left", "/victim")
    assert tally.recovered == 0
    load(tally, 16 * SECOND, "/right")
    assert (tally.crashes, tally.survived, tally.restarts, tally.recovered) == (1, 0, 1, 1)
    assert (tally.undetected, tally.missed) == (0, 0)
    assert (tally.detection_s, tally.recovery_s) == ([4.0], [6.0])
    assert tally.loaded_ms == tally.gap_ms == []
    assert tally.reasons == {"frozen": 1}

    tally.victim_died(21 * SECOND, 20 * SECOND)
    tally.neighbours_disturbed(3 * MS)
    load(tally, 22 * SECOND, "/victim")
    assert tally.loaded_ms == [2000.0]
    assert tally.gap_ms == [3.0]
    assert tally.recovered == 1


def test_a_neighbour_may_have_been_stuck_for_longer() -> None:
    tally = Tally()
    load(tally, 0, *EVERYBODY)
    tally.victim_died(11 * SECOND, 10 * SECOND)
    tally.container_condemned(14 * SECOND, 8 * SECOND)
    tally.container_condemned(14 * SECOND, 13 * SECOND)
    assert tally.detection_s == [6.0, 4.0]


def test_help_is_counted() -> None:
    tally = Tally()
    load(tally, 0, *EVERYBODY)
    tally.victim_died(2, 1)
    tally.container_died("nothing moved", by_us=True)
    assert (tally.restarts, tally.undetected) == (1, 1)
    assert tally.detection_s == []

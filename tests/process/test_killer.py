"""What is said of a SIGKILL from outside."""

from __future__ import annotations

import pytest

from play_launch.process.killer import killer_hint, memory_pressure, oom_kills


@pytest.mark.parametrize(
    ("before", "now", "pressure", "says"),
    [
        (None, 3, 0.0, ""),
        (3, None, 0.0, ""),
        (3, 3, None, "sent by a process, not by the kernel"),
        (3, 3, 9.9, "sent by a process, not by the kernel"),
        (3, 3, 55.4, "waited for memory in 55 % of the last 10 s"),
        (3, 4, None, "the kernel killed a process of this machine for want of memory while it ran"),
        (3, 4, 2.0, "perhaps this one; fix: "),
        (3, 5, 80.0, "2 processes of this machine"),
        (3, 5, 80.0, "perhaps this one; processes waited for memory in 80 % of the last 10 s; fix"),
    ],
)
def test_the_counters_of_the_kernel_say_who(
    before: int | None, now: int | None, pressure: float | None, says: str
) -> None:
    hint = killer_hint(before, now, pressure)
    assert says in hint
    assert bool(says) == bool(hint)
    assert ("systemd-oomd" in hint) == ("%" in hint and before == now)
    assert ("%" in hint) == (pressure is not None and pressure > 10)


def test_this_kernel_counts() -> None:
    counted = oom_kills()
    assert counted is not None
    assert counted >= 0
    pressure = memory_pressure()
    assert pressure is None or 0 <= pressure <= 100

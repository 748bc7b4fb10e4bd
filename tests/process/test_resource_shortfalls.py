"""What processes ask of the kernel, and what is said where they do not get it."""

from __future__ import annotations

import math
import os
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from play_launch.config.resources import (
    IoClass,
    IoPriority,
    ResourceLimit,
    Resources,
    Scheduler,
    SchedulerPolicy,
    nice_limit,
)
from play_launch.config.sections import RlimitsSection
from play_launch.process.resources import HeldResources, held_resources, shortfalls

schedulers = st.one_of(
    st.sampled_from([each for each in SchedulerPolicy if not each.is_real_time]).map(Scheduler),
    st.builds(
        Scheduler,
        st.sampled_from([SchedulerPolicy.FIFO, SchedulerPolicy.RR]),
        st.integers(1, 99),
    ),
)
io_priorities = st.one_of(
    st.just(IoPriority(IoClass.IDLE)),
    st.builds(
        IoPriority,
        st.sampled_from([IoClass.REALTIME, IoClass.BEST_EFFORT]),
        st.integers(0, 7),
    ),
)
cpu_sets = st.sets(st.integers(0, 1023), max_size=20).map(lambda cpus: tuple(sorted(cpus)))
bounds = st.one_of(st.integers(0, 2**62), st.just(math.inf))
limits = st.builds(
    lambda name, low, high: ResourceLimit(name, min(low, high), max(low, high)),
    st.sampled_from(sorted(RlimitsSection.keys)),
    bounds,
    bounds,
)
wishes = st.builds(
    Resources,
    nice=st.none() | st.integers(-20, 19),
    scheduler=st.none() | schedulers,
    cpu_affinity=cpu_sets,
    io_priority=st.none() | io_priorities,
    oom_score_adj=st.none() | st.integers(-1000, 1000),
    lock_memory=st.booleans(),
    rlimits=st.lists(limits, max_size=4, unique_by=lambda limit: limit.name).map(tuple),
)


def granted(wanted: Resources) -> HeldResources:
    """What a process has that got everything."""
    return HeldResources(
        nice=0 if wanted.nice is None else wanted.nice,
        scheduler=wanted.scheduler or Scheduler(SchedulerPolicy.OTHER),
        cpu_affinity=wanted.cpu_affinity or (0,),
        io_priority=wanted.io_priority,
        oom_score_adj=wanted.oom_score_adj or 0,
        locks_memory=wanted.lock_memory,
        rlimits={limit.name: (limit.soft, limit.hard) for limit in wanted.rlimits},
    )


@given(wishes)
def test_who_gets_everything_misses_nothing(wanted: Resources) -> None:
    assert shortfalls(wanted, granted(wanted)) == ()


@given(wishes, wishes)
def test_each_difference_is_a_sentence_with_its_fix(wanted: Resources, other: Resources) -> None:
    held = replace(
        granted(other),
        rlimits={limit.name: (1.0, 2.0**63) for limit in wanted.rlimits},
    )
    told = shortfalls(wanted, held)
    assert all(re.search(r": .*; fix: ", text) for text in told)
    missing = [
        wanted.nice not in {None, held.nice},
        wanted.scheduler not in {None, held.scheduler},
        wanted.cpu_affinity not in {(), held.cpu_affinity},
        None not in {wanted.io_priority, held.io_priority}
        and wanted.io_priority != held.io_priority,
        wanted.oom_score_adj not in {None, held.oom_score_adj},
        wanted.lock_memory and not held.locks_memory,
    ]
    assert len(told) == sum(missing) + len(wanted.rlimits)


@given(wishes)
def test_settings_are_words_and_numbers_and_limits_come_first(wanted: Resources) -> None:
    settings = wanted.settings()
    assert all(re.fullmatch(r"[a-z_]+( -?[0-9]+)+", each) for each in settings)
    kinds = [each.partition(" ")[0] == "rlimit" for each in settings]
    assert kinds == sorted(kinds, reverse=True)
    asks = replace(wanted, lock_memory=False)
    assert bool(settings) == bool(asks)


@given(io_priorities)
def test_io_priorities_as_the_kernel_has_them(priority: IoPriority) -> None:
    assert IoPriority.of_number(priority.number) == priority


def test_the_nice_value_of_a_limit() -> None:
    assert [nice_limit(value) for value in (-20, 0, 19)] == [40, 20, 1]


def test_our_own_resources_are_read() -> None:
    held = held_resources(os.getpid(), ("nofile", "core"))
    assert held is not None
    assert held.nice == os.getpriority(os.PRIO_PROCESS, 0)
    assert set(held.cpu_affinity) == os.sched_getaffinity(0)
    assert held.rlimits.keys() == {"nofile", "core"}


def test_a_process_that_has_ended_has_nothing() -> None:
    assert held_resources(2**22 + 1) is None


@pytest.mark.parametrize("policy", SchedulerPolicy)
def test_only_real_time_policies_show_a_priority(policy: SchedulerPolicy) -> None:
    assert str(Scheduler(policy, 7)) == (f"{policy} 7" if policy.is_real_time else policy)

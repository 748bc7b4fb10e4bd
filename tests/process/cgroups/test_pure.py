"""Names, the choice of the base, and what is said of refusals."""

from __future__ import annotations

import errno
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.config.resources import NO_LIMIT, GroupLimits, cpu_text, cpus_in
from play_launch.process.cgroups.base import (
    Hierarchy,
    OwnGroup,
    hierarchy,
    no_hierarchy,
    obstacle,
    own_base,
)
from play_launch.process.cgroups.controllers import Lack, lacks
from play_launch.process.cgroups.deaths import memory_reason, processes_reason
from play_launch.process.cgroups.names import SUPERVISOR, SessionName, group_name, node_group_name
from play_launch.process.cgroups.refusals import (
    fewer_cpus,
    no_controller,
    no_entry,
    no_group,
    no_limit,
    unavailable_controller,
)
from play_launch.process.cgroups.sweep import dead_sessions

numbers = st.integers(1, 2**40)
sessions = st.builds(SessionName, numbers, numbers, numbers)
full_names = st.lists(st.text(min_size=1, max_size=60), min_size=1, max_size=5).map(
    lambda parts: "/" + "/".join(part.replace("/", "_") for part in parts)
)


@given(sessions)
def test_sessions_are_read_as_they_are_written(name: SessionName) -> None:
    assert SessionName.parsed(str(name)) == name
    assert SessionName.parsed(f"{name}x") is None


@given(full_names, full_names, st.integers(1, 99))
def test_no_two_members_share_a_group(one: str, other: str, attempt: int) -> None:
    name = node_group_name(one, attempt)
    assert (group_name(one) == group_name(other)) == (one.lstrip("/") == other.lstrip("/"))
    assert len(name.encode()) < 255
    assert re.fullmatch(r"[\x21-\x7e]+", name)
    assert "/" not in name
    # The files of the kernel have a word after the dot.
    assert not re.fullmatch(r"[a-z]+\.[a-z.]+", name)
    assert group_name(one) not in {".", ".."}


@given(st.sets(st.integers(0, 1023)))
def test_cpus_are_read_as_they_are_written(cpus: set[int]) -> None:
    assert cpus_in(cpu_text(cpus)) == cpus


@given(st.lists(sessions, max_size=6), st.sets(st.integers(0, 5)), st.integers(0, 5))
def test_only_dead_sessions_of_this_namespace_are_swept(
    names: list[SessionName], alive: set[int], which: int
) -> None:
    ours = names[which].namespace if which < len(names) else 1
    living = {(each.pid, each.start_time) for i, each in enumerate(names) if i in alive}
    found = dead_sessions(
        [*map(str, names), "system.slice", SUPERVISOR],
        ours,
        lambda pid, start: (pid, start) in living,
    )
    assert set(found) == {
        str(each)
        for each in names
        if each.namespace == ours and (each.pid, each.start_time) not in living
    }


MOUNTS = """\
24 1 0:22 / /sys/fs/cgroup ro,nosuid - tmpfs tmpfs ro,mode=755
25 24 0:23 / /sys/fs/cgroup/unified\\040two rw,nosuid shared:5 - cgroup2 cgroup2 rw
26 24 0:24 / /sys/fs/cgroup/systemd rw - cgroup cgroup rw,name=systemd
"""


def test_the_hierarchy_is_found() -> None:
    mount = Path("/sys/fs/cgroup/unified two")
    found = hierarchy(MOUNTS, "4:memory:/x\n0::/user.slice/a.scope\n")
    assert found is not None
    assert (found.mount, found.own) == (mount, mount / "user.slice/a.scope")
    # A part of it, as containers have it.
    bound = MOUNTS.replace("0:23 /", "0:23 /user.slice")
    found = hierarchy(bound, "0::/user.slice/a.scope\n")
    assert found is not None
    assert (found.mount, found.own) == (mount, mount / "a.scope")
    assert hierarchy(bound, "0::/elsewhere\n") is None
    assert hierarchy(MOUNTS, "4:memory:/x\n") is None
    assert hierarchy("", "0::/\n") is None


@pytest.mark.parametrize(
    ("cgroup", "named"),
    [
        ("", "none of version 2"),
        ("4:memory:/x\n", "none of version 2"),
        # As from within a namespace that was entered without moving into its groups.
        ("0::/../elsewhere\n", "/../elsewhere"),
    ],
)
def test_who_is_in_no_group_that_is_seen_hears_where_it_is(cgroup: str, named: str) -> None:
    mounted = "30 23 0:26 / /m rw - cgroup2 none rw\n"
    assert hierarchy(mounted, "0::/a\n") == Hierarchy(Path("/m"), Path("/m/a"))
    assert hierarchy(mounted, cgroup) is None
    said = no_hierarchy(mounted, cgroup)
    assert f"is not below /m: /proc/self/cgroup names {named}; fix: start it in a group" in said
    assert "no hierarchy of cgroup v2 is mounted; fix: mount" in no_hierarchy("", cgroup)


def test_who_is_in_the_leaf_already_uses_the_group_above() -> None:
    assert own_base(Path("/m/a.scope") / SUPERVISOR) == Path("/m/a.scope")
    assert own_base(Path("/m/a.scope")) == Path("/m/a.scope")


facts = st.builds(
    OwnGroup,
    is_writable=st.booleans(),
    is_read_only=st.booleans(),
    is_top=st.booleans(),
    is_root_user=st.booleans(),
    is_systemds=st.booleans(),
    is_marked=st.booleans(),
)


@given(facts)
def test_a_group_is_used_where_it_was_given_to_us(found: OwnGroup) -> None:
    said = obstacle(Path("/m/g"), found)
    is_ours = found.is_marked or found.is_top or not found.is_systemds
    assert (said == "") == (found.is_writable and not found.is_read_only and is_ours)
    assert not said or re.search(r"^(the control group )?/m/g is .*; fix: \S", said)
    # Without any right, systemd-run of the user's own manager is the fix.
    if not (found.is_writable or found.is_root_user or found.is_read_only):
        assert "systemd-run --user --scope -p Delegate=yes" in said


ERRORS = sorted(errno.errorcode)


@pytest.mark.parametrize("number", ERRORS)
def test_every_refusal_has_its_fix_or_its_reason(number: int) -> None:
    error = OSError(number, "")
    group = Path("/m/g")
    said = [no_group(group, error), no_limit("cpu.max", "5 6", error)]
    said += [no_controller(each, group, error) for each in ("cpu", "memory", "hugetlb")]
    for text in said:
        assert text.strip() == text
        assert ": " in text
    assert all("; fix: " in text for text in said[:2])


def test_refusals_name_what_does_not_hold() -> None:
    group = Path("/m/g")
    fixes = {
        Lack.NOT_GIVEN: "Delegate=cpu cpuset io memory pids",
        Lack.IN_VERSION_1: "cgroup_no_v1=all",
        Lack.SWITCHED_OFF: "cgroup_disable=cpuset",
    }
    for lack, fix in fixes.items():
        missing = unavailable_controller("cpuset", group, lack)
        assert missing.startswith("cpuset cannot hold: the controller cpuset is not available in ")
        assert [each for each in fixes.values() if each in missing] == [fix]
    busy = no_controller("memory", group, OSError(errno.EBUSY, ""))
    assert busy.startswith("memory_high and memory_max cannot hold")
    assert "which has processes; fix: start it by systemd-run" in busy
    assert "CONFIG_RT_GROUP_SCHED" in no_controller("cpu", group, OSError(errno.EINVAL, ""))
    assert "CONFIG_BLK_CGROUP_IOCOST" in no_limit("io.weight", "5", OSError(errno.ENOENT, ""))
    read_only = OSError(errno.EROFS, "")
    for said in (no_group(group, read_only), no_controller("cpu", group, read_only)):
        # As in a Docker container: nothing of systemd helps there.
        assert "writable-cgroups=true" in said
        assert "systemd" not in said
    assert fewer_cpus("0-7", "0-1").endswith("there are 0-1; fix: name those")
    assert "/m/cgroup.procs" in no_entry(group, group.parent)


CONTROLLERS_OF_A_KERNEL = """\
#subsys_name\thierarchy\tnum_cgroups\tenabled
cpuset\t3\t1\t1
cpu\t0\t9\t1
blkio\t7\t1\t1
memory\t0\t1\t0
"""


def test_a_kernel_says_where_its_controllers_are() -> None:
    found = lacks(CONTROLLERS_OF_A_KERNEL)
    assert found == {
        "cpuset": Lack.IN_VERSION_1,
        "io": Lack.IN_VERSION_1,
        "memory": Lack.SWITCHED_OFF,  # as on a Raspberry Pi
    }


@given(st.text())
def test_any_list_of_controllers_is_read(text: str) -> None:
    assert set(lacks(text).values()) <= {Lack.IN_VERSION_1, Lack.SWITCHED_OFF}


@given(
    st.dictionaries(st.sampled_from(["oom", "oom_kill", "max", "high"]), st.integers(0, 5)),
    st.none() | st.integers(1, 2**50),
)
def test_a_kill_for_memory_is_reported_as_such(events: dict[str, int], limit: int | None) -> None:
    said = memory_reason(events, limit)
    assert bool(said) == (events.get("oom_kill", 0) > 0)
    assert ("memory.max" in said) == bool(said and events.get("oom") and limit)


@given(st.integers(0, 3), st.none() | st.just(NO_LIMIT) | st.integers(1, 9))
def test_an_end_for_want_of_processes_is_reported_as_such(hits: int, limit: float | None) -> None:
    said = processes_reason({"max": hits}, limit)
    assert bool(said) == (hits > 0 and limit is not None and limit < NO_LIMIT)
    assert not said or said.startswith(f"pids_max {limit} of its control group was reached ")
    assert ("once" in said) == (bool(said) and hits == 1)


def test_sizes_are_written_as_people_do() -> None:
    killed = {"oom": 1, "oom_kill": 1}
    assert memory_reason(killed, 512 * 10**6).endswith("memory.max 512 MB of its control group")
    assert memory_reason(killed, 2**30).endswith("memory.max 1 GiB of its control group")


@given(st.builds(GroupLimits, cpu_weight=st.none() | numbers, pids_max=st.none() | numbers))
def test_files_and_controllers_belong_together(limits: GroupLimits) -> None:
    assert {file.partition(".")[0] for file in limits.files()} == limits.controllers()
    assert bool(limits) == bool(limits.files()) == bool(limits.described())

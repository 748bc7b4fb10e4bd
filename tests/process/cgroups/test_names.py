"""Names of groups, the hierarchy, and the causes of deaths; without any group."""

from __future__ import annotations

import re
from pathlib import Path

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from play_launch.config.resources import NO_LIMIT, GroupLimits
from play_launch.process.cgroups.group import (
    Group,
    SessionName,
    group_name,
    why_failed,
    why_killed,
)
from play_launch.process.cgroups.session_groups import hierarchy

numbers = st.integers(1, 2**40)
sessions = st.builds(SessionName, numbers, numbers, numbers)
full_names = st.lists(st.text(min_size=1, max_size=60), min_size=1, max_size=5).map(
    lambda parts: "/" + "/".join(part.replace("/", "_") for part in parts)
)
with_folder = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


@given(sessions)
def test_names_of_sessions_are_parsed(name: SessionName) -> None:
    assert SessionName.parsed(str(name)) == name
    assert SessionName.parsed(f"{name}x") is None


@given(full_names, full_names)
def test_no_two_members_share_a_group(one: str, other: str) -> None:
    name = group_name(one)
    assert (name == group_name(other)) == (one.lstrip("/") == other.lstrip("/"))
    assert len(name) <= 200
    assert re.fullmatch(r"[\x21-\x7e]+", name)
    # The files of the kernel have a dot.
    assert not set("/.") & set(name)


MOUNTS = """\
24 1 0:22 / /sys/fs/cgroup ro,nosuid - tmpfs tmpfs ro,mode=755
25 24 0:23 / /sys/fs/cgroup/unified rw,nosuid shared:5 - cgroup2 cgroup2 rw
26 24 0:24 / /sys/fs/cgroup/systemd rw - cgroup cgroup rw,name=systemd
"""


def test_the_hierarchy_is_found() -> None:
    mount = Path("/sys/fs/cgroup/unified")
    own = "/user.slice/a.scope"
    assert hierarchy(MOUNTS, own) == (mount, mount / "user.slice/a.scope")
    # A part of it, as containers have it.
    bound = MOUNTS.replace("0:23 /", "0:23 /user.slice")
    assert hierarchy(bound, own) == (mount, mount / "a.scope")
    assert hierarchy(bound, "/elsewhere") is None
    assert hierarchy(MOUNTS, "") is None
    # As from within a namespace that was entered without moving into its groups.
    assert hierarchy(MOUNTS, "/../elsewhere") is None
    assert hierarchy("", "/") is None


@with_folder
@given(
    st.dictionaries(st.sampled_from(["oom", "oom_kill", "max", "high"]), st.integers(0, 5)),
    st.none() | st.just(NO_LIMIT) | st.integers(1, 2**50),
)
def test_a_death_names_its_limit(
    tmp_path: Path, events: dict[str, int], limit: float | None
) -> None:
    text = "".join(f"{name} {value}\n" for name, value in events.items())
    for file in ("memory.events", "pids.events"):
        (tmp_path / file).write_text(text)
    group = Group(tmp_path, GroupLimits(memory_max=limit, pids_max=limit))
    is_limited = limit is not None and limit < NO_LIMIT
    killed, failed = why_killed(group), why_failed(group)
    assert bool(killed) == (events.get("oom_kill", 0) > 0)
    assert ("memory.max" in killed) == bool(killed and events.get("oom") and is_limited)
    assert bool(failed) == (events.get("max", 0) > 0 and is_limited)
    assert ("once" in failed) == (bool(failed) and events["max"] == 1)


def test_sizes_have_the_unit_that_makes_them_shortest(tmp_path: Path) -> None:
    (tmp_path / "memory.events").write_text("oom 1\noom_kill 1\n")
    for size, text in ((512 * 10**6, "512 MB"), (2**30, "1 GiB")):
        why = why_killed(Group(tmp_path, GroupLimits(memory_max=size)))
        assert why == f"killed by the kernel: memory.max {text} of its control group"

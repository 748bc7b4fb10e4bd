"""What files of the kernel say, and what is concluded from them."""

from __future__ import annotations

from pathlib import Path

import pytest

from play_launch.doctor.facts import KeySupport
from play_launch.doctor.gather_kernel import group_folder, own_group, support_of
from play_launch.doctor.surroundings import Surroundings, surroundings_of

MOUNTS = """\
22 27 0:21 / /proc rw,nosuid - proc proc rw
30 23 0:26 / /sys/fs/cgroup ro,nosuid shared:4 - tmpfs tmpfs ro
31 30 0:27 / /sys/fs/cgroup/my\\040unified rw,nosuid shared:9 master:1 - cgroup2 cgroup2 rw
32 30 0:28 / /sys/fs/cgroup/cpu rw - cgroup cgroup rw,cpu
"""


@pytest.mark.parametrize(
    ("groups", "mounts", "folder"),
    [
        ("4:cpu:/x\n0::/a.slice/b\n", MOUNTS, "/sys/fs/cgroup/my unified/a.slice/b"),
        ("0::/\n", MOUNTS, "/sys/fs/cgroup/my unified"),
        ("4:cpu:/x\n", MOUNTS, None),
        ("0::/a\n", "22 27 0:21 / /proc rw,nosuid - proc proc rw\n", None),
        ("", "", None),
    ],
)
def test_the_folder_of_a_group_is_found(groups: str, mounts: str, folder: str | None) -> None:
    assert group_folder(groups, mounts) == (folder and Path(folder))


def test_our_own_group_is_that_of_this_process() -> None:
    found = own_group()
    if not found.folder:
        pytest.skip("cgroup v2 is not mounted")
    processes = (Path(found.folder) / "cgroup.procs").read_text().split()
    assert str(Path("/proc/self").resolve().name) in processes


@pytest.mark.parametrize(
    ("groups", "started_by"),
    [
        ("0::/system.slice/robot.service", Surroundings.SYSTEM_SERVICE),
        ("0::/system.slice/robot.service/supervisor", Surroundings.SYSTEM_SERVICE),
        ("1:name=systemd:/system.slice/robot.service\n0::/", Surroundings.SYSTEM_SERVICE),
        (
            "0::/user.slice/user-7.slice/user@7.service/app.slice/robot.service",
            Surroundings.USER_SERVICE,
        ),
        (
            "0::/user.slice/user-7.slice/user@7.service/app.slice/run-r1.scope",
            Surroundings.LOGIN,
        ),
        ("0::/user.slice/user-7.slice/session-2.scope", Surroundings.LOGIN),
        ("0::/", Surroundings.LOGIN),
        ("", Surroundings.LOGIN),
    ],
)
def test_groups_say_what_started_a_process(groups: str, started_by: Surroundings) -> None:
    assert surroundings_of(groups, docker=False, podman=False) is started_by
    assert surroundings_of(groups, docker=True, podman=False) is Surroundings.DOCKER
    assert surroundings_of(groups, docker=False, podman=True) is Surroundings.PODMAN


@pytest.mark.parametrize(
    ("flags", "trial", "support"),
    [
        (set[str](), True, KeySupport.NO_CPU),
        ({"fpu", "pku"}, True, KeySupport.NO_KERNEL),
        ({"pku", "ospke"}, True, KeySupport.USABLE),
        ({"pku", "ospke"}, False, KeySupport.REFUSED),
        ({"poe"}, True, KeySupport.USABLE),
    ],
)
def test_keys_take_cpu_kernel_and_a_trial(
    flags: set[str], trial: bool, support: KeySupport
) -> None:
    assert support_of(flags, lambda: trial) is support

"""What files of the kernel say, and what is concluded from them."""

from __future__ import annotations

from pathlib import Path

import pytest

from play_launch.doctor.facts import KeySupport
from play_launch.doctor.gather_kernel import own_group, support_of
from play_launch.doctor.surroundings import Surroundings, surroundings_of


def test_our_own_group_is_a_group() -> None:
    found = own_group()
    if not found.folder:
        pytest.skip("cgroup v2 is not mounted")
    assert (Path(found.folder) / "cgroup.procs").is_file()


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

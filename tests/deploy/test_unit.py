"""The unit that is written, and what systemd says about it."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.config.load import parse_config
from play_launch.config.model import ReplayConfig
from play_launch.config.problems import ConfigError
from play_launch.deploy.unit import ServiceUnit, carried, is_acceptable, stop_seconds, unit_text
from tests.support.replay import COMMAND, run

from .units import settings_of, verify, words

SLEEP: dict[str, Any] = {"command": ["sleep", "9"]}


def service(**more: Any) -> ServiceUnit:
    keys = more.pop("keys", {"nodes": [{**SLEEP, "name": "p"}]})
    path = Path(more.pop("path", "/etc/robots/robot.yaml"))
    made: dict[str, Any] = {
        "config": parse_config(json.dumps({"version": 1, "name": "robot", **keys}).encode(), path),
        "program": COMMAND,
        "folder": Path("/"),
        "user": "robot",
        "environment": {},
        **more,
    }
    return ServiceUnit(**made)


def limits_of(**keys: Any) -> dict[str, str]:
    found = settings_of(unit_text(service(keys=keys)))
    limits = {key.partition("Limit")[2]: each[0] for key, each in found.items() if ".Limit" in key}
    assert limits.pop("NOFILE") == "4096:524288"
    return limits


def test_the_unit_grants_the_limits_that_the_configuration_requests() -> None:
    assert limits_of(nodes=[SLEEP]) == {"RTPRIO": "1"}, "the supervisor's own"
    fifo = {"scheduler": {"policy": "fifo", "priority": 50}, "rlimits": {"memlock": "1 MiB"}}
    node = {"package": "p", "plugin": "P", "resources": {"nice": -5}}
    container = {"name": "c", "container_type": "isolated", "core_dumps": True}
    assert limits_of(
        nodes=[{**SLEEP, "resources": fifo}, {**SLEEP, "resources": {"nice": 5}}],
        containers=[{**container, "resources": {"lock_memory": True}, "composable_nodes": [node]}],
    ) == {"RTPRIO": "50", "NICE": "25", "MEMLOCK": "infinity", "CORE": "0:infinity"}
    rlimits = {"rtprio": 80, "nice": -10, "memlock": "1 MiB", "nproc": "10:20", "stack": "1 MiB"}
    assert limits_of(nodes=[{**SLEEP, "resources": {"rlimits": rlimits}}]) == {
        "RTPRIO": "80",
        "NICE": "30",
        "MEMLOCK": "infinity",
        "NPROC": "infinity",
    }, "infinity is the default of the others, and a lower one would bind the supervisor"
    files = {"resources": {"rlimits": {"nofile": 600_000}}}
    (found,) = settings_of(unit_text(service(keys={"nodes": [{**SLEEP, **files}]})))[
        "Service.LimitNOFILE"
    ]
    assert found == "4096:600000"


@pytest.mark.parametrize("for_user", [False, True])
def test_systemd_accepts_it(tmp_path: Path, for_user: bool) -> None:
    config = tmp_path / "100 % of it $HOME.yaml"
    config.write_text("version: 1\nnodes: [{command: ['true']}]\n")
    text = unit_text(
        service(
            path=config,
            folder=tmp_path,
            user="" if for_user else "root",
            environment={"ROS_DOMAIN_ID": "7", "TEXT": 'a "b" \\ 100%\n$x'},
            left_out=("TOKEN", "X"),
            arguments=("text:=a 'b' $c %d \\e;",),
            log_dir=tmp_path,
        )
    )
    verify(text, tmp_path, for_user=for_user)


def test_a_slow_machine_has_time_to_start() -> None:
    found = settings_of(unit_text(service()))
    # More than systemd's default of 90 s, and only to the first pulse.
    assert int(found["Service.TimeoutStartSec"][0]) >= 120
    assert int(found["Service.WatchdogSec"][0]) < 120


def test_a_system_service_runs_as_its_user_and_a_user_s_own_does_not_say() -> None:
    found = settings_of(unit_text(service()))
    assert found["Service.User"] == ["robot"]
    assert found["Install.WantedBy"] == ["multi-user.target"]
    assert found["Unit.After"] == ["network-online.target"]
    own = settings_of(unit_text(service(user="")))
    assert "Service.User" not in own
    assert own["Install.WantedBy"] == ["default.target"]
    assert "Unit.After" not in own, "a user's manager does not know the network"


@pytest.mark.parametrize("where", ["the shell", "the configuration"])
def test_what_stays_on_this_machine_waits_for_no_network(where: str) -> None:
    variables = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    made = service(environment=variables)
    if where == "the configuration":
        made = service(keys={"environment": variables, "nodes": [{**SLEEP, "name": "p"}]})
    assert "Unit.Wants" not in settings_of(unit_text(made))


WORDS = st.text(st.sampled_from("ab %$\\\"';#{}~\n\t")).filter(is_acceptable)


@given(WORDS, WORDS)
def test_commands_and_variables_are_what_was_given(word: str, value: str) -> None:
    text = unit_text(service(arguments=(f"a:={word}",), environment={"NAME": value}))
    found = settings_of(text)
    (start,) = found["Service.ExecStart"]
    usual = [str(COMMAND), "replay", "--quiet", "/etc/robots/robot.yaml", f"a:={word}"]
    assert words(start) == usual
    (reload,) = found["Service.ExecReload"]
    assert words(reload, MAINPID="9") == [
        *(str(COMMAND), "apply", "--session", "9"),
        *usual[3:],
    ]
    (variable,) = found["Service.Environment"]
    assert words(variable.replace("$", "$$")) == [f"NAME={value}"]


@given(st.text(st.characters(codec="utf-8"), min_size=1, max_size=20))
def test_any_name_of_a_system_makes_a_unit(name: str) -> None:
    try:
        made = service(keys={"name": name, "nodes": [{**SLEEP, "name": "p"}]})
    except ConfigError:
        return
    text = unit_text(made)
    assert settings_of(text)["Unit.Description"][0].endswith("(play-launch)")
    assert made.name.strip("-") == made.name
    assert made.name


def system(**keys: Any) -> ReplayConfig:
    return parse_config(json.dumps({"version": 1, **keys}).encode(), Path("/etc/robot.yaml"))


def test_a_stop_takes_as_long_as_its_levels_and_units_that_wait_for_each_other() -> None:
    limits = {"ask": "1 s", "sigint": "2 s", "sigterm": "3 s"}
    # 5 s for SIGKILL, 10 s to close the recording.
    assert stop_seconds(system(stop=limits, nodes=[{**SLEEP, "name": "a"}])) == 21
    chain = [
        {**SLEEP, "name": "a"},
        {**SLEEP, "name": "b", "depends_on": ["a"]},
        {**SLEEP, "name": "c", "depends_on": ["b"]},
        {**SLEEP, "name": "d", "depends_on": ["a"]},
    ]
    assert stop_seconds(system(stop=limits, nodes=chain)) == 3 * 11 + 10


@given(st.lists(st.integers(0, 5), min_size=1, max_size=6))
def test_generations_are_the_longest_chain(levels: list[int]) -> None:
    nodes = []
    for number, level in enumerate(levels):
        before = [f"p{other}" for other in range(number) if levels[other] < level]
        nodes.append({**SLEEP, "name": f"p{number}", "depends_on": before})
    depth: dict[int, int] = {}
    for number, level in enumerate(levels):
        chain = [depth[other] for other in range(number) if levels[other] < level]
        depth[number] = 1 + max(chain, default=0)
    stop = {"ask": "1 s", "sigint": "1 s", "sigterm": "1 s"}
    assert stop_seconds(system(stop=stop, nodes=nodes)) == 8 * max(depth.values()) + 10


SHELL = {
    "PATH": "/opt/ros/jazzy/bin:/usr/bin",
    "AMENT_PREFIX_PATH": "/opt/ros/jazzy",
    "ROS_DOMAIN_ID": "7",
    "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp",
    "CYCLONEDDS_URI": "<CycloneDDS><Domain/></CycloneDDS>",
    "PLAY_LAUNCH_LOG_DIR": "/var/log/robot",
    "SSH_AUTH_SOCK": "/tmp/agent",
    "LS_COLORS": "x",
    "ROBOT": "spot",
    "HUB_TOKEN": "abc",
    "ROS_BELL": "\x07",
}


REQUIRED = {"ROBOT": "spot", "HUB_TOKEN": "abc", "UNSET": None, "LS_COLORS": None}


def test_ros_and_what_the_configuration_takes_are_carried() -> None:
    values, left_out = carried(SHELL, REQUIRED)
    assert set(values) == {
        "PATH",
        "AMENT_PREFIX_PATH",
        "ROS_DOMAIN_ID",
        "RMW_IMPLEMENTATION",
        "CYCLONEDDS_URI",
        "PLAY_LAUNCH_LOG_DIR",
        "ROBOT",
    }
    assert values["CYCLONEDDS_URI"] == SHELL["CYCLONEDDS_URI"]
    assert left_out == ("HUB_TOKEN", "ROS_BELL")


def test_a_password_in_a_configuration_of_a_middleware_is_a_secret() -> None:
    shell = {"CYCLONEDDS_URI": "<Security password=abc>", "ROS_URL": "http://a:b@c/"}
    assert carried(shell, {})[1] == ("CYCLONEDDS_URI", "ROS_URL")


def unit(*arguments: str | Path, cwd: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    return run("systemd-unit", *arguments, cwd=cwd, env={**os.environ, **variables})


def test_the_command_writes_what_systemd_accepts(tmp_path: Path) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text(
        "version: 1\nname: spot\nnodes:\n  - command: [echo, '${arg:a}', '${env:ROBOT}']\n"
    )
    target = tmp_path / "spot.service"
    more = {"ROBOT": "spot 1", "ROS_LOCALHOST_ONLY": "0", "UNRELATED": "x"}
    done = unit("robot.yaml", "a:=1 2", "--user", "-o", target, cwd=tmp_path, **more)
    assert done.returncode == 0, done.stderr
    assert str(target) in done.stdout
    text = target.read_text()
    found = settings_of(text)
    assert words(found["Service.ExecStart"][0]) == [
        *(str(COMMAND), "replay", "--quiet", str(config), "a:=1 2"),
    ]
    assert found["Service.WorkingDirectory"] == [str(tmp_path)]
    variables = [words(each)[0] for each in found["Service.Environment"]]
    assert "ROBOT=spot 1" in variables
    assert f"ROS_DOMAIN_ID={os.environ['ROS_DOMAIN_ID']}" in variables
    assert not any(each.startswith(("UNRELATED", "_ROS_WHEELS")) for each in variables)
    verify(text, tmp_path, for_user=True)


def test_a_secret_stays_out_of_the_unit_and_is_named(tmp_path: Path) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text("version: 1\nnodes:\n  - command: [echo, '${env:HUB_TOKEN}']\n")
    done = unit("robot.yaml", cwd=tmp_path, HUB_TOKEN="abcdef")
    assert done.returncode == 0
    assert "abcdef" not in done.stdout + done.stderr
    assert "HUB_TOKEN" in done.stdout
    assert "HUB_TOKEN" in done.stderr
    assert "EnvironmentFile=-/etc/play-launch/robot.env" in done.stdout


def test_mistakes_are_reported_and_nothing_is_written(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text("version: 1\nnodes: [{comand: ['true']}]\n")
    done = unit("robot.yaml", "-o", "robot.service", cwd=tmp_path)
    assert done.returncode == 2
    assert "robot.yaml:2:" in done.stderr
    assert not (tmp_path / "robot.service").exists()
    (tmp_path / "robot.yaml").write_text("version: 1\nnodes: [{command: ['true']}]\n")
    done = unit("robot.yaml", "-o", "no/folder", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("error: no/folder: No such file or directory")
    folder = tmp_path / "a'b"
    folder.mkdir()
    done = unit("../robot.yaml", cwd=folder)
    assert done.returncode == 2
    assert "systemd accepts no path with quotes" in done.stderr

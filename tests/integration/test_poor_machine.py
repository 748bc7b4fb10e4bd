"""Machines that lack what a system needs: one message with the fix; profiles of Fast DDS."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from play_launch.ros.fastdds.shared_memory import SHARED_MEMORY
from tests.support.loopback_network import permitted
from tests.support.mounts import NO_PROC, hung, mounted, small_shared_memory
from tests.support.replay import COMMAND, replaying
from tests.support.scenes import container, node, written
from tests.support.shared_memory import segments_of
from tests.support.waiting import until

TALKER = node("talker")
FILL = "dd if=/dev/zero of=/dev/shm/full bs=4k"


def configuration(folder: Path, **values: Any) -> Path:
    return written(folder, **{"containers": [container("chat", TALKER)], **values})


def replay(config: Path, *arguments: str) -> list[object]:
    return [COMMAND, "replay", config, "--log-dir", config.parent / "logs", *arguments]


def run(command: list[Any], **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command, capture_output=True, text=True, check=False, timeout=120, **options
    )


def finding(result: subprocess.CompletedProcess[str], subject: str) -> dict[str, Any]:
    report = json.loads(result.stdout)["findings"]
    found: dict[str, Any] = next(each for each in report if each["subject"] == subject)
    return found


def limited(size: int) -> list[str]:
    code = (
        "import os, resource, sys; "
        f"resource.setrlimit(resource.RLIMIT_AS, ({size}, {size})); "
        "os.execv(sys.argv[1], sys.argv[1:])"
    )
    return [sys.executable, "-c", code]


def test_without_proc_nothing_is_started(tmp_path: Path) -> None:
    config = configuration(tmp_path)
    result = run(mounted(NO_PROC, *replay(config)))
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert "/proc is not mounted" in result.stderr
    assert "; fix: mount -t proc" in result.stderr
    assert not (tmp_path / "logs").exists()
    result = run(mounted(NO_PROC, COMMAND, "doctor", "--json"))
    assert result.returncode == 1
    assert result.stderr == ""
    assert finding(result, "/proc")["level"] == "fail"


@pytest.mark.parametrize("size", [100 << 20, 1023 << 20], ids=["100 MiB", "1023 MiB"])
def test_with_a_small_address_space_nothing_is_started(tmp_path: Path, size: int) -> None:
    result = run([*limited(size), *replay(configuration(tmp_path))])
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert f"limited to {size >> 20:,} MiB (ulimit -v)" in result.stderr
    assert "; fix: ulimit -v unlimited" in result.stderr
    assert not (tmp_path / "logs").exists()
    result = run([*limited(size), COMMAND, "doctor", "--json"])
    assert result.returncode == 1
    assert result.stderr == ""
    for subject in ("address space", "rclpy", "container"):
        found = finding(result, subject)
        assert (found["level"], found["fix"].split(",")[0]) == ("fail", "ulimit -v unlimited")


def test_an_address_space_of_a_gibibyte_is_enough(tmp_path: Path) -> None:
    command = [*limited(1 << 30), *map(str, replay(configuration(tmp_path), "--json"))]
    states: list[str] = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            event = json.loads(line)
            states += [event["state"]] if event["event"] == "node" else []
            if states[-1:] == ["loaded"]:
                process.send_signal(signal.SIGINT)
                break
        process.stdout.read()
    assert states[-1:] == ["loaded"]


def test_little_shared_memory_is_reported_at_the_start(tmp_path: Path) -> None:
    config = configuration(tmp_path)
    command = mounted(small_shared_memory("8m"), *replay(config, "--duration", "1s"))
    result = run(command)
    assert "/dev/shm has 8 MiB of 8 MiB free, this system needs 16 MiB" in result.stdout
    assert "fix: in docker: --shm-size" in result.stdout
    found = finding(
        run(mounted(small_shared_memory("8m"), COMMAND, "doctor", "--json")), "shared memory"
    )
    assert found["level"] == "warn"
    assert "8 MiB" in found["says"]
    enough = mounted(small_shared_memory("64m"), *replay(config, "--duration", "1s"))
    assert "/dev/shm" not in run(enough).stdout


def test_full_shared_memory_is_refused(tmp_path: Path) -> None:
    mount = f"{small_shared_memory('2m')} && ! {FILL} 2> /dev/null"
    result = run(mounted(mount, *replay(configuration(tmp_path))))
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert "/dev/shm is full (0 MiB of 2 MiB free)" in result.stderr
    assert "; fix: in docker" in result.stderr
    report = run(mounted(mount, COMMAND, "doctor", "--json"))
    assert report.returncode == 1
    assert report.stderr == ""
    failed = [each for each in json.loads(report.stdout)["findings"] if each["level"] == "fail"]
    assert [each["subject"] for each in failed] == ["rclpy", "container", "shared memory"]
    # One thing is wrong, and each of them names the fix.
    assert {each["fix"].partition(":")[0] for each in failed} == {"in docker"}
    assert "shared memory is full" in finding(report, "rclpy")["says"]


@pytest.mark.parametrize("verb", [("daemon", "start"), ("daemon", "run"), ("node", "list")])
def test_the_graph_daemon_is_refused_where_shared_memory_is_full(verb: tuple[str, str]) -> None:
    mount = f"{small_shared_memory('2m')} && ! {FILL} 2> /dev/null"
    result = run(mounted(mount, COMMAND, *verb))
    assert result.returncode in {1, 2}
    assert "/dev/shm is full (0 MiB of 2 MiB free)" in result.stderr


def test_shared_memory_that_the_dead_have_filled_is_cleaned_up(tmp_path: Path) -> None:
    left = "/dev/shm/fastrtps_0123456789abcdef"
    fill = f": > {left}_el && ! dd if=/dev/zero of={left} bs=4k 2> /dev/null"
    mount = f"{small_shared_memory('24m')} && {fill}"
    report = run(mounted(mount, COMMAND, "doctor", "--json"))
    assert "next run of play-launch removes them" in finding(report, "leftovers")["fix"]
    result = run(mounted(mount, *replay(configuration(tmp_path), "--duration", "1s")))
    assert result.returncode != 2, result.stderr
    assert "/dev/shm" not in result.stdout


@pytest.mark.parametrize("kind", ["standard", "isolated", "process"])
def test_a_death_of_a_bus_error_names_shared_memory_that_is_full(tmp_path: Path, kind: str) -> None:
    """Whatever dies of it: a container, a node of an isolated one, an ordinary executable."""
    go = tmp_path / "go"
    os.mkfifo(go)
    filler = ["sh", "-c", f"read line < {go}; sleep infinity & {FILL}; echo $!; wait"]
    chat = container("chat", TALKER, container_type="standard" if kind == "process" else kind)
    config = configuration(
        tmp_path, containers=[chat], nodes=[{"name": "filler", "command": filler}]
    )
    command = mounted(small_shared_memory("8m"), *replay(config, "--json"))
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        pids: dict[str, int] = {}
        reason = ""
        assert process.stdout is not None
        for line in process.stdout:
            event = json.loads(line)
            if event["event"] == "process" and event["kind"] == "started":
                pids["standard" if event["name"] == "/chat" else "process"] = event["pid"]
            if event["event"] == "node" and event["state"] == "loaded":
                pids["isolated"] = event["pid"]
                go.write_text("now\n", encoding="utf-8")
            if event["event"] == "output" and event["text"].isdecimal():
                pids["full"] = int(event["text"])
            if pids.keys() >= {"full", "isolated", "standard"} and "sent" not in pids:
                pids["sent"] = 1
                os.kill(pids[kind], signal.SIGBUS)
            if event["event"] == "process" and event["kind"] == "exited" and kind != "isolated":
                reason = event["message"]
            if event["event"] == "node" and event["state"] in {"crashed", "requested"}:
                reason = event["reason"]
            if "SIGBUS" in reason:
                process.send_signal(signal.SIGINT)
                break
        process.stdout.read()
    assert reason.startswith(("SIGBUS (", "exited with signal 7 (SIGBUS)"))
    assert ": /dev/shm is full (0 MiB of 8 MiB free); fix:" in reason


@pytest.mark.parametrize("discovery", ["LOCALHOST", "SUBNET"])
def test_shared_memory_that_fills_up_later_leaves_the_supervisor_alone(
    tmp_path: Path, discovery: str
) -> None:
    """It takes part in ROS for stock containers, whose services it calls."""
    go = tmp_path / "go"
    os.mkfifo(go)
    nodes = [
        node("slow", "SlowConstructor", parameters={"seconds": 5.0}),
        # More than one request has touched of shared memory before.
        {**TALKER, "parameters": {"unread": "x" * 60_000}},
    ]
    package = "play_launch_container"
    stock = container("stock", *nodes, container_type="stock", package=package)
    filler = ["sh", "-c", f"read line < {go}; {FILL}; echo full; sleep infinity"]
    config = configuration(
        tmp_path, containers=[stock], nodes=[{"name": "filler", "command": filler}]
    )
    command = mounted(small_shared_memory("16m"), *replay(config, "--json", "--duration", "60s"))
    environment = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": discovery}
    seen: list[str] = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout is not None
        for line in process.stdout:
            event = json.loads(line)
            if event["event"] == "output" and event["text"] == "full":
                seen.append("full")
            if event["event"] == "node" and event["state"] in {"loading", "loaded"}:
                seen.append(f"{event['node']} {event['state']}")
                if seen[-1] == "/slow loading" and seen.count(seen[-1]) == 1:
                    go.write_text("now\n", encoding="utf-8")
                if seen[-1] == "/talker loaded":
                    process.send_signal(signal.SIGINT)
                    break
        process.stdout.read()
    assert process.returncode == 128 + signal.SIGINT, seen
    assert seen.index("full") < seen.index("/slow loaded")


ROOT = Path(__file__).resolve().parents[2]
PROFILES = ROOT / "fixtures" / "fastdds"
MEBIBYTE = 1 << 20

# Two containers, so that what is published goes from process to process. With LOCALHOST the RMW
# makes transports of its own beside those of a profile, hence the default range, and a network of
# its own.
SYSTEM = """
version: 1
record: {{ros: false}}
environment:
  ROS_AUTOMATIC_DISCOVERY_RANGE: SUBNET
  FASTRTPS_DEFAULT_PROFILES_FILE: {profile}
containers:
  - name: sender
    composable_nodes:
      - package: play_launch_demo
        plugin: play_launch_demo::Talker
        name: talker
  - name: receiver
    composable_nodes:
      - package: play_launch_demo
        plugin: play_launch_demo::Listener
        name: listener
"""


@pytest.fixture
def in_a_network_of_its_own() -> None:
    if not permitted():
        pytest.skip("this kernel permits no network namespace")


@pytest.mark.usefixtures("in_a_network_of_its_own")
@pytest.mark.parametrize(("profile", "expected"), [("no_shm", []), ("large_segment", [4, 4])])
def test_profile(profile: str, expected: list[int], tmp_path: Path) -> None:
    config = tmp_path / "system.yaml"
    config.write_text(SYSTEM.format(profile=PROFILES / f"{profile}.xml"), encoding="utf-8")

    with ExitStack() as stack:
        replay = stack.enter_context(replaying(config, tmp_path / "log", in_a_network=True))
        replay.read_until(
            lambda event: "I heard" in event.get("text", ""), "a message from process to process"
        )
        # It has a /dev/shm of its own, too, which is there as long as we have it open.
        shared = os.open(f"/proc/{replay.pid}/root{SHARED_MEMORY}", os.O_RDONLY | os.O_DIRECTORY)
        try:
            found = {each.name for each in segments_of(each.pid for each in replay.descendants())}
            sizes = [os.stat(name, dir_fd=shared).st_size // MEBIBYTE for name in found]
            stack.close()
            left = found.intersection(os.listdir(shared))  # noqa: PTH208 - of a descriptor
        finally:
            os.close(shared)

    assert sizes == expected
    assert replay.process.returncode == 130
    assert not left


def test_a_mount_that_does_not_answer_holds_up_only_what_needs_it(tmp_path: Path) -> None:
    there, mark = tmp_path / "there", tmp_path / "mark"
    with hung(tmp_path / "hung") as mount:
        nodes: list[dict[str, Any]] = [
            {"name": "program", "command": [f"{mount}/program"]},
            {"name": "path", "command": ["no-such"], "environment": {"PATH": f"{mount}:/bin"}},
            {"name": "folder", "command": ["sleep", "600"], "cwd": str(mount / "folder")},
            {"name": "prefix", "package": "p", "executable": "e"},
            {"name": "file", "command": ["true"], "depends_on": [{"file": str(mount / "file")}]},
            {
                "name": "after",
                "command": ["touch", str(mark)],
                "depends_on": [{"file": str(there)}],
            },
        ]
        nodes[3]["environment"] = {"AMENT_PREFIX_PATH": str(mount)}
        config = configuration(tmp_path, nodes=nodes, stop={"sigint": 1, "sigterm": 1})
        with replaying(config, tmp_path / "logs") as system:
            system.read_until_up("/talker")
            there.touch()
            system.until(event="process", name="/after", kind="exited")
            assert mark.exists()
            system.process.send_signal(signal.SIGINT)
            events = system.read_all()
            assert system.process.returncode == 130
    assert events[-1]["event"] == "summary"


def test_a_watched_configuration_on_a_mount_that_stops_answering_does_not_hold_up_the_end(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "server"
    folder.mkdir()
    with replaying(configuration(folder), tmp_path / "logs", "--watch") as system:
        system.read_until_up("/talker")
        with hung(folder):
            until(lambda: is_held_up(system.pid), "a read of the configuration")
            system.process.send_signal(signal.SIGINT)
            system.read_all()
            assert system.process.returncode == 130


def is_held_up(pid: int) -> bool:
    """Whether a thread of a process waits for the server of a mount."""
    waits = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        with contextlib.suppress(OSError):  # a thread that has ended since
            waits.append((task / "wchan").read_text())
    return any("fuse" in wait or "request_wait" in wait for wait in waits)

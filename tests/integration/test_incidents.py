"""Staged incidents, of real programs; `explain` names node, cause and place at once."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from play_launch.postmortem.source_lines import read_elf
from play_launch.postmortem.timeline import read_timeline
from tests.support.mounts import mounted
from tests.support.replay import COMMAND, replaying, run
from tests.support.waiting import until

ROOT = Path(__file__).resolve().parents[2]
CONTAINER = """version: 1
composable_node_loading: {{loading_timeout: 0.3 s}}
containers:
  - name: box
    container_type: isolated
    composable_nodes:
      - {{package: play_launch_demo, plugin: "play_launch_demo::Listener", name: bystander}}
      - package: {package}
        plugin: {plugin}
        name: {name}
        on_crash: ignore
        parameters: {{{parameters}}}
"""
PROCESS = """version: 1
duration: {duration}
stop: {{ask: 0.2 s, sigint: 0.2 s, sigterm: 0.2 s}}
nodes:
  - name: {name}
    command: {command}
"""
CRASHED = ("/victim", "crashed")
LEAK = """
import time
kept = []
while True:
    kept.append(bytearray(4 << 20))
    time.sleep(0.01)
"""
UNMATCHED = """version: 1
duration: 60 s
nodes:
  - {{name: camera, command: {camera}}}
  - {{name: detector, command: {detector}}}
"""
SPINNING = """
import rclpy
from rclpy.qos import ReliabilityPolicy, QoSProfile
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node({name!r})
qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.{policy})
kept = node.{make}
rclpy.spin(node)
"""


MONITOR = """
import time
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
rclpy.init()
node = rclpy.create_node("monitor")
publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
while publisher.get_subscription_count() == 0:
    time.sleep(0.02)
print("subscribed", flush=True)
for level, text in ((DiagnosticStatus.OK, "ok"), (DiagnosticStatus.ERROR, "no data"),
                    (DiagnosticStatus.OK, "fine again")):
    status = DiagnosticStatus(level=level, name="lidar: data", message=text, hardware_id="front")
    status.values = [KeyValue(key="rate", value="0.0"), KeyValue(key="", value="x")]
    array = DiagnosticArray(status=[status, DiagnosticStatus(level=b"\\0", name="gps")])
    array.header.stamp = node.get_clock().now().to_msg()
    publisher.publish(array)
    time.sleep(0.3)
print("fine again", flush=True)
rclpy.spin(node)
"""


def node(name: str, plugin: str, parameters: str = "", package: str = "play_launch_demo") -> str:
    return CONTAINER.format(
        package=package,
        plugin=f"{package}::{plugin}",
        name=name,
        parameters=parameters,
    )


def in_threads(config: str) -> str:
    """The same with nodes that are threads of their container: a crash ends all of it."""
    config = config.replace("container_type: isolated", "container_type: standard")
    return config.replace("        on_crash: ignore\n", "")


def process(name: str, *command: str, duration: str = "60 s") -> str:
    """A system that is over with its only process, or then."""
    return PROCESS.format(duration=duration, name=name, command=json.dumps(command))


def explain(bag: Path, *options: str) -> subprocess.CompletedProcess[str]:
    return run("explain", bag, *options)


def story(bag: Path, exit_code: int = 1) -> list[str]:
    """The first three lines of what a person reads."""
    result = explain(bag)
    assert result.returncode == exit_code, result.stdout + result.stderr
    return result.stdout.splitlines()[:3]


def written(folder: Path, config: str) -> Path:
    file = folder / "robot.yaml"
    file.write_text(config, encoding="utf-8")
    return file


def recorded(folder: Path, config: str, *wrapping: str) -> Path:
    """Run a system to its end, as a user runs it."""
    logs = folder / "logs"
    command = [*wrapping, str(COMMAND), "replay", str(written(folder, config)), "--quiet"]
    command += ["--log-dir", str(logs)]
    subprocess.run(command, check=False, capture_output=True, timeout=90)
    return logs / "latest" / "session.mcap"


def recorded_until(folder: Path, config: str, name: str, state: str) -> Path:
    """Run it until the node is in that state, and stop it."""
    with replaying(written(folder, config), folder / "logs") as replay:
        replay.read_until_states({name: state})
    return replay.bag


def source(text: str) -> str:
    """``crasher.cpp:31,`` for the line of that file that holds the text."""
    lines = (
        (ROOT / "container_native" / "demo" / "crasher.cpp")
        .read_text(encoding="utf-8")
        .splitlines()
    )
    (number,) = (number for number, line in enumerate(lines, 1) if text in line)
    return f"crasher.cpp:{number},"


def check(lines: list[str], *words: str) -> None:
    text = "\n".join(lines)
    for word in words:
        assert word in text, text


@pytest.fixture(scope="module")
def crashed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session with a crash."""
    folder = tmp_path_factory.mktemp("crashed")
    return recorded_until(folder, node("victim", "Crasher", "how: segv, after: 0.1"), *CRASHED)


def test_a_null_pointer_in_a_callback(crashed: Path) -> None:
    check(
        story(crashed),
        "/victim in /box crashed",
        "a null pointer was used",
        source("*reinterpret_cast<volatile int*>"),
        "libplay_launch_demo.so",
        "robot.yaml:",
    )
    (finding,) = json.loads(explain(crashed, "--json").stdout)["findings"]
    texts = [frame["function"] for frame in finding["frames"]]
    die = next(n for n, text in enumerate(texts) if "::die(" in text)
    # The call in die(), not the line after it.
    assert finding["lines"][die]["file"].endswith("crasher.cpp")
    assert finding["last_lines"] == []
    assert finding["away"] == [{"name": "/victim", "ns": None}]


def test_an_exception_that_a_node_in_python_does_not_catch(tmp_path: Path) -> None:
    program = tmp_path / "planner.py"
    program.write_text("import json\n\n\ndef plan():\n    json.loads('{')\n\n\nplan()\n")
    check(
        story(recorded(tmp_path, process("planner", sys.executable, str(program)))),
        "/planner died",
        "exited with status 1; uncaught exception json.decoder.JSONDecodeError: Expecting",
        f"Place: {program}:5, plan; command ",
    )


def test_a_program_whose_library_is_missing(tmp_path: Path) -> None:
    loader = "./planner: error while loading shared libraries: libmap.so: cannot open shared object"
    script = f"echo '{loader} file: No such file or directory' >&2; exit 127"
    check(
        story(recorded(tmp_path, process("planner", "sh", "-c", script))),
        "exited with status 127, after it wrote",
        "libmap.so",
        "that is, a library is missing.",
    )


def test_an_exception_that_a_program_in_cpp_does_not_catch(tmp_path: Path) -> None:
    throw = "import ctypes; ctypes.CDLL('libstdc++.so.6')._ZSt21__throw_runtime_errorPKc(b'no map')"
    check(
        story(recorded(tmp_path, process("planner", sys.executable, "-c", throw))),
        "/planner died",
        "(SIGABRT); uncaught exception std::runtime_error: no map.",
    )


def test_a_null_pointer_that_ends_the_whole_container(tmp_path: Path) -> None:
    config = node("victim", "Crasher", "how: segv, after: 0.1")
    config = in_threads(config)
    with replaying(written(tmp_path, config), tmp_path / "logs") as replay:
        replay.until(kind="exited")
    lines = story(replay.bag)
    check(lines, "/box died", "a null pointer was used", "in thread 'executor'")
    check(lines, source("*reinterpret_cast<volatile int*>"), "libplay_launch_demo.so")
    findings = json.loads(explain(replay.bag, "--json").stdout)["findings"]
    (finding,) = (each for each in findings if each["name"] == "/box")
    assert any("::die(" in frame["function"] for frame in finding["frames"])
    assert "libplay_launch_demo.so" in {each["name"] for each in finding["modules"]}
    assert {"/victim", "/bystander"} <= set(finding["hit"])
    (group,) = json.loads(run("crashes", replay.log_dir, "--json").stdout)["crashes"]
    assert any("die" in place for place in group["signature"]["frames"])


def test_an_exception_that_was_not_caught(tmp_path: Path) -> None:
    bag = recorded_until(
        tmp_path, node("victim", "Crasher", "how: deep_exception, after: 0.1"), *CRASHED
    )
    lines = story(bag)
    check(lines, "/victim in /box crashed", "std::runtime_error", "on purpose")
    check(lines, source("throw std::runtime_error(text"), "play_launch_demo::throw_here")
    assert "a callback of node /victim threw" in explain(bag).stdout


def test_a_memory_leak_up_to_the_limit(tmp_path: Path) -> None:
    command = ("sh", "-c", 'ulimit -v 200000; exec python3 -uSc "$0"', LEAK)
    bag = recorded(tmp_path, process("leaker", *command))
    check(story(bag), "/leaker died", "MemoryError", "it got no more memory", "robot.yaml:5")


def test_a_slow_constructor(tmp_path: Path) -> None:
    bag = recorded_until(
        tmp_path, node("engine", "SlowConstructor", "seconds: 1.5"), "/engine", "loaded"
    )
    # On a busy machine the bystander can be slow as well.
    lines = explain(bag).stdout.splitlines()
    check(lines, "/engine in /box was slow to construct", "of it on CPU")
    check(lines, "play_launch_demo::SlowConstructor", "robot.yaml:")


def test_a_missing_library(tmp_path: Path) -> None:
    bag = recorded_until(
        tmp_path,
        node("gone", "MissingLibrary", package="play_launch_broken"),
        "/gone",
        "load failed",
    )
    check(
        story(bag),
        "/gone in /box failed to load",
        "a library is missing",
        "libplay_launch_not_there.so",
        "package play_launch_broken",
    )


def test_a_parameter_of_the_wrong_type(tmp_path: Path) -> None:
    bag = recorded_until(tmp_path, node("typed", "Crasher", "after: soon"), "/typed", "load failed")
    check(
        story(bag),
        "/typed in /box failed to load",
        "a parameter has the wrong type",
        "'after'",
        "play_launch_demo::Crasher",
        "robot.yaml:",
    )


def test_an_error_in_diagnostics(tmp_path: Path) -> None:
    monitor = tmp_path / "monitor.py"
    monitor.write_text(MONITOR)
    config = tmp_path / "monitored.yaml"
    command = json.dumps([sys.executable, str(monitor)])
    config.write_text(PROCESS.format(name="monitor", duration="60 s", command=command))
    with replaying(config, tmp_path / "log") as replay:
        # What it reports is recorded once its publisher is known.
        replay.read_until(lambda event: "subscribed" in event.get("text", ""), "its recorder")
        replay.read_until(lambda event: "fine again" in event.get("text", ""), "its reports")
    done = run("explain", tmp_path / "log/latest", code=1).stdout
    assert "lidar: data (front) was reported as ERROR " in done
    assert "  Cause: no data, for " in done


def test_a_node_that_is_deaf_to_its_stop(tmp_path: Path) -> None:
    command = ("sh", "-c", "trap '' INT TERM; echo deaf; while :; do sleep 0.1; done")
    bag = recorded(tmp_path, process("deaf", *command, duration="1 s"))
    check(story(bag), "/deaf did not stop when it was asked to", "SIGKILL", "trap", "robot.yaml:5")


def test_a_full_disk(tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    config = process("mapper", "sh", "-c", f"head -c 2000000 /dev/zero > {disk}/map.pgm")
    small = mounted(f"mount -t tmpfs -o size=1m tmpfs {disk}")
    bag = recorded(tmp_path, config, *small)
    check(story(bag), "/mapper died", "No space left on device", "the disk is full", "map.pgm")


def test_a_full_disk_below_the_recording(tmp_path: Path) -> None:
    disk, kept = tmp_path / "disk", tmp_path / "kept"
    disk.mkdir()
    fill = f"head -c 5000000 /dev/zero > {disk}/fill; echo full; sleep 4; rm {disk}/fill; sleep 1"
    config = written(tmp_path, process("filler", "sh", "-c", fill))
    small = mounted(f"mount -t tmpfs -o size=1m tmpfs {disk}")
    run = f'"$0" replay "$1" --log-dir {disk}/logs; cp -r {disk}/logs {kept}'
    command = [*small, "sh", "-c", run, str(COMMAND), str(config)]
    subprocess.run(command, check=False, capture_output=True, timeout=90)
    lines = story(kept / "latest")
    check(lines, "The recording was interrupted", "No space left on device", "the disk is full")
    check(lines, str(disk))


STARVED = """version: 1
record: {{sampling: {{period: 200 ms}}, ros: false}}
nodes:
  - name: hog
    command: {hog}
  - name: camera
    command: {camera}
"""
SPIN = """
import contextlib, os
os.sched_setaffinity(0, {{{core}}})
with contextlib.suppress(OSError):
    os.nice({nice})
    # Where sessions have weights of their own, niceness counts only within one.
    with open("/proc/self/autogroup", "w") as weight:
        weight.write("{nice}")
while True:
    pass
"""


def spinning(core: int, nice: int) -> str:
    """A program that wants all of a core, and no other one."""
    return json.dumps([sys.executable, "-Sc", SPIN.format(core=core, nice=nice)])


def most_used(recording: Path) -> float:
    """Percent of a core that one process got, on average."""
    totals = read_timeline(recording).samples.totals().values()
    return max(each.mean_cpu or 0.0 for each in totals)


@pytest.mark.skipif(not Path("/proc/pressure/cpu").exists(), reason="no pressure stall information")
def test_what_starves_others_of_cpu_time(tmp_path: Path) -> None:
    # Both want the same core. With privileges one gets more of it on a busy machine.
    core = max(os.sched_getaffinity(0))
    config = STARVED.format(hog=spinning(core, -7), camera=spinning(core, 2))
    with replaying(written(tmp_path, config), tmp_path / "logs") as replay:
        recording = replay.log_dir / "latest"

        def is_seen() -> bool:
            return "starved others of CPU time" in explain(recording).stdout

        replay.until(event="process")
        try:
            until(is_seen, "pressure that lasts", limit=90.0)
        except AssertionError:
            if most_used(recording) < 40.0:
                pytest.skip("other programs take so much of the core that none of ours is a hog")
            raise
    lines = story(replay.bag)
    check(lines, "/hog starved others of CPU time", "% of a core for", "/camera (")
    check(lines, "robot.yaml:4", "sched_setaffinity")
    (finding,) = json.loads(explain(replay.bag, "--json").stdout)["findings"]
    assert (finding["name"], finding["hit"]) == ("/hog", ["/camera"])


def test_a_session_without_an_incident(tmp_path: Path) -> None:
    bag = recorded_until(tmp_path, node("talker", "Talker"), "/talker", "loaded")
    assert story(bag, 0) == [f"Nothing was wrong. {explain(bag).stdout.split('. ', 1)[1].strip()}"]
    assert json.loads(explain(bag, "--json").stdout)["findings"] == []


def test_the_libraries_of_the_backtrace_are_recorded(crashed: Path) -> None:
    (finding,) = json.loads(explain(crashed, "--json").stdout)["findings"]
    modules = {each["name"]: each for each in finding["modules"]}
    assert modules.keys() == {frame["library"] for frame in finding["frames"]} - {""}
    for module in modules.values():
        elf = read_elf(Path(module["path"]))
        assert elf is not None
        assert module["build_id"] == elf.build_id


def test_crashes_are_grouped_and_sessions_compared(crashed: Path, tmp_path: Path) -> None:
    good = recorded_until(tmp_path, node("victim", "Crasher"), "/victim", "loaded")
    groups = json.loads(run("crashes", crashed.parent, "--json").stdout)["crashes"]
    assert [(group["count"], group["nodes"]) for group in groups] == [(1, ["/victim"])]
    worse = run("compare", good, crashed)
    assert (worse.returncode, worse.stderr) == (1, "")
    assert f"new crash: {groups[0]['id']} SIGSEGV" in worse.stdout
    better = run("compare", crashed, good)
    assert better.returncode == 0
    assert "gone crash" in better.stdout


def test_publishers_and_subscriptions_that_do_not_match(tmp_path: Path) -> None:
    publish, subscribe = (
        "create_publisher(String, '/image', qos)",
        "create_subscription(String, '/image', print, qos)",
    )
    camera = SPINNING.format(name="camera", policy="BEST_EFFORT", make=publish)
    detector = SPINNING.format(name="detector", policy="RELIABLE", make=subscribe)
    commands = {
        name: json.dumps([sys.executable, "-c", text])
        for name, text in (("camera", camera), ("detector", detector))
    }
    config = written(tmp_path, UNMATCHED.format(**commands))
    with replaying(config, tmp_path / "logs") as replay:
        warned = set()

        def both_warned(event: dict[str, Any]) -> bool:
            if "incompatible QoS" in event.get("text", ""):
                warned.add(event["process"])
            return len(warned) == 2

        replay.read_until(both_warned, "the warnings of both")
    check(
        story(replay.bag),
        "QoS on /image is incompatible, so messages are lost, from ",
        "Cause: reliability: /detector requests more than is offered; "
        "/camera offers less than is requested",
    )

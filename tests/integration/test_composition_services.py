"""The container seen by a program that knows nothing of play-launch, and a component of a user."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from composition_interfaces.srv import LoadNode
from play_launch_msgs.msg import ComponentEvent
from rcl_interfaces.msg import Log, Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from std_msgs.msg import Float64, String

from play_launch.config.load import load_config
from tests.support.container import running_container
from tests.support.launch import needs_launch
from tests.support.replay import is_, replaying, run
from tests.support.ros import LATCHED, Probe

DEMO = "play_launch_demo"
CONTAINER = "/container"


def parameter(name: str, kind: int, **value: object) -> Parameter:
    return Parameter(name=name, value=ParameterValue(type=kind, **value))


@pytest.fixture
def probe() -> Iterator[Probe]:
    with Probe() as probe:
        yield probe


@pytest.fixture(
    params=[(), ("--use_multi_threaded_executor",)], ids=["standard", "mt"], name="container"
)
def _container(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Path]:
    log = tmp_path / "container.log"
    with running_container(*request.param, log=log) as process:
        yield log
        assert process.poll() is None, f"the container died: {log.read_text()}"


@pytest.mark.usefixtures("container")
def test_nodes_are_loaded_listed_and_unloaded(probe: Probe) -> None:
    talker = probe.load("Talker", node_name="speaker", node_namespace="/front")
    assert (talker.success, talker.full_node_name) == (True, "/front/speaker"), talker
    listener = probe.load("Listener")
    assert (listener.success, listener.full_node_name) == (True, "/listener"), listener
    assert dict(probe.nodes()) == {
        "/front/speaker": talker.unique_id,
        "/listener": listener.unique_id,
    }

    gone = probe.unload(talker.unique_id)
    assert gone.success, gone.error_message
    assert dict(probe.nodes()) == {"/listener": listener.unique_id}

    again = probe.unload(talker.unique_id)
    assert not again.success
    assert str(talker.unique_id) in again.error_message


@pytest.mark.usefixtures("container")
def test_a_plain_listener_hears_the_talker(probe: Probe) -> None:
    assert probe.load(
        "Talker",
        parameters=[parameter("rate", ParameterType.PARAMETER_DOUBLE, double_value=50.0)],
    ).success
    heard = [message.data for message in probe.collect(String, "/chatter", count=5)]
    counts = [int(text.rsplit(": ", 1)[1]) for text in heard]
    assert counts == list(range(counts[0], counts[0] + 5))


@pytest.mark.usefixtures("container")
def test_what_the_request_says_arrives_in_the_node_unchanged(probe: Probe) -> None:
    parameters = [
        parameter("flag", ParameterType.PARAMETER_BOOL, bool_value=True),
        parameter("count", ParameterType.PARAMETER_INTEGER, integer_value=-(2**63)),
        parameter("gain", ParameterType.PARAMETER_DOUBLE, double_value=1.0),
        parameter("word", ParameterType.PARAMETER_STRING, string_value="true"),
        parameter("bytes", ParameterType.PARAMETER_BYTE_ARRAY, byte_array_value=[b"\x00", b"\xff"]),
        parameter("flags", ParameterType.PARAMETER_BOOL_ARRAY, bool_array_value=[True, False]),
        parameter(
            "counts", ParameterType.PARAMETER_INTEGER_ARRAY, integer_array_value=[1, 2**63 - 1]
        ),
        parameter("gains", ParameterType.PARAMETER_DOUBLE_ARRAY, double_array_value=[0.1, 1e300]),
        parameter(
            "words", ParameterType.PARAMETER_STRING_ARRAY, string_array_value=["1", 'ü "q"', ""]
        ),
    ]
    answer = probe.load(
        "Echo",
        node_name="parrot",
        node_namespace="/zoo",
        remap_rules=["plain_topic:=/other/topic"],
        log_level=Log.WARN[0] if isinstance(Log.WARN, bytes) else Log.WARN,
        parameters=parameters,
        extra_arguments=[
            parameter("use_intra_process_comms", ParameterType.PARAMETER_BOOL, bool_value=True),
            parameter("of_my_own", ParameterType.PARAMETER_STRING, string_value="kept"),
        ],
    )
    assert answer.success, answer.error_message
    told = json.loads(probe.collect(String, "/zoo/parrot/echo", qos=LATCHED)[0].data)
    assert told["full_name"] == "/zoo/parrot"
    assert told["topic"] == "/other/topic"
    assert told["log_level"] == 30
    assert told["intra_process"] is True
    assert told["extra_arguments"]["of_my_own"] == [4, "kept"]
    assert told["parameters"] == {
        "flag": [1, True],
        "count": [2, -(2**63)],
        "gain": [3, "1"],
        "word": [4, "true"],
        "bytes": [5, [0, 255]],
        "flags": [6, [True, False]],
        "counts": [7, [1, 2**63 - 1]],
        "gains": [8, ["0.10000000000000001", "1.0000000000000001e+300"]],
        "words": [9, ["1", 'ü "q"', ""]],
    }

    answer = probe.call(
        GetParameters,
        "/zoo/parrot/get_parameters",
        GetParameters.Request(names=[each.name for each in parameters]),
    )
    assert [value.type for value in answer.values] == list(range(1, 10))
    assert answer.values == [each.value for each in parameters]


@pytest.mark.usefixtures("container")
def test_parameters_can_be_listed_and_set_like_those_of_any_node(probe: Probe) -> None:
    assert probe.load("Talker").success
    listed = probe.call(ListParameters, "/talker/list_parameters", ListParameters.Request())
    assert {"rate", "text"} <= set(listed.result.names)
    answer = probe.call(
        SetParameters,
        "/talker/set_parameters",
        SetParameters.Request(
            parameters=[
                parameter("text", ParameterType.PARAMETER_STRING, string_value="changed"),
                parameter("text", ParameterType.PARAMETER_INTEGER, integer_value=1),
                parameter("not_there", ParameterType.PARAMETER_INTEGER, integer_value=1),
            ]
        ),
    )
    good, wrong_type, unknown = answer.results
    assert good.successful
    assert not wrong_type.successful
    assert "text" in wrong_type.reason
    assert not unknown.successful
    assert "not_there" in unknown.reason


@pytest.mark.usefixtures("container")
@pytest.mark.parametrize(
    ("prefixes", "depth", "names"),
    [
        ([], 1, {"arm"}),
        ([], 2, {"arm", "arm.right"}),
        (["arm"], 1, {"arm", "arm.right"}),
        (["arm"], 2, {"arm", "arm.right", "arm.left.length"}),
        (["arm.left"], ListParameters.Request.DEPTH_RECURSIVE, {"arm.left.length"}),
        (["ar", "arm.right"], 1, {"arm.right"}),
    ],
)
def test_parameters_are_listed_down_to_a_depth_below_prefixes(
    probe: Probe, prefixes: list[str], depth: int, names: set[str]
) -> None:
    given = [
        parameter(name, ParameterType.PARAMETER_INTEGER, integer_value=1)
        for name in ("arm", "arm.right", "arm.left.length")
    ]
    assert probe.load("Echo", parameters=given).success
    request = ListParameters.Request(prefixes=prefixes, depth=depth)
    result = probe.call(ListParameters, "/echo/list_parameters", request).result
    assert {name for name in result.names if name.startswith("arm")} == names
    assert set(result.prefixes) == {name.rpartition(".")[0] for name in result.names} - {""}


FAILURES: list[tuple[str, dict[str, Any], str]] = [
    ("ThrowingConstructor", {}, "no such camera"),
    ("Talker", {"node_namespace": "not absolute!"}, "not absolute!"),
    ("Talker", {"node_name": "taken"}, "/taken"),
]
"""Of each way to fail there is one in tests/container/test_loading."""


@pytest.mark.usefixtures("container")
def test_failures_have_reasons_and_the_container_lives_on(probe: Probe) -> None:
    events = probe.listen(ComponentEvent, f"{CONTAINER}/_container/component_events", LATCHED)
    first = probe.load("Talker", node_name="taken")
    assert first.success
    for plugin, fields, reason in FAILURES:
        answer = probe.load(plugin, **fields)
        assert not answer.success
        assert reason in answer.error_message
    probe.spin_until(
        lambda: sum(e.event_type == ComponentEvent.LOAD_FAILED for e in events) >= len(FAILURES),
        10,
        "an event per failure",
    )
    for event in events:
        assert (event.error_message != "") == (event.event_type == ComponentEvent.LOAD_FAILED)
    assert dict(probe.nodes()) == {"/taken": first.unique_id}
    assert probe.load("Listener").success


@pytest.mark.usefixtures("container")
def test_a_slow_constructor_blocks_no_other_node(probe: Probe) -> None:
    slow = probe.start_call(
        LoadNode,
        f"{CONTAINER}/_container/load_node",
        LoadNode.Request(
            package_name=DEMO,
            plugin_name=f"{DEMO}::SlowConstructor",
            parameters=[parameter("seconds", ParameterType.PARAMETER_DOUBLE, double_value=3600.0)],
        ),
    )
    talker = probe.load("Talker")
    assert talker.success
    assert dict(probe.nodes()) == {"/talker": talker.unique_id}
    assert probe.unload(talker.unique_id).success
    assert not slow.done()


GUESTS = """\
version: 1
name: host
environment: {ROS_AUTOMATIC_DISCOVERY_RANGE: LOCALHOST}
containers:
  - name: container
    container_type: isolated
    composable_nodes:
      - {package: play_launch_demo, plugin: "play_launch_demo::Listener", name: listener}
"""


def test_what_others_load_is_seen_and_not_supervised(tmp_path: Path, probe: Probe) -> None:
    config = tmp_path / "host.yaml"
    config.write_text(GUESTS)
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_until_up("/listener")
        guest = probe.load("Talker", node_name="guest")
        replay.read_until(
            is_(event="component", full_node_name="/guest", kind="loaded"), "the guest"
        )
        rows = {row["name"]: row for row in json.loads(replay.ask("ps", "--json", code=0).stdout)}
        assert list(rows) == ["/container", "/listener", "/guest"]
        assert (rows["/guest"]["state"], rows["/guest"]["reason"]) == (
            "loaded",
            "by another program",
        )
        assert [row["name"] for row in rows.values() if row["is_guest"]] == ["/guest"]
        for words in (("reload", "/guest"), ("param", "get", "guest", "rate")):
            assert "loaded by another program" in replay.ask(*words).stderr
        os.kill(rows["/guest"]["pid"], signal.SIGSEGV)
        replay.until(event="component", kind="crashed")
        assert "/guest" not in replay.ask("ps", code=0).stdout
        again = probe.load("Talker", node_name="guest")
        assert again.unique_id != guest.unique_id
        os.kill(replay.pids()["/guest"], signal.SIGSEGV)
        replay.until(event="component", kind="crashed", unique_id=again.unique_id)
        again = probe.load("Talker", node_name="guest")
        probe.load("Echo", node_name="other")
        probe.unload(again.unique_id)
        replay.ask("restart", "/container", code=0)
        names = [row["name"] for row in json.loads(replay.ask("ps", "--json", code=0).stdout)]
        assert names == ["/container", "/listener"], "it is gone with its container"
        replay.process.send_signal(signal.SIGINT)
        replay.read_all()
    found = json.loads(run("explain", "--json", tmp_path / "logs" / "latest", code=1).stdout)
    assert [(each["name"], each["kind"]) for each in found["findings"]] == [("/guest", "crashed")]
    assert "SIGSEGV" in found["findings"][0]["cause"]
    assert "crashed 2 times" in found["findings"][0]["says"]
    assert "Crashes:   2 (/guest 2)" in run("info", tmp_path / "logs" / "latest").stdout
    run("rerun", tmp_path / "logs" / "latest", code=0)


ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "my_robot"
GUIDE = ROOT / "docs" / "components.md"


def build(source: Path, tmp_path: Path) -> Path:
    tools = Path(sys.executable).parent
    install = tmp_path / "install"
    for command in (
        [
            tools / "cmake",
            "-G",
            "Ninja",
            f"-DCMAKE_MAKE_PROGRAM={tools / 'ninja'}",
            f"-DCMAKE_PREFIX_PATH={sys.prefix}",
            f"-DCMAKE_INSTALL_PREFIX={install}",
            "-B",
            tmp_path / "build",
            "-S",
            source,
        ],
        [tools / "cmake", "--build", tmp_path / "build"],
        [tools / "cmake", "--install", tmp_path / "build"],
    ):
        result = subprocess.run(
            [str(part) for part in command], check=False, capture_output=True, text=True
        )
        assert result.returncode == 0, result.stdout + result.stderr
    return install


def test_the_guide_shows_the_example_as_it_is() -> None:
    cmake = (EXAMPLE / "CMakeLists.txt").read_text().strip()
    blocks = re.findall(r"```cmake\n(.*?)```", GUIDE.read_text(), flags=re.DOTALL)
    assert [block.strip() for block in blocks] == [cmake]


TWO_LIBRARIES = """
cmake_minimum_required(VERSION 3.22)
project(two_libraries LANGUAGES CXX)
find_package(play_launch_container REQUIRED)
play_launch_add_components(first_components node.cpp PLUGINS two::A two::B)
add_subdirectory(more)
"""
ONE_MORE = "play_launch_add_components(second_components ../node.cpp PLUGINS two::C)\n"


def test_the_libraries_of_a_package_add_up_in_the_index(tmp_path: Path) -> None:
    source = tmp_path / "two_libraries"
    (source / "more").mkdir(parents=True)
    (source / "CMakeLists.txt").write_text(TWO_LIBRARIES)
    (source / "more" / "CMakeLists.txt").write_text(ONE_MORE)
    (source / "node.cpp").touch()
    for _ in range(2):  # configured again, nothing is there twice
        install = build(source, tmp_path)
        index = install / "share" / "ament_index" / "resource_index"
        assert (index / "play_launch_components" / "two_libraries").read_text().splitlines() == [
            "two::A;lib/libfirst_components.so",
            "two::B;lib/libfirst_components.so",
            "two::C;lib/libsecond_components.so",
        ]
        assert (index / "packages" / "two_libraries").is_file()


@needs_launch
def test_the_launch_file_of_the_example_robot_says_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install = build(EXAMPLE, tmp_path)
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join([str(install), sys.prefix]))
    dumped = tmp_path / "dumped.yaml"
    words = ["--container-type", "isolated", "-o", dumped]
    run("dump", "my_robot", "robot.launch.py", *words, code=0)
    made, meant = map(load_config, (dumped, EXAMPLE / "robot.yaml"))
    for each, other in zip(
        made.containers[0].composable_nodes, meant.containers[0].composable_nodes, strict=True
    ):
        assert (each.key, each.plugin, each.parameters) == (
            other.key,
            other.plugin,
            other.parameters,
        )
    for one, two in zip(made.nodes, meant.nodes, strict=True):
        assert (one.full_name, one.executable, one.on_exit) == (
            two.full_name,
            two.executable,
            two.on_exit,
        )
        assert (one.parameters, one.on_exit) == (two.parameters, two.on_exit)
    assert made.managed == meant.managed


DRIVER_FAILED = is_(event="process", kind="exited", name="/driver", exit_code=1)


def test_the_example_robot_built_outside_the_tree_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = tmp_path / "my_robot"
    shutil.copytree(EXAMPLE, source)
    install = build(source, tmp_path)
    paths = [str(install), *filter(None, [os.environ.get("AMENT_PREFIX_PATH")])]
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(paths))
    monkeypatch.chdir(source)
    done = run("check", "two_computers.yaml", code=0).stdout
    assert "  base: 1 process\n  head: 1 container with 2 nodes, 1 process" in done
    with (
        replaying(source / "robot.yaml", tmp_path / "logs", "fails_after:=120") as replay,
        Probe() as probe,
    ):
        replay.read_until_up("/range_filter", "/battery", "/driver", "/planner")
        replay.ask("wait", "--for", "active", code=0)
        assert probe.collect(Float64, "/voltage")[0].data == 12.6
        assert 0.0 < probe.collect(Float64, "/speed")[0].data <= 1.0
        if not any(map(DRIVER_FAILED, replay.seen)):
            replay.read_until(DRIVER_FAILED, "the driver's failure")
        replay.ask("signal", "SEGV", "/range_filter", code=0)
        replay.read_until(is_(event="node", node="/range_filter", state="loaded"), "a reload")
        replay.process.send_signal(signal.SIGTERM)
        replay.read_all()
    said = run("explain", tmp_path / "logs" / "latest").stdout
    assert "/driver died" in said
    assert "OSError: the range finder does not answer" in said
    assert "/range_filter in /sensing crashed" in said

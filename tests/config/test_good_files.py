"""What a configuration means once it is accepted."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from play_launch.config.description import describe
from play_launch.config.load import load_config, parse_config
from play_launch.config.model import (
    ContainerType,
    OnExit,
    Output,
    ParameterConfig,
    ReplayConfig,
    RestartLimits,
    StopLimits,
    WebConfig,
)

GOOD = Path(__file__).parent / "good"
FULL = GOOD / "full.yaml"


def values(parameters: tuple[ParameterConfig, ...]) -> dict[str, object]:
    return {parameter.name: parameter.value.value for parameter in parameters}


@pytest.fixture(scope="module")
def full() -> ReplayConfig:
    return load_config(FULL)


def test_top_level(full: ReplayConfig) -> None:
    assert full.name == "full_demo"
    assert full.source == FULL
    assert full.text == FULL.read_bytes()
    common = GOOD / "params" / "common.yaml"
    assert [(file.path, file.text) for file in full.parameter_files] == [
        (common, common.read_bytes())
    ]
    assert full.duration == 120.0
    assert full.log_dir == GOOD / "logs"
    assert full.graph_daemon
    tokens = GOOD / "tokens"
    hosts = ("robot.example",)
    assert full.web == WebConfig(bind="::1", port=0, token_file=tokens, allow_host=hosts)
    assert full.environment == {"RCUTILS_COLORIZED_OUTPUT": "1", "GREETING": "on"}
    assert full.stop == StopLimits(ask=0.0, sigint=0.5, sigterm=1.5)


def test_containers(full: ReplayConfig) -> None:
    front, back = full.containers
    assert (front.full_name, back.full_name) == ("/sensing/front", "/back")
    assert (front.container_type, front.thread_num) == (ContainerType.MT, 3)
    assert (back.container_type, back.thread_num) == (ContainerType.STANDARD, None)
    assert (front.loading_timeout, back.loading_timeout) == (20.0, 3600.0)
    assert (front.probe_timeout, back.probe_timeout) == (300.0, 2.5)
    assert front.log_level == "debug"
    assert front.ros_arguments == ("--log-level", "rcl:=warn")
    assert front.environment == {"RCUTILS_COLORIZED_OUTPUT": "1", "GREETING": "hello"}
    assert back.environment == full.environment


def test_a_restart_of_a_container_overrides_key_by_key(full: ReplayConfig) -> None:
    front, back = full.containers
    assert front.restart == RestartLimits(max_restarts=1, within=120.0, initial=1.0, maximum=5.0)
    assert back.restart == RestartLimits(max_restarts=9, within=120.0, initial=1.0, maximum=30.0)


def test_composable_nodes(full: ReplayConfig) -> None:
    camera = full.containers[0].composable_nodes[0]
    assert (camera.package, camera.plugin) == ("demo", "demo::Camera")
    assert camera.declared_full_name == "/sensing/camera"
    assert camera.remappings == (
        ("image", "~/image"),
        ("info", "/camera/info"),
        ("/tf", "tf"),
    )
    assert values(camera.extra_arguments) == {"use_intra_process_comms": True}
    assert camera.log_level == "warn"
    assert camera.line == 21


def test_parameters_of_later_sources_and_sections_win(full: ReplayConfig) -> None:
    camera = full.containers[0].composable_nodes[0]
    assert values(camera.parameters) == {
        "use_sim_time": True,
        "rate": 2.0,
        "origin": "inline",
        "gains.p": 1,
        "gains.i": (1.0, 2.0),
    }


def test_nodes_without_a_name_keep_their_own_and_have_labels_of_their_own(
    full: ReplayConfig,
) -> None:
    unnamed = full.containers[0].composable_nodes[1:]
    assert {node.name for node in unnamed} == {""}
    assert [node.namespace for node in unnamed] == ["", "/sensing", ""]
    assert [node.declared_full_name for node in unnamed] == [
        "/[demo::Filter]",
        "/sensing/[demo::Filter]",
        "/[demo::Filter:2]",
    ]


def test_processes(full: ReplayConfig) -> None:
    listener, sleeper = full.nodes
    assert (listener.package, listener.executable) == ("demo_nodes_py", "listener")
    assert listener.command is None
    assert listener.full_name == "/sensing/deep/front"
    assert listener.arguments == ("--fast",)
    assert values(listener.parameters)["rate"] == 1.0  # `/sensing/*` is one level only
    assert listener.environment["EXTRA"] == "yes"
    assert listener.on_exit is OnExit.RESTART
    assert listener.prefix == ("gdb", "-ex", "set print on", "--args")
    assert listener.cwd == GOOD / "params"
    assert listener.emulate_tty
    assert listener.output is Output.LOG
    assert listener.restart == RestartLimits(max_restarts=0)
    assert sleeper.command == ("/usr/bin/env", "sleep", "1")
    assert (sleeper.name, sleeper.full_name) == ("", "/[env]")
    assert sleeper.on_exit is OnExit.IGNORE
    assert (sleeper.prefix, sleeper.cwd, sleeper.emulate_tty) == ((), None, False)
    assert sleeper.output is Output.BOTH


def test_defaults() -> None:
    text = b"version: 1\ncontainers:\n  - name: main\n"
    config = parse_config(text, Path("somewhere/demo.yaml"))
    assert config.name == "demo"
    assert (config.duration, config.log_dir, config.environment) == (None, None, {})
    assert not config.graph_daemon
    assert config.web is None
    assert config.stop == StopLimits(ask=3.0, sigint=2.0, sigterm=2.0)
    (main,) = config.containers
    assert (main.namespace, main.full_name) == ("/", "/main")
    assert main.container_type is ContainerType.STANDARD
    assert main.loading_timeout == 10.0
    assert main.probe_timeout == 60.0
    assert main.restart == RestartLimits(5, 60.0, 0.1, 30.0)


def test_nothing_can_be_changed(full: ReplayConfig) -> None:
    with pytest.raises(AttributeError):
        full.name = "other"  # type: ignore[misc]
    with pytest.raises(TypeError):
        full.environment["A"] = "b"  # type: ignore[index]


def test_the_description_is_json(full: ReplayConfig) -> None:
    text = json.dumps(describe(full), allow_nan=False)
    described = json.loads(text)
    assert described["containers"][0]["composable_nodes"][0]["parameters"]["rate"] == {
        "type": "double",
        "value": 2.0,
    }
    assert described["containers"][0]["restart"]["backoff"] == {"initial": 1.0, "maximum": 5.0}
    assert described["nodes"][1]["command"] == ["/usr/bin/env", "sleep", "1"]


def test_the_description_says_everything(full: ReplayConfig) -> None:
    described = describe(full)
    fields = set(full.__struct_fields__) - {"text"}
    assert fields <= described.keys()
    for one, shown in zip(full.nodes, json.loads(json.dumps(described["nodes"])), strict=True):
        assert set(one.__struct_fields__) <= shown.keys()


def test_doubles_that_json_does_not_know() -> None:
    parameters = b"{a: [.nan, .inf, -.inf], b: !!binary AAE=}"
    text = b"version: 1\nnodes:\n- {command: [x], parameters: " + parameters + b"}\n"
    described = describe(parse_config(text, Path("demo.yaml")))
    shown = json.loads(json.dumps(described, allow_nan=False))["nodes"][0]["parameters"]
    assert shown["a"]["value"] == [".nan", ".inf", "-.inf"]
    assert shown["b"] == {"type": "byte_array", "value": "AAE="}

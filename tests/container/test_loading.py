"""Loading under load: slow constructors, many at once, over and over."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import Any

import psutil
import pytest
from play_launch_msgs.msg import ComponentEvent, ControlUnload

from tests.container.conftest import prefix_of
from tests.support.control_peer import Container, StartContainer
from tests.support.isolated import ALL_MODES, MODES, children, only_these_remain, start, survives
from tests.support.ros import Probe
from tests.support.waiting import until

LOADED, UNLOADED, LOAD_FAILED = (
    ComponentEvent.LOADED,
    ComponentEvent.UNLOADED,
    ComponentEvent.LOAD_FAILED,
)


@pytest.mark.parametrize("mode", ALL_MODES)
def test_many_loads_at_once(spawn: StartContainer, package: str, mode: str) -> None:
    container = start(spawn, mode)
    names = [f"talker_{i}" for i in range(30)]
    attempts = {container.load("Talker", package=package, node_name=name) for name in names}
    loaded: dict[int, ComponentEvent] = {}
    while len(loaded) < len(attempts):
        event = container.event(LOADED)
        loaded[event.attempt] = event
    assert set(loaded) == attempts
    assert len({event.unique_id for event in loaded.values()}) == len(attempts)
    nodes = container.status().nodes
    assert {node.full_node_name for node in nodes} == {f"/{name}" for name in names}
    if mode in MODES:
        assert children(container) == {event.pid for event in loaded.values()}
        assert len(children(container)) == len(attempts)
    assert container.shut_down() == 0, container.log.read_text()


Failure = tuple[str, dict[str, Any], list[str]]
FAILURES: list[Failure] = [
    ("Absent", {"package": "no_such_package"}, ["'no_such_package' is not installed"]),
    ("Absent", {}, ["Absent", "{package}::Talker"]),
    ("ThrowingConstructor", {}, ["camera"]),
    ("Talker", {"parameters": {"rate": "fast"}}, ["rate"]),
    ("Talker", {"extra_arguments": {"use_intra_process_comms": 1}}, ["a boolean"]),
    ("Talker", {"remap_rules": ["chatter"]}, ["chatter"]),
    ("Talker", {"node_name": "1st"}, ["1st"]),
    ("Talker", {"node_namespace": "not absolute!"}, ["not absolute!"]),
]
"""Of components of both kinds: plugin, request, what is reported."""
FAILURES_OF: dict[str, list[Failure]] = {
    "play_launch_demo": [
        ("Talker", {"package": ""}, ["no package"]),
        ("MissingLibrary", {"package": "play_launch_broken"}, ["libplay_launch_not_there.so"]),
        ("MissingSymbol", {"package": "play_launch_broken"}, ["undefined symbol", "nowhere"]),
        ("NotInTheLibrary", {"package": "play_launch_broken"}, ["libplay_launch_demo.so"]),
        ("ThrowingConstructor", {"parameters": {"standard_exception": False}}, ["int"]),
        ("Talker", {"parameters": {"rate": -1.0}}, ["rate", "-1"]),
        ("Talker", {"log_level": 60}, ["60"]),
    ],
    "test_components": [
        ("NeverRegistered", {}, ["registers only", "RCLCPP_COMPONENTS_REGISTER_NODE"]),
        ("Unresolved", {}, ["cannot load library", "defined_nowhere"]),
    ],
}
INDEX = {"play_launch_demo": "play_launch_components", "test_components": "rclcpp_components"}


def index_in(prefix: Path, package: str) -> tuple[Path, dict[str, str]]:
    """A folder for components like those of a package, and the variables to find them first."""
    index = prefix / "share" / "ament_index" / "resource_index" / INDEX[package]
    index.mkdir(parents=True)
    paths = filter(None, [str(prefix), os.environ.get("AMENT_PREFIX_PATH"), sys.prefix])
    return index, {"AMENT_PREFIX_PATH": os.pathsep.join(paths)}


@pytest.mark.parametrize("mode", ["standard", "isolated"])
def test_failures_have_reasons_and_leave_nothing(
    spawn: StartContainer, package: str, mode: str, probe: Probe
) -> None:
    container = start(spawn, mode)
    with survives(container):
        failures = [*FAILURES, *FAILURES_OF[package]]
        cases = {
            container.load(plugin, **{"package": package, **fields}): reasons
            for plugin, fields, reasons in failures
        }
        for _ in failures:
            event = container.event(LOAD_FAILED)
            for reason in cases.pop(event.attempt):
                assert reason.format(package=package) in event.error_message
            assert event.signal == 0
        if mode == "isolated":
            assert only_these_remain(container)
        assert container.status().crashes == 0
        container.loaded("Talker", package=package)
        names = probe.node.get_node_names
        probe.spin_until(
            lambda: "talker" in names() and "throwing_constructor" not in names(),
            30.0,
            "the graph without the half of a node",
        )


def test_a_missing_library_and_a_damaged_index(
    spawn: StartContainer, package: str, tmp_path: Path
) -> None:
    index, environment = index_in(tmp_path, package)
    (index / "gone").write_text("gone::Node;lib/libgone.so\n")
    (index / "damaged").write_text("damaged::Node\n")
    container = start(spawn, environment=environment)
    with survives(container):
        container.load("gone::Node", package="gone")
        failed = container.event(LOAD_FAILED)
        assert f"cannot load library {tmp_path}/lib/libgone.so" in failed.error_message
        container.load("damaged::Node", package="damaged")
        assert "is not of the form class;library" in container.event(LOAD_FAILED).error_message
        container.loaded("Talker", package=package)


@pytest.mark.parametrize("mode", ["standard", "isolated"])
def test_a_library_that_was_built_anew_is_the_old_one_and_the_log_says_so(
    spawn: StartContainer, package: str, mode: str, tmp_path: Path
) -> None:
    prefix = prefix_of(package) or Path(sys.prefix)
    index, environment = index_in(tmp_path, package)
    lines = (prefix / index.relative_to(tmp_path) / package).read_text().splitlines()
    plugin, library = next(line for line in lines if "::Talker;" in line).split(";")
    (index / "mine").write_text(f"{plugin};lib/mine.so\n")
    built = prefix / library
    mine = tmp_path / "lib" / "mine.so"
    mine.parent.mkdir()
    shutil.copyfile(built, mine)
    container = start(spawn, mode, environment=environment)
    said = f"{mine} has changed since it was loaded: node /second gets the code as it was"
    container.loaded(plugin, package="mine", node_name="first")
    shutil.copyfile(built, mine.with_name("new"))
    mine.with_name("new").replace(mine)
    assert said not in container.log.read_text()
    container.loaded(plugin, package="mine", node_name="second")
    assert said in container.log.read_text()
    assert "node /first" not in container.log.read_text()


def test_of_a_failure_s_long_text_the_beginning_is_reported(container: Container) -> None:
    """In full it might not fit into a frame, and the failure would be lost."""
    knight, type_name = "\N{BLACK CHESS KNIGHT}", "std::runtime_error: "
    container.load("ThrowingConstructor", parameters={"reason": knight * 100_000})
    text = container.event(LOAD_FAILED).error_message
    shown = knight * ((16 * 1024 - len(type_name)) // 3)
    assert text.endswith(f"{type_name}{shown}... (cut, of {len(type_name) + 300_000} bytes)")
    container.loaded("Talker")


def test_nodes_start_programs_without_our_signals(container: Container) -> None:
    lines = Path(f"/proc/{container.process.pid}/status").read_text().splitlines()
    status = dict(line.split(":\t", 1) for line in lines if ":\t" in line)
    ignored = int(status["SigIgn"], 16)
    pipe = 1 << (13 - 1)
    assert not ignored & pipe
    assert int(status["SigCgt"], 16) & pipe


def test_a_component_that_brings_libpython_gets_its_symbols(container: Container) -> None:
    container.loaded("PythonUser")


def test_a_component_that_is_linked_against_a_python_half_loads(container: Container) -> None:
    container.loaded("Overlinked")
    container.loaded("PythonUser")  # the symbols that were lent are withdrawn again


def test_a_container_without_descriptors_says_so_and_not_that_there_is_no_package(
    container: Container,
) -> None:
    container.loaded("Talker", node_name="talker")
    process = psutil.Process(container.process.pid)
    limit = process.rlimit(psutil.RLIMIT_NOFILE)
    numbers = {int(each.name) for each in Path(f"/proc/{process.pid}/fd").iterdir()}
    free = min(set(range(len(numbers) + 1)) - numbers)
    process.rlimit(psutil.RLIMIT_NOFILE, (free, limit[1]))
    attempt = container.load("Talker", node_name="one_too_many")
    event = container.event(LOAD_FAILED, attempt=attempt)
    assert "cannot search the ament index: Too many open files" in event.error_message
    process.rlimit(psutil.RLIMIT_NOFILE, limit)
    container.loaded("Talker", node_name="one_too_many")


def test_a_node_for_which_no_thread_can_be_had_fails_to_load_and_the_next_one_does_not(
    container: Container,
) -> None:
    container.loaded("Talker", node_name="talker")
    process = psutil.Process(container.process.pid)
    limit = process.rlimit(psutil.RLIMIT_AS)
    # Less than the stack of a thread, and more than anything else that a load needs.
    process.rlimit(psutil.RLIMIT_AS, (process.memory_info().vms + (4 << 20), limit[1]))
    attempts = [container.load("SlowConstructor", parameters={"seconds": 3600.0}) for _ in range(4)]
    # The stack of a thread that has just ended serves once more.
    text = "cannot start loading: Resource temporarily unavailable"
    events = (container.event(LOAD_FAILED) for _ in attempts)
    event = next(each for each in events if text in each.error_message)
    assert event.attempt in attempts
    process.rlimit(psutil.RLIMIT_AS, limit)
    container.loaded("Talker", node_name="another")


@pytest.mark.parametrize("arguments", [(), ("--isolated",)])
def test_readers_that_join_a_stream_of_large_messages_read_on(
    spawn: StartContainer, arguments: tuple[str, ...]
) -> None:
    """Fast DDS hangs where it keeps a sample that it has dropped, see fastdds/waits.hpp."""
    for number in range(2):
        other = spawn("--isolated")
        other.loaded("ImageSource", node_name=f"far{number}", parameters={"rate": 30.0})
    container = spawn(*arguments)
    container.loaded("ImageSource", node_name="near", parameters={"rate": 30.0})
    for _ in range(15):
        for number in range(4):
            parameters = {"report_every": 1}
            container.load("ImageSink", node_name=f"sink{number}", parameters=parameters)
        sinks = [container.event(LOADED) for _ in range(4)]
        before = len(container.log.read_text())
        reads = [f"[sink{number}]: images=9 " for number in range(4)]
        until(
            lambda start=before, wanted=reads: all(  # type: ignore[misc]
                each in container.log.read_text()[start:] for each in wanted
            ),
            "images at each reader",
        )
        for sink in sinks:
            container.send(ControlUnload(unique_id=sink.unique_id))
        for _ in sinks:
            container.event(UNLOADED)

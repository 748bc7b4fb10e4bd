"""Isolated nodes that behave: processes of their own, messages by pointer all the same."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from play_launch_msgs.msg import ComponentEvent, ControlCancel, ControlUnload
from std_msgs.msg import String

from play_launch.container.environment import find_allocator
from tests.support.isolated import (
    MODES,
    children,
    is_gone,
    only_these_remain,
    start,
    start_time,
    survives,
)
from tests.support.ros import Probe

if TYPE_CHECKING:
    from tests.support.control_peer import Container, StartContainer

LOADED, UNLOADED = ComponentEvent.LOADED, ComponentEvent.UNLOADED
LOADING, CRASHED = ComponentEvent.LOADING, ComponentEvent.CRASHED
FOREVER = {"seconds": 3600.0}
BY_POINTER = {"use_intra_process_comms": True}

both_modes = pytest.mark.parametrize("mode", MODES)
both_mechanisms = pytest.mark.parametrize("mechanism", ["shared_memory", "process"])


def unload(container: Container, unique_id: int) -> ComponentEvent:
    container.send(ControlUnload(unique_id=unique_id))
    return container.event(UNLOADED, unique_id=unique_id)


def numbers(report: String) -> dict[str, int]:
    """The whole numbers of an image sink's report."""
    fields = (field.split("=") for field in report.data.split())
    return {name: int(value) for name, value in fields if value.isdigit()}


@both_modes
@both_mechanisms
def test_every_node_is_a_process(spawn: StartContainer, mode: str, mechanism: str) -> None:
    container = start(spawn, mode, "--isolation", mechanism)
    (hello,) = container.seen
    assert (hello.mode, hello.mechanism) == (mode, mechanism)
    with survives(container), Probe() as probe:
        events = [container.loaded("Talker", node_name=f"talker_{i}") for i in range(3)]
        pids = {event.pid for event in events}
        assert len(pids | {container.process.pid}) == 4
        assert children(container) == pids
        for event in events:
            assert event.start_time == start_time(event.pid)
            if mechanism == "shared_memory":
                name = Path(f"/proc/{event.pid}/comm").read_text().strip()
                assert f"/{name}" == event.full_node_name
        assert {node.pid for node in container.status().nodes} == pids
        assert dict(probe.nodes()).keys() == {event.full_node_name for event in events}
        first, *others = events
        gone = unload(container, first.unique_id)
        assert (gone.pid, gone.error_message, gone.signal) == (first.pid, "", 0)
        assert is_gone(first.pid)
        with pytest.raises(ProcessLookupError):
            os.kill(first.pid, 0)
        assert children(container) == {event.pid for event in others}
        assert {node.unique_id for node in container.status().nodes} == {
            event.unique_id for event in others
        }
        for event in others:
            unload(container, event.unique_id)
        assert only_these_remain(container)
        status = container.status()
        assert (status.crashes, status.undertaken, status.leaked, status.unquiesced) == (0,) * 4


@both_modes
def test_the_hello_tells_the_mechanism(spawn: StartContainer, mode: str) -> None:
    container = start(spawn, mode)
    (hello,) = container.seen
    assert (hello.mode, hello.mechanism) == (mode, "shared_memory")
    assert bool(hello.notes) is (find_allocator().library is None)
    assert hello.thread_num == (1 if mode == "isolated" else min(max(os.cpu_count() or 2, 2), 4))
    assert container.shut_down() == 0


def test_glibc_malloc_is_noted(spawn: StartContainer) -> None:
    container = spawn("--isolated", environment={"LD_PRELOAD": ""})
    (hello,) = container.seen
    assert hello.mechanism == "shared_memory"
    assert "mimalloc" in "".join(hello.notes)
    assert "mimalloc" in container.log.read_text()
    container.loaded("Talker")
    assert container.shut_down() == 0


@both_modes
def test_messages_go_by_pointer_between_processes(spawn: StartContainer, mode: str) -> None:
    container = start(spawn, mode)
    with survives(container), Probe() as probe:
        sink = container.loaded(
            "ImageSink", parameters={"report_every": 10}, extra_arguments=BY_POINTER
        )
        source = container.loaded("ImageSource", extra_arguments=BY_POINTER)
        assert source.pid != sink.pid
        heard = probe.listen(String, "/image_sink/report")
        probe.spin_until(lambda: bool(heard), 20.0, "a report")
        first = numbers(heard[-1])
        assert first["by_pointer"] == first["images"] > 0
        assert first["bytes"] == 2_000_000

        os.kill(source.pid, signal.SIGKILL)
        container.event(CRASHED, unique_id=source.unique_id)
        again = container.loaded("ImageSource", extra_arguments=BY_POINTER)
        assert again.pid not in {source.pid, sink.pid}
        before = len(heard)
        probe.spin_until(lambda: len(heard) > before + 1, 20.0, "reports of the new source")
        last = numbers(heard[-1])
        assert last["by_pointer"] == last["images"] > first["images"]
        assert not is_gone(sink.pid)


@both_modes
@both_mechanisms
@pytest.mark.parametrize("how", [ControlUnload, ControlCancel])
def test_a_node_is_unloaded_while_it_constructs(
    spawn: StartContainer, mode: str, mechanism: str, how: type[ControlUnload | ControlCancel]
) -> None:
    container = start(spawn, mode, "--isolation", mechanism)
    with survives(container):
        attempt = container.load("SlowConstructor", parameters={"seconds": 0.3}, node_name="slow")
        loading = container.event(LOADING, attempt=attempt)
        container.send(how(unique_id=loading.unique_id))
        gone = container.event(UNLOADED, attempt=attempt)
        # A container of its own may be told to stop before it constructs, and is cut off then.
        assert gone.error_message.startswith("cancelled")
        assert mechanism == "process" or gone.error_message == "cancelled"
        assert only_these_remain(container)
        container.loaded("Talker", node_name="slow")


@both_modes
@pytest.mark.parametrize("how", [ControlUnload, ControlCancel])
@both_mechanisms
def test_a_node_whose_constructor_hangs_is_unloaded(
    spawn: StartContainer, mode: str, mechanism: str, how: type[ControlUnload | ControlCancel]
) -> None:
    container = start(spawn, mode, "--isolation", mechanism)
    with survives(container):
        attempt = container.load("SlowConstructor", parameters=FOREVER, node_name="slow")
        loading = container.event(LOADING, attempt=attempt)
        container.status_when(lambda s: s.nodes[0].pid != container.process.pid, "a process")
        container.send(how(unique_id=loading.unique_id))
        gone = container.event(UNLOADED, attempt=attempt)
        assert gone.error_message.startswith("cancelled; it did not leave in order: ")
        # A container of its own ends by itself, unless it is told to stop before it can.
        assert gone.signal in (
            {signal.SIGTERM} if mechanism == "shared_memory" else {0, signal.SIGTERM}
        )
        assert only_these_remain(container)
        container.loaded("Talker", node_name="slow")

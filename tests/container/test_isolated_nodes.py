"""Isolated nodes: processes of their own, messages by pointer, and one end of each life."""

from __future__ import annotations

import os
import random
import select
import signal
from pathlib import Path

import pytest
from play_launch_msgs.msg import ComponentEvent, ControlCancel, ControlUnload, NodeStatus
from std_msgs.msg import String

from play_launch.ros.fastdds.shared_memory import sweep
from tests.support.control_peer import TIMEOUT, Container, StartContainer
from tests.support.isolated import (
    MODES,
    allocator_environment,
    children,
    is_gone,
    only_these_remain,
    start,
    start_time,
    survives,
)
from tests.support.ros import Probe

LOADED, UNLOADED = ComponentEvent.LOADED, ComponentEvent.UNLOADED
LOADING, CRASHED = ComponentEvent.LOADING, ComponentEvent.CRASHED
LOAD_FAILED = ComponentEvent.LOAD_FAILED
FOREVER = {"seconds": 3600.0}
BY_POINTER = {"use_intra_process_comms": True}

both_modes = pytest.mark.parametrize("mode", MODES)
both_mechanisms = pytest.mark.parametrize("mechanism", ["shared_memory", "process"])
each_way_to_unload = pytest.mark.parametrize(
    ("mode", "mechanism", "how"),
    [
        ("isolated", "shared_memory", ControlUnload),
        ("isolated", "process", ControlCancel),
        ("isolated_mt", "shared_memory", ControlCancel),
        ("isolated_mt", "process", ControlUnload),
    ],
)


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
        assert only_these_remain(container, *(event.pid for event in others))
        assert {node.unique_id for node in container.status().nodes} == {
            event.unique_id for event in others
        }
        for event in others:
            unload(container, event.unique_id)
        assert only_these_remain(container)
        status = container.status()
        assert (status.crashes, status.undertaken, status.leaked, status.unquiesced) == (0,) * 4


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


@each_way_to_unload
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


@each_way_to_unload
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
        # A container of its own exits unasked, unless it is told to stop before it can.
        assert gone.signal in (
            {signal.SIGTERM} if mechanism == "shared_memory" else {0, signal.SIGTERM}
        )
        assert only_these_remain(container)
        container.loaded("Talker", node_name="slow")


def start_separate(spawn: StartContainer, mode: str = "isolated") -> Container:
    return start(spawn, mode, "--isolation", "process")


@pytest.mark.parametrize(("how", "number"), [("segv", 11), ("kill", 9), ("exit", 0)])
def test_a_crash_is_told(spawn: StartContainer, package: str, how: str, number: int) -> None:
    container = start_separate(spawn)
    with survives(container), Probe() as probe:
        talker = container.loaded("Talker", package=package)
        crasher = container.loaded("Crasher", package=package)
        assert len({talker.pid, crasher.pid, container.process.pid}) == 3
        order = probe.node.create_publisher(String, "/crash", 1)
        probe.spin_until(
            lambda: order.get_subscription_count() > 0, TIMEOUT, "the crasher's subscription"
        )
        order.publish(String(data=how))
        crashed = container.event(CRASHED, unique_id=crasher.unique_id)
        assert (crashed.signal, crashed.exit_code) == (number, 0 if number else 3)
        assert (crashed.pid, crashed.start_time) == (crasher.pid, crasher.start_time)
        probe.collect(String, "/chatter", 3)
        assert only_these_remain(container, talker.pid)
        assert container.status().crashes == 1
    sweep()  # as the supervisor does: the dead node's participant was its own


def test_a_helper_that_outlives_its_node_does_not_hide_the_crash(spawn: StartContainer) -> None:
    """It holds the node's end of the channel open."""
    container = start_separate(spawn)
    with survives(container), Probe() as probe:
        forker = container.loaded("Forker")
        (helper,) = children(container) - {forker.pid}
        handle = os.pidfd_open(helper)
        try:
            order = probe.node.create_publisher(String, "/crash", 1)
            probe.spin_until(
                lambda: order.get_subscription_count() > 0, TIMEOUT, "the node's subscription"
            )
            order.publish(String())
            crashed = container.event(CRASHED, unique_id=forker.unique_id)
            assert (crashed.pid, crashed.exit_code) == (forker.pid, 3)
            assert not select.select([handle], [], [], 0)[0], "the helper did not outlive its node"
        finally:
            signal.pidfd_send_signal(handle, signal.SIGKILL)
            ended, _, _ = select.select([handle], [], [], TIMEOUT)
            os.close(handle)
        assert ended
        assert only_these_remain(container)


def test_what_fails_while_loading(spawn: StartContainer) -> None:
    container = start_separate(spawn)
    with survives(container):
        container.load("ThrowingConstructor")
        assert "no such camera" in container.event(LOAD_FAILED).error_message
        container.load("Crasher", parameters={"in_constructor": True})
        failed = container.event(LOAD_FAILED)
        assert failed.signal == signal.SIGSEGV
        assert "SIGSEGV" in failed.error_message
        assert only_these_remain(container)


GONE = "/no/such/group"


@pytest.mark.parametrize("mode", MODES)
def test_a_node_that_is_kept_out(spawn: StartContainer, mode: str) -> None:
    container = start(spawn, mode)
    with survives(container):
        # Without the word, it runs where it is.
        container.loaded("Talker", node_name="anywhere", resources=[f"cgroup {GONE}"])
        attempt = container.load("Talker", resources=[f"required_cgroup {GONE}"])
        failed = container.event(LOAD_FAILED, attempt=attempt)
        reason = "the kernel did not let it into its control group, which is required"
        assert reason in failed.error_message
        attempt = container.load("Talker", resources=["nice five"])
        failed = container.event(LOAD_FAILED, attempt=attempt)
        assert "'nice five' is no setting of a process" in failed.error_message


ENDS = {LOAD_FAILED, UNLOADED, CRASHED}
LIVES = [
    [LOADING, LOAD_FAILED],
    [LOADING, UNLOADED],
    [LOADING, LOADED, UNLOADED],
    [LOADING, LOADED, CRASHED],
]
EVERY_WAY = {"standard": (), **MODES, "process": (*MODES["isolated"], "--isolation", "process")}


def end_of(container: Container, attempt: int) -> ComponentEvent:
    return container.until(
        lambda m: isinstance(m, ComponentEvent) and m.attempt == attempt and m.event_type in ENDS,
        f"the end of attempt {attempt}",
    )


def lives(container: Container) -> list[list[int]]:
    """Return the types of the events of each attempt, once the container is silent."""
    container.status()
    told: dict[int, list[int]] = {}
    for message in container.seen:
        if isinstance(message, ComponentEvent):
            told.setdefault(message.attempt, []).append(message.event_type)
    return list(told.values())


@pytest.mark.parametrize("way", EVERY_WAY)
def test_many_that_turn_out_to_have_one_name_stay(spawn: StartContainer, way: str) -> None:
    container = spawn(*EVERY_WAY[way], environment=allocator_environment())
    count = 4 if way == "process" else 12
    with survives(container):
        # Their names are only known once they are constructed.
        attempts = [container.load("Talker") for _ in range(count)]
        outcomes: list[ComponentEvent] = []
        while len(outcomes) < count:
            outcomes.append(
                container.until(
                    lambda m: isinstance(m, ComponentEvent) and m.event_type != LOADING,
                    "the outcomes",
                )
            )
        assert {event.attempt for event in outcomes} == set(attempts)
        assert {(event.event_type, event.full_node_name) for event in outcomes} == {
            (LOADED, "/talker")
        }
        status = container.status()
        assert len(status.nodes) == count
        assert status.crashes == 0


@both_modes
@pytest.mark.parametrize(
    ("place", "end", "text"),
    [
        ("before_construct", LOAD_FAILED, "died while it was constructed"),
        ("after_construct", LOAD_FAILED, "died while it was constructed"),
        ("before_unload", UNLOADED, "it did not leave in order"),
    ],
)
def test_a_node_is_killed_at_a_certain_place(
    spawn: StartContainer, mode: str, place: str, end: int, text: str
) -> None:
    container = start(spawn, mode, failpoints=f"container.{place}=kill")
    with survives(container):
        attempt = container.load("Talker")
        if end == UNLOADED:
            loaded = container.event(LOADED, attempt=attempt)
            container.send(ControlUnload(unique_id=loaded.unique_id))
        event = end_of(container, attempt)
        assert (event.event_type, event.signal) == (end, signal.SIGKILL)
        assert text in event.error_message
        assert only_these_remain(container)
        status = container.status_when(
            lambda status: status.undertaken + status.leaked > 0, "the cleanup"
        )
        assert status.crashes == status.unquiesced == 1
        assert all(life in LIVES for life in lives(container))


@both_modes
@pytest.mark.parametrize(
    ("how", "end", "signum", "code"),
    [
        ("segv", CRASHED, signal.SIGSEGV, 0),
        ("exception", CRASHED, signal.SIGABRT, 0),
        ("exit", CRASHED, 0, 3),
        ("kill", UNLOADED, signal.SIGKILL, 0),
        ("term", UNLOADED, signal.SIGTERM, 0),
    ],
)
def test_a_destructor_that_faults_is_a_crash(
    spawn: StartContainer, mode: str, how: str, end: int, signum: int, code: int
) -> None:
    container = start(spawn, mode)
    with survives(container):
        node = container.loaded("Crasher", parameters={"how": how, "in_destructor": True})
        container.send(ControlUnload(unique_id=node.unique_id))
        event = end_of(container, node.attempt)
        assert (event.event_type, event.signal, event.exit_code) == (end, signum, code)
        assert event.error_message.startswith("it did not leave in order")
        assert bool(event.backtrace) == (how in {"segv", "exception"})
        assert only_these_remain(container)


def terminate(node: NodeStatus) -> None:
    """Send SIGTERM to that process, if it is still there."""
    try:
        handle = os.pidfd_open(node.pid)
    except ProcessLookupError:
        return
    try:
        if start_time(node.pid) == node.start_time:
            signal.pidfd_send_signal(handle, signal.SIGTERM)
    except (ProcessLookupError, FileNotFoundError):
        pass
    finally:
        os.close(handle)


@both_modes
def test_a_signal_ends_nodes_at_any_instant(spawn: StartContainer, mode: str) -> None:
    """From before they construct until after they have left."""
    container = start(spawn, mode)
    with survives(container):
        chance = random.Random(7)
        keeper = container.loaded("Talker")
        for number in range(60):
            attempt = container.load(
                "SlowConstructor", parameters={"seconds": chance.random() * 3e-3}
            )
            loading = container.event(LOADING, attempt=attempt)
            if number % 3 == 0:
                container.send(ControlCancel(unique_id=loading.unique_id))
            for _ in range(chance.randrange(30)):
                container.status()
            for node in container.status(loading.unique_id).nodes:
                if node.pid != container.process.pid:
                    terminate(node)
                else:  # it has no process yet
                    container.send(ControlUnload(unique_id=loading.unique_id))
            if not any(
                isinstance(m, ComponentEvent) and m.attempt == attempt and m.event_type in ENDS
                for m in container.seen
            ):
                end_of(container, attempt)
        (kept, *others) = lives(container)
        assert kept == [LOADING, LOADED]
        assert len(others) == 60
        assert all(life in LIVES for life in others)
        assert only_these_remain(container, keeper.pid)

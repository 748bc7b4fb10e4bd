"""The crash matrix of the isolation work, with rclcpp nodes."""

from __future__ import annotations

import os
import signal
from signal import SIGABRT, SIGBUS, SIGFPE, SIGILL, SIGKILL, SIGSEGV, SIGTERM
from statistics import median
from typing import TYPE_CHECKING

import pytest
from play_launch_msgs.msg import ComponentEvent
from std_msgs.msg import String

from play_launch.ros.fastdds.shared_memory import sweep
from tests.rclcpp.modes import start
from tests.support.isolated import MODES, is_gone, only_these_remain, survives

if TYPE_CHECKING:
    from tests.support.control_peer import Container, StartContainer
    from tests.support.ros import Probe

CRASHED, LOAD_FAILED = ComponentEvent.CRASHED, ComponentEvent.LOAD_FAILED
UNLOADED = ComponentEvent.UNLOADED
WAYS = {
    "segv": SIGSEGV,
    "abrt": SIGABRT,
    "fpe": SIGFPE,
    "bus": SIGBUS,
    "ill": SIGILL,
    "kill": SIGKILL,
    "term": SIGTERM,
    "exception": SIGABRT,
    "exit": 0,
}
TRACED = {"segv", "abrt", "exception"}
both_modes = pytest.mark.parametrize("mode", MODES)
MOMENTARY = 2
"""Threads or descriptors that wait to be given back at any moment; growth would be dozens."""


def assert_death(event: ComponentEvent, how: str) -> None:
    """The event tells of that way to die, and where the component did it."""
    assert event.signal == WAYS[how]
    assert event.exit_code == (3 if how == "exit" else 0)
    if how in TRACED:
        assert any("test_components::die" in line for line in event.backtrace), event.backtrace
    if how == "exception":
        assert "std::runtime_error: as asked for" in event.error_message


def order_crash(probe: Probe, how: str) -> None:
    publisher = probe.node.create_publisher(String, "/crash", 1)
    probe.spin_until(
        lambda: publisher.get_subscription_count() > 0, 30.0, "the crasher's subscription"
    )
    publisher.publish(String(data=how))


def assert_cleaned_up(
    container: Container, *, crashes: int, leaked: int = 0, may_leak: bool = False
) -> int:
    """The container has counted the crashes, and has cleaned up after all but the leaked ones.

    With `may_leak` it may also not have cleaned up after some; how many that were.
    """
    while True:
        status = container.status()
        if status.undertaken + status.leaked == crashes:
            break
    assert status.crashes == crashes
    assert status.leaked == leaked or may_leak, container.log.read_text()
    return int(status.leaked)


@both_modes
@pytest.mark.parametrize("how", WAYS)
def test_a_crash_is_told_and_the_neighbours_go_on(
    spawn: StartContainer, components: str, mode: str, how: str, probe: Probe
) -> None:
    container = start(spawn, mode)
    with survives(container):
        talker = container.loaded("Talker", package=components)
        heard = probe.listen(String, "/chatter")
        probe.spin_until(lambda: bool(heard), 30.0, "the talker")
        crasher = container.loaded(
            "Crasher", package=components, parameters={"how": how, "after": 0.001}
        )
        crashed = container.event(CRASHED, unique_id=crasher.unique_id)
        assert (crashed.pid, crashed.start_time) == (crasher.pid, crasher.start_time)
        assert_death(crashed, how)
        assert is_gone(crasher.pid)
        before = len(heard)
        probe.spin_until(lambda: len(heard) > before + 10, 30.0, "the talker again")
        # SIGKILL leaves no time to bring the other threads out of rclcpp's and the DDS's locks.
        may_leak = how == "kill" and mode == "isolated_mt"
        if not (assert_cleaned_up(container, crashes=1, may_leak=may_leak) and may_leak):
            probe.spin_until(
                lambda: "crasher" not in probe.node.get_node_names(), 30.0, "the end of the dead"
            )
        assert only_these_remain(container, talker.pid)
        container.loaded("Crasher", package=components)


@both_modes
@pytest.mark.parametrize("how", ["segv", "abrt", "kill", "exit"])
def test_a_crash_in_a_constructor_is_a_failed_load(
    spawn: StartContainer, components: str, mode: str, how: str, probe: Probe
) -> None:
    container = start(spawn, mode)
    with survives(container):
        container.load(
            "Crasher", package=components, parameters={"how": how, "in_constructor": True}
        )
        failed = container.event(LOAD_FAILED)
        assert failed.pid != container.process.pid
        assert_death(failed, how)
        # The half of a node cannot be destroyed, but others must not see it any more.
        assert_cleaned_up(container, crashes=1, leaked=1)
        assert only_these_remain(container)
        probe.spin_until(
            lambda: (
                "container" in probe.node.get_node_names()
                and "crasher" not in probe.node.get_node_names()
                and probe.node.count_subscribers("/crash") == 0
            ),
            30.0,
            "the end of the half",
        )
        again = container.loaded("Crasher", package=components)
        probe.spin_until(
            lambda: "crasher" in probe.node.get_node_names(), 30.0, "the next of that name"
        )
        assert only_these_remain(container, again.pid)


@both_modes
def test_a_crash_on_a_message(
    spawn: StartContainer, components: str, mode: str, probe: Probe
) -> None:
    container = start(spawn, mode)
    with survives(container):
        crasher = container.loaded("Crasher", package=components)
        order_crash(probe, "segv")
        crashed = container.event(CRASHED, unique_id=crasher.unique_id)
        assert_death(crashed, "segv")
        assert_cleaned_up(container, crashes=1)
        assert container.status().unquiesced == 0
        # With it the subscription that was being executed.
        probe.spin_until(
            lambda: probe.node.count_subscribers("/crash") == 0, 30.0, "the subscription's end"
        )


@both_modes
@pytest.mark.parametrize("number", [SIGKILL, SIGSEGV, SIGTERM])
def test_a_signal_from_outside(
    spawn: StartContainer, components: str, mode: str, number: signal.Signals, probe: Probe
) -> None:
    container = start(spawn, mode)
    with survives(container):
        victim = container.loaded("Talker", package=components, node_name="victim")
        container.loaded("Talker", package=components, node_name="neighbour")
        os.kill(victim.pid, number)
        crashed = container.event(CRASHED, unique_id=victim.unique_id)
        assert crashed.signal == number
        assert is_gone(victim.pid)
        probe.collect(String, "/chatter", 5, timeout=60.0)
        # SIGKILL leaves no time to bring the other threads out of rclcpp's and the DDS's locks.
        may_leak = number is SIGKILL and mode == "isolated_mt"
        assert_cleaned_up(container, crashes=1, may_leak=may_leak)
        # What is asked for by a signal is done in order; only SIGKILL cannot be.
        assert container.status().unquiesced == (1 if number == SIGKILL else 0)


@both_modes
@pytest.mark.parametrize("in_constructor", [False, True], ids=["callback", "constructor"])
def test_a_node_that_shuts_rclcpp_down_ends_alone(
    spawn: StartContainer, components: str, mode: str, in_constructor: bool, probe: Probe
) -> None:
    container = start(spawn, mode)
    with survives(container):
        container.loaded("Talker", package=components)
        parameters = {"how": "shutdown", "after": 0.001, "in_constructor": in_constructor}
        crasher = container.loaded("Crasher", package=components, parameters=parameters)
        event = container.event(UNLOADED, unique_id=crasher.unique_id)
        assert "ended itself" in event.error_message
        probe.collect(String, "/chatter", 5, timeout=60.0)
        assert container.status().crashes == 0


@both_modes
def test_a_node_that_shuts_its_context_down_ends_alone(
    spawn: StartContainer, components: str, mode: str, probe: Probe
) -> None:
    how = {"how": "shutdown_context"}
    container = start(spawn, mode)
    with survives(container):
        container.loaded("Talker", package=components)
        crasher = container.loaded("Crasher", package=components, parameters={**how, "after": 0.0})
        event = container.event(UNLOADED, unique_id=crasher.unique_id)
        assert "ended itself" in event.error_message
        # rclcpp cannot be kept from its work there but by an exception.
        container.load("Crasher", package=components, parameters={**how, "in_constructor": True})
        assert "ends alone" in container.event(LOAD_FAILED).error_message
        probe.collect(String, "/chatter", 5, timeout=60.0)
        assert container.status().crashes == 0


@pytest.mark.parametrize("mode", ["standard", "mt"])
@pytest.mark.parametrize("how", ["shutdown", "shutdown_context"])
def test_a_node_that_shuts_rclcpp_down_ends_a_shared_container(
    spawn: StartContainer, components: str, mode: str, how: str
) -> None:
    container = start(spawn, mode)
    talker = container.loaded("Talker", package=components)
    container.load("Crasher", package=components, parameters={"how": how, "after": 0.001})
    event = container.event(UNLOADED, unique_id=talker.unique_id)
    assert "/crasher shut the ROS context down" in event.error_message
    assert container.wait() == 79, container.log.read_text()


@both_modes
def test_reloading_after_crashes_leaves_nothing_behind(
    spawn: StartContainer, components: str, mode: str
) -> None:
    container = start(spawn, mode)
    used: list[tuple[int, int]] = []
    ways = ("segv", "abrt", "exception", "exit")
    with survives(container):
        talker = container.loaded("Talker", package=components)
        for i in range(60):
            crasher = container.loaded(
                "Crasher", package=components, parameters={"how": ways[i % 4], "after": 0.0}
            )
            container.event(CRASHED, unique_id=crasher.unique_id)
            used.append((container.threads(), container.descriptors()))
        assert_cleaned_up(container, crashes=60)
        for each in (0, 1):
            late, early = (median(u[each] for u in part) for part in (used[40:], used[5:40]))
            assert late <= early + MOMENTARY, used
        assert only_these_remain(container, talker.pid)


@both_modes
def test_images_go_on_by_pointer_after_crashes(
    spawn: StartContainer, components: str, mode: str, probe: Probe
) -> None:
    container = start(spawn, mode)
    by_pointer = {"use_intra_process_comms": True}
    with survives(container):
        container.loaded("ImageSource", package=components, extra_arguments=by_pointer)
        for number in (SIGSEGV, SIGTERM, SIGABRT):
            sink = container.loaded("ImageSink", package=components, extra_arguments=by_pointer)
            for verdict in probe.collect(String, "/verdict", 5, timeout=60.0):
                _, made_at, seen_by, seen_at = verdict.data.split()
                assert (made_at, int(seen_by)) == (seen_at, sink.pid)
            os.kill(sink.pid, number)
            container.event(CRASHED, unique_id=sink.unique_id)
        assert_cleaned_up(container, crashes=3)


def test_nodes_with_memory_of_their_own(
    spawn: StartContainer, components: str, probe: Probe
) -> None:
    container = start(spawn, "isolated", "--isolation", "process")
    with survives(container):
        talker = container.loaded("Talker", package=components)
        crasher = container.loaded("Crasher", package=components)
        assert len({talker.pid, crasher.pid, container.process.pid}) == 3
        order_crash(probe, "segv")
        crashed = container.event(CRASHED, unique_id=crasher.unique_id)
        assert crashed.signal == SIGSEGV
        probe.collect(String, "/chatter", 5, timeout=60.0)
    sweep()  # as the supervisor does: the dead node's participant was its own

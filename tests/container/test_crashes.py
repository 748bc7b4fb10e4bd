"""The death of an isolated node is the death of its process, and of nothing else."""

from __future__ import annotations

import os
import re
import resource
import signal
from signal import (
    SIGABRT,
    SIGBUS,
    SIGFPE,
    SIGHUP,
    SIGILL,
    SIGKILL,
    SIGSEGV,
    SIGTERM,
    SIGUSR1,
)

import pytest
from play_launch_msgs.msg import ComponentEvent, ControlUnload
from std_msgs.msg import String

from tests.support.control_peer import Container, StartContainer
from tests.support.isolated import MODES, is_gone, only_these_remain, start, survives
from tests.support.ros import Probe
from tests.support.waiting import until

LOADED, LOAD_FAILED, CRASHED, UNLOADED = (
    ComponentEvent.LOADED,
    ComponentEvent.LOAD_FAILED,
    ComponentEvent.CRASHED,
    ComponentEvent.UNLOADED,
)
SDK = "play_launch_demo"
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
"""Ways to die in the thread that runs the callback; the others are signals to the process."""

REQUESTS = [SIGTERM, SIGHUP, SIGUSR1, SIGSEGV]

both_modes = pytest.mark.parametrize("mode", MODES)


def assert_death(event: ComponentEvent, how: str) -> None:
    """The event tells of that way to die, and where the component did it."""
    assert event.signal == WAYS[how]
    assert event.exit_code == (3 if how == "exit" else 0)
    if event.signal:
        assert signal.Signals(event.signal).name in event.error_message
    if how in TRACED:
        assert any(
            f"{event.package_name}::" in line and "die" in line for line in event.backtrace
        ), event.backtrace


def assert_cleaned_up(
    container: Container, *, crashes: int, leaked: int = 0, may_leak: bool = False
) -> int:
    """The container has counted the crashes, and has cleaned up after all but the leaked ones.

    With `may_leak` one more may be left; returns how many are.
    """
    status = container.status_when(
        lambda status: status.undertaken + status.leaked == crashes, "the cleanup"
    )
    assert status.crashes == crashes
    assert leaked <= status.leaked <= leaked + may_leak, container.log.read_text()
    return int(status.leaked)


def is_cut_off(event: ComponentEvent) -> bool:
    """Whether a busy machine left it no time to leave in order, even amid a destructor."""
    return "did not leave in time" in event.error_message


def order_crash(probe: Probe, how: str) -> None:
    publisher = probe.node.create_publisher(String, "/crash", 1)
    probe.spin_until(
        lambda: publisher.get_subscription_count() > 0, 30.0, "the crasher's subscription"
    )
    publisher.publish(String(data=how))


@both_modes
@pytest.mark.parametrize("how", WAYS)
def test_a_crash_is_told_and_the_neighbours_go_on(
    spawn: StartContainer, package: str, mode: str, how: str, probe: Probe
) -> None:
    container = start(spawn, mode)
    with survives(container):
        talker = container.loaded("Talker", package=package, parameters={"rate": 100.0})
        heard = probe.listen(String, "/chatter")
        probe.spin_until(lambda: bool(heard), 30.0, "the talker")
        dying = {"how": how, "after": 0.001}
        crasher = container.loaded("Crasher", package=package, parameters=dying)
        crashed = container.event(CRASHED, unique_id=crasher.unique_id)
        assert (crashed.pid, crashed.start_time) == (crasher.pid, crasher.start_time)
        assert_death(crashed, how)
        assert is_gone(crasher.pid)
        before = len(heard)
        probe.spin_until(lambda: len(heard) > before + 10, 30.0, "the talker again")
        # SIGKILL leaves no time to bring the other threads out of rclcpp's and the DDS's locks.
        may_leak = package != SDK and how == "kill" and mode == "isolated_mt"
        may_leak = may_leak or is_cut_off(crashed)
        if not assert_cleaned_up(container, crashes=1, may_leak=may_leak):
            probe.spin_until(
                lambda: "crasher" not in probe.node.get_node_names(), 30.0, "the end of the dead"
            )
        assert only_these_remain(container, talker.pid)
        container.loaded("Crasher", package=package, parameters={"how": how})


@both_modes
@pytest.mark.parametrize("how", ["segv", "abrt", "kill", "exit"])
def test_a_crash_in_a_constructor_is_a_failed_load(
    spawn: StartContainer, package: str, mode: str, how: str, probe: Probe
) -> None:
    container = start(spawn, mode)
    with survives(container):
        dying = {"how": how, "in_constructor": True}
        container.load("Crasher", package=package, parameters=dying)
        failed = container.event(LOAD_FAILED)
        assert failed.pid != container.process.pid
        assert_death(failed, how)
        assert how not in TRACED or "die" in failed.error_message
        # The half of a node cannot be destroyed, but others must not see it any more.
        assert_cleaned_up(container, crashes=1, leaked=1)
        assert only_these_remain(container)
        names = probe.node.get_node_names
        probe.spin_until(
            lambda: (
                "container" in names()
                and "crasher" not in names()
                and probe.node.count_subscribers("/crash") == 0
            ),
            30.0,
            "the end of the half",
        )
        again = container.loaded("Crasher", package=package)
        probe.spin_until(lambda: "crasher" in names(), 30.0, "the next of that name")
        assert only_these_remain(container, again.pid)


@pytest.mark.parametrize("mechanism", ["shared_memory", "process"])
@pytest.mark.parametrize("asked", [False, True])
def test_core_dumps_are_a_setting(spawn: StartContainer, mechanism: str, asked: bool) -> None:
    arguments = ["--isolation", mechanism, *(["--core_dumps"] if asked else [])]
    container = start(spawn, "isolated", *arguments)
    with survives(container):
        own = resource.prlimit(container.process.pid, resource.RLIMIT_CORE)
        talker = container.loaded("Talker")
        soft, hard = resource.prlimit(talker.pid, resource.RLIMIT_CORE)
        # A limit of 1, as one of 0 is ignored where cores go to a program.
        assert soft == (hard if asked else 1)
        assert hard == own[1]
        assert resource.prlimit(container.process.pid, resource.RLIMIT_CORE) == own


@both_modes
def test_a_crash_on_a_message(spawn: StartContainer, package: str, mode: str, probe: Probe) -> None:
    container = start(spawn, mode)
    with survives(container):
        crasher = container.loaded("Crasher", package=package)
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
@pytest.mark.parametrize("number", [SIGKILL, *REQUESTS])
def test_a_signal_from_outside(
    spawn: StartContainer, package: str, mode: str, number: signal.Signals, probe: Probe
) -> None:
    container = start(spawn, mode)
    with survives(container):
        victim = container.loaded("Talker", package=package, node_name="victim")
        container.loaded(
            "Talker", package=package, node_name="neighbour", parameters={"rate": 100.0}
        )
        os.kill(victim.pid, number)
        crashed = container.event(CRASHED, unique_id=victim.unique_id)
        assert crashed.signal == number
        assert is_gone(victim.pid)
        # It may die in a publish(), and keep the lock of its writer.
        may_leak = package != SDK and number is SIGKILL
        heard = probe.listen(String, "/chatter")
        probe.spin_until(
            lambda: len(heard) >= 5 or (may_leak and bool(container.status().dead_locks)),
            60.0,
            "the neighbour",
        )
        if len(heard) < 5:
            return  # A supervisor would restart the container now.
        may_leak = may_leak or is_cut_off(crashed)
        assert_cleaned_up(container, crashes=1, may_leak=may_leak)
        # What is asked for by a signal is done in order; only SIGKILL cannot be.
        assert container.status().unquiesced == (1 if number == SIGKILL else 0)


def test_nodes_that_are_ended_while_they_read_a_clock(spawn: StartContainer) -> None:
    container = start(spawn)
    kinds = (CRASHED, CRASHED, UNLOADED, UNLOADED)
    with survives(container):
        busy = [
            container.loaded(
                "Crasher", node_name=f"busy{i}", parameters={"how": "clock", "after": 0.0}
            )
            for i in range(len(kinds))
        ]
        until(
            lambda: container.log.read_text().count("looking at the clock") == len(busy),
            "callbacks that have begun",
        )
        for node in busy[:2]:
            os.kill(node.pid, SIGSEGV)
        for node in busy[2:]:
            container.send(ControlUnload(unique_id=node.unique_id))
        left = {node.unique_id: kind for node, kind in zip(busy, kinds, strict=True)}
        while left:
            end = container.until(
                lambda m: isinstance(m, ComponentEvent) and m.event_type in kinds, f"ends of {left}"
            )
            assert left.pop(end.unique_id) == end.event_type
            assert "did not leave in time" in end.error_message
            assert any("look_at_the_clock" in line for line in end.backtrace), end.backtrace


def test_what_cannot_be_cleaned_up_is_counted(spawn: StartContainer) -> None:
    container = start(spawn, failpoints="container.during_cleanup=hang")
    with survives(container):
        crasher = container.loaded("Crasher", parameters={"after": 0.0})
        container.event(CRASHED, unique_id=crasher.unique_id)
        container.loaded("Talker")
        assert_cleaned_up(container, crashes=1, leaked=1)
        log = container.log.read_text()
        assert "could not clean up after /crasher" in log
        # Where it waited, too.
        assert re.search(r"SIGALRM \(its limit of time is exceeded\).*; at #0 pause", log), log


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
            for verdict in probe.collect(String, "/verdict", 5):
                _, made_at, seen_by, seen_at = verdict.data.split()
                assert (made_at, int(seen_by)) == (seen_at, sink.pid)
            os.kill(sink.pid, number)
            container.event(CRASHED, unique_id=sink.unique_id)
        assert_cleaned_up(container, crashes=3)

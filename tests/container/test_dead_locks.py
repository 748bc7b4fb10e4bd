"""A lock that died with its holder is found, and nothing else is taken for one.

What it was initialising for all is begun anew.
"""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path

import pytest
from play_launch_msgs.msg import ComponentEvent, ControlStatus, ControlUnload

from tests.support.control_peer import Container, StartContainer
from tests.support.isolated import MODES, allocator_environment, start, survives

CRASHED, LOAD_FAILED = ComponentEvent.CRASHED, ComponentEvent.LOAD_FAILED
UNLOADED = ComponentEvent.UNLOADED
LOOK = 0.5
"""Seconds between two looks of a container for such locks."""

both_modes = pytest.mark.parametrize("mode", MODES)


def locker(container: Container, name: str, lock: str, **parameters: float) -> ComponentEvent:
    return container.loaded(
        "Locker", node_name=name, parameters={"lock": lock, "rate": 1000.0, **parameters}
    )


def silence(status: ControlStatus, event: ComponentEvent) -> float:
    """Seconds since that node came round."""
    nanoseconds: int = next(
        node.silence_ns for node in status.nodes if node.unique_id == event.unique_id
    )
    return nanoseconds / 1e9


def holder(container: Container, lock: str) -> ComponentEvent:
    """A locker that has taken the lock and keeps it: in its first callback, after 1 ms."""
    event = locker(container, "holder", lock, hold_from=1)
    container.status_when(lambda status: silence(status, event) > 0.5, "the holder to hold")
    return event


@pytest.mark.parametrize(
    ("mode", "held", "wanted", "number"),
    [
        ("isolated", "mutex", "mutex", signal.SIGKILL),
        ("isolated_mt", "recursive_mutex", "recursive_mutex", signal.SIGABRT),
        ("isolated_mt", "write", "write", signal.SIGKILL),
        ("isolated", "write", "read", signal.SIGABRT),
    ],
)
def test_a_neighbour_waits_for_a_dead_node(
    spawn: StartContainer, mode: str, held: str, wanted: str, number: signal.Signals
) -> None:
    container = start(spawn, mode)
    dying = holder(container, held)
    waiting = locker(container, "waiting", wanted)
    assert not container.status().dead_locks
    os.kill(dying.pid, number)
    container.event(CRASHED, unique_id=dying.unique_id)
    found = container.status_when(lambda status: bool(status.dead_locks), "a report").dead_locks
    assert len(found) == 1
    assert f"of process {waiting.pid} waits for a lock" in found[0]
    assert f"held by process {dying.pid} ('holder')" in found[0]


HANGING_TAKE = """
#include <dlfcn.h>
#include <unistd.h>
#include <cstring>
extern "C" const char* rcl_subscription_get_topic_name(const void*);
extern "C" int rcl_take(const void* subscription, void* message, void* info, void* allocation) {
  using Take = int (*)(const void*, void*, void*, void*);
  static const auto take = reinterpret_cast<Take>(dlsym(RTLD_NEXT, "rcl_take"));
  while (std::strcmp(rcl_subscription_get_topic_name(subscription), "/chatter") == 0) sleep(1);
  return take(subscription, message, info, allocation);
}
"""


def test_a_take_that_never_returns_is_reported(spawn: StartContainer, tmp_path: Path) -> None:
    source, library = tmp_path / "take.cpp", tmp_path / "take.so"
    source.write_text(HANGING_TAKE)
    subprocess.run(["c++", "-shared", "-fPIC", source, "-o", library], check=True)
    preload = {"LD_PRELOAD": f"{allocator_environment()['LD_PRELOAD']}:{library}"}
    # In the other mode a second thread of the node goes on.
    container = start(spawn, "isolated_mt", environment=preload)
    container.loaded("Talker", parameters={"rate": 50.0})
    listener = container.loaded("Listener")
    found = container.status_when(lambda status: bool(status.dead_locks), "a report").dead_locks
    (line,) = found
    assert line.startswith("/listener has been taking one message from the middleware for ")
    os.kill(listener.pid, signal.SIGSTOP)  # as a debugger does
    container.status_when(lambda status: not status.dead_locks, "none")


def test_a_lock_that_a_living_node_keeps_is_none_of_the_dead(spawn: StartContainer) -> None:
    container = start(spawn)
    held = [
        holder(container, "mutex"),
        locker(container, "waiting", "mutex"),
        locker(container, "busy", "none", hold_from=1),
    ]
    crasher = container.loaded("Crasher", parameters={"after": 0.0})
    container.event(CRASHED, unique_id=crasher.unique_id)
    # All three are stuck for as long as the container takes several looks.
    status = container.status_when(
        lambda s: min(silence(s, each) for each in held) > 6 * LOOK, "several looks"
    )
    assert not status.dead_locks


@pytest.mark.parametrize(
    ("mode", "place", "how", "in_constructor"),
    [
        ("isolated", "static", "segv", False),
        ("isolated_mt", "static", "kill", True),
        ("isolated", "call_once", "segv", True),
        ("isolated_mt", "call_once", "kill", False),
    ],
)
def test_what_a_dead_node_was_initialising_is_begun_anew(
    spawn: StartContainer,
    tmp_path: Path,
    mode: str,
    place: str,
    how: str,
    in_constructor: bool,
) -> None:
    container = start(spawn, mode)
    parameters = {
        "in": place,
        "how": how,
        "in_constructor": in_constructor,
        "marker": str(tmp_path / "has_died"),
    }
    with survives(container):
        dying = container.load("DiesOnce", parameters=parameters)
        died = container.event(LOAD_FAILED if in_constructor else CRASHED, attempt=dying)
        assert died.signal == signal.Signals[f"SIG{how.upper()}"]
        again = container.loaded("DiesOnce", parameters=parameters)
        container.status_when(
            lambda _: "Initialised" in container.log.read_text(), "its callback to come round"
        )
        container.send(ControlUnload(unique_id=again.unique_id))
        assert not container.event(UNLOADED, unique_id=again.unique_id).error_message


@both_modes
def test_a_node_tells_whether_it_comes_round(spawn: StartContainer, mode: str) -> None:
    container = start(spawn, mode)
    with survives(container):
        idle = container.loaded("Crasher")
        slow = container.load("SlowConstructor", parameters={"seconds": 3600.0})
        container.event(ComponentEvent.LOADING, attempt=slow)
        by_id = {node.unique_id: node for node in container.status().nodes}
        assert by_id[idle.unique_id].silence_ns >= 0
        others = [node for node in by_id.values() if node.unique_id != idle.unique_id]
        assert [node.silence_ns for node in others] == [-1]

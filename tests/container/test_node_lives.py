"""However a node's life goes, it ends with one event, and its name is its own."""

from __future__ import annotations

import os
import random
import signal
from typing import TYPE_CHECKING

import pytest
from play_launch_msgs.msg import ComponentEvent, ControlCancel, ControlUnload, NodeStatus

from tests.support.isolated import (
    MODES,
    allocator_environment,
    only_these_remain,
    start,
    start_time,
    survives,
)

if TYPE_CHECKING:
    from tests.support.control_peer import Container, StartContainer

LOADING, LOADED, LOAD_FAILED = (
    ComponentEvent.LOADING,
    ComponentEvent.LOADED,
    ComponentEvent.LOAD_FAILED,
)
UNLOADED, CRASHED = ComponentEvent.UNLOADED, ComponentEvent.CRASHED
ENDS = {LOAD_FAILED, UNLOADED, CRASHED}
LIVES = [
    [LOADING, LOAD_FAILED],
    [LOADING, UNLOADED],
    [LOADING, LOADED, UNLOADED],
    [LOADING, LOADED, CRASHED],
]
EVERY_WAY = {"standard": (), **MODES, "process": (*MODES["isolated"], "--isolation", "process")}

both_modes = pytest.mark.parametrize("mode", MODES)


def end_of(container: Container, attempt: int) -> ComponentEvent:
    return container.until(
        lambda m: isinstance(m, ComponentEvent) and m.attempt == attempt and m.event_type in ENDS,
        f"the end of attempt {attempt}",
    )


def lives(container: Container) -> list[list[int]]:
    """Return the types of the events of each attempt, once the container says nothing new."""
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
            lambda status: status.undertaken + status.leaked > 0, "the burial"
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

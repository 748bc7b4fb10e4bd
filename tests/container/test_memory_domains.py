"""Private memory of isolated nodes: what protects it, and what there is without protection keys."""

from __future__ import annotations

import os
import re
import signal
from pathlib import Path

import pytest
from play_launch_msgs.msg import ComponentEvent, ControlHello, ControlUnload

from tests.support.control_peer import Container, StartContainer
from tests.support.isolated import MODES, start, survives
from tests.support.waiting import until

CRASHED, UNLOADED, LOAD_FAILED = (
    ComponentEvent.CRASHED,
    ComponentEvent.UNLOADED,
    ComponentEvent.LOAD_FAILED,
)
BY_POINTER = {"extra_arguments": {"use_intra_process_comms": True}}
MESSAGES = 160_000
HAS_KEYS = "ospke" in Path("/proc/cpuinfo").read_text().split()
needs_keys = pytest.mark.skipif(
    not HAS_KEYS, reason="this machine has no memory protection keys (PKU)"
)
lacks_keys = pytest.mark.skipif(HAS_KEYS, reason="this machine has memory protection keys (PKU)")
both_modes = pytest.mark.parametrize("mode", MODES)

STRAYS = [
    "wild_pointer",
    "dangling_pointer",
    "overflow",
    "memcpy",
    "memset",
    "atomic",
    "insert",
    "deallocate",
    "thread",
    "signal_handler",
]
HARMLESS = ["look", "own_signal_handler", "none"]


def start_guarded(spawn: StartContainer, choice: str, mode: str = "isolated") -> Container:
    return start(spawn, mode, "--memory_domains", choice)


def hello(container: Container) -> ControlHello:
    return next(each for each in container.seen if isinstance(each, ControlHello))


def sightings(container: Container) -> int:
    """How many the mapper has entered; all of them must have come by pointer."""
    lines = re.findall(r"sightings=(\d+) by_pointer=(\d+)", container.log.read_text())
    assert all(entered == by_pointer for entered, by_pointer in lines)
    return int(lines[-1][0]) if lines else 0


def has_survived(container: Container, how: str) -> None:
    until(lambda: f"[{how}]: still there" in container.log.read_text(), how)


@lacks_keys
def test_without_keys_private_memory_is_ordinary_memory(spawn: StartContainer) -> None:
    container = start_guarded(spawn, "auto")
    assert any(
        "private memory of nodes is ordinary memory" in note for note in hello(container).notes
    )
    with survives(container):
        container.loaded("Mapper", **BY_POINTER, parameters={"report_every": 1000})
        container.loaded("Surveyor", **BY_POINTER)
        for how in HARMLESS:
            container.loaded("Trespasser", node_name=how, parameters={"how": how})
            has_survived(container, how)
        until(lambda: sightings(container) >= 5000, "messages")


@lacks_keys
def test_without_keys_a_container_that_requires_them_does_not_start(spawn: StartContainer) -> None:
    container = spawn("--isolated", "--memory_domains", "required", greet=False)
    assert container.wait() == 1
    assert "memory_domains: required, but this processor" in container.log.read_text()


def test_ordinary_processes_need_no_keys(spawn: StartContainer) -> None:
    container = spawn("--isolated", "--isolation", "process", "--memory_domains", "required")
    assert not hello(container).notes
    container.loaded("Mapper")
    assert container.shut_down() == 0


@needs_keys
@both_modes
def test_a_stray_write_ends_the_culprit_alone(spawn: StartContainer, mode: str) -> None:
    container = start_guarded(spawn, "required", mode)
    with survives(container):
        mapper = container.loaded("Mapper", **BY_POINTER, parameters={"report_every": 1000})
        container.loaded("Surveyor", **BY_POINTER)
        for how in STRAYS:
            node = container.loaded("Trespasser", node_name=how, parameters={"how": how})
            crashed = container.event(CRASHED, unique_id=node.unique_id)
            assert crashed.signal == 11, crashed
            assert "write to the private memory of /mapper" in crashed.error_message, crashed
            assert "may hold a lock" not in crashed.error_message, crashed
            assert any("play_launch_demo::" in line for line in crashed.backtrace), crashed
        for how in (*HARMLESS, "read"):  # which is refused
            container.loaded("Trespasser", node_name=how, parameters={"how": how})
            has_survived(container, how)
        before = sightings(container)
        until(lambda: sightings(container) > before, "the mapper to go on")
        crashes = [
            each
            for each in container.seen
            if isinstance(each, ComponentEvent) and each.event_type == CRASHED
        ]
        assert len(crashes) == len(STRAYS)
        assert mapper.unique_id not in {each.unique_id for each in crashes}


@needs_keys
def test_a_constructor_and_a_destructor_are_no_exception(spawn: StartContainer) -> None:
    container = start_guarded(spawn, "auto")
    with survives(container):
        container.loaded("Mapper")
        attempt = container.load("Trespasser", parameters={"in_constructor": True})
        failed = container.event(LOAD_FAILED, attempt=attempt)
        assert "write to the private memory of /mapper" in failed.error_message
        node = container.loaded("Trespasser", parameters={"in_destructor": True})
        container.send(ControlUnload(unique_id=node.unique_id))
        crashed = container.event(CRASHED, unique_id=node.unique_id)
        assert "it did not leave in order: SIGSEGV (write to the private memory of /mapper" in (
            crashed.error_message
        )


@needs_keys
def test_messages_go_by_pointer_as_without(spawn: StartContainer) -> None:
    container = start_guarded(spawn, "required")
    with survives(container):
        container.loaded("Mapper", **BY_POINTER)
        container.loaded("Surveyor", **BY_POINTER, parameters={"burst": 1000})
        until(lambda: sightings(container) >= MESSAGES, "messages")


@needs_keys
def test_more_nodes_than_keys_share_them(spawn: StartContainer) -> None:
    container = start_guarded(spawn, "auto")
    with survives(container):
        for number in range(17):
            container.loaded("Mapper", node_name=f"mapper_{number}")
        log = container.log.read_text()
        shared = re.findall(r"private memory of (/\S+) has the same protection key as that of", log)
        assert shared[-1:] == ["/mapper_16"]
        assert 1 < len(shared) < 8


@needs_keys
def test_a_node_without_a_key_of_its_own_is_refused_where_that_is_required(
    spawn: StartContainer,
) -> None:
    container = start_guarded(spawn, "required")
    with survives(container):
        for number in range(15):
            container.load("Mapper", node_name=f"mapper_{number}")
        # Other code of this process may have taken a key.
        attempts = [container.load("Mapper", node_name=f"late_{number}") for number in range(2)]
        failed = container.event(LOAD_FAILED, attempt=attempts[-1])
        assert "no protection key is left" in failed.error_message


def ended(container: Container, attempt: int) -> ComponentEvent:
    """Result of a load."""
    found = container.until(
        lambda each: (
            isinstance(each, ComponentEvent)
            and each.attempt == attempt
            and each.event_type in {ComponentEvent.LOADED, LOAD_FAILED}
        ),
        f"the end of attempt {attempt}",
    )
    assert isinstance(found, ComponentEvent)
    return found


@needs_keys
def test_a_reloaded_node_has_a_key_although_all_are_taken(spawn: StartContainer) -> None:
    container = start_guarded(spawn, "required")
    with survives(container):
        loaded: list[ComponentEvent] = []
        while True:
            attempt = container.load("Mapper", node_name=f"mapper_{len(loaded)}")
            event = ended(container, attempt)
            if event.event_type == LOAD_FAILED:
                break
            loaded.append(event)
        assert "no protection key is left" in event.error_message
        assert 8 < len(loaded) <= 15
        # At once, as the supervisor does: what the dead have left is still there.
        for round_, victim in enumerate(loaded[:3]):
            os.kill(victim.pid, signal.SIGKILL)
            container.event(CRASHED, unique_id=victim.unique_id)
            again = container.loaded("Mapper", node_name=f"again_{round_}")
            container.send(ControlUnload(unique_id=again.unique_id))
            container.event(UNLOADED, unique_id=again.unique_id)
            container.loaded("Mapper", node_name=f"last_{round_}")

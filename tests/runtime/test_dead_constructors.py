"""What a constructor that died had opened is freed with its container."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from msgspec.structs import replace

from play_launch.config.model import RestartLimits
from play_launch.config.node_key import NodeKey
from play_launch.container.messages import PROTOCOL_VERSION, Hello, Load
from play_launch.supervisor.events import (
    ComponentEventKind,
    ContainerState,
    NodeState,
    ProcessEventKind,
)

from .fakes import FakeContainer, FakeLauncher, Held, container, node, system
from .running import Running, running

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.config.model import ContainerConfig

A = NodeKey("/c", "/a")
SIGNAL, ERROR, FINE = "signal", "error", "fine"
LOADS_END = (NodeState.LOADED, NodeState.LOAD_FAILED)


def launcher(*makers: type[FakeContainer]) -> FakeLauncher:
    return FakeLauncher(makers={"/c": list(makers)})


def driver(*ends: str, mechanism: str = "shared_memory") -> type[FakeContainer]:
    """A container whose loads of node a end like that, one after the other, then well."""

    class Driver(FakeContainer):
        def __init__(self, config: ContainerConfig) -> None:
            self._ends = list(ends)
            super().__init__(config)

        def hello(self, protocol_version: int = PROTOCOL_VERSION) -> Hello:
            return replace(super().hello(protocol_version), mechanism=mechanism)

        def construct(self, held: Held) -> None:
            end = self._ends.pop(0) if held.load.node_name == "a" and self._ends else FINE
            if end == FINE:
                super().construct(held)
                return
            del self.held[held.unique_id]
            signal = 11 if end == SIGNAL else 0
            error = "SIGSEGV" if signal else "the port is in use"
            self.say(ComponentEventKind.LOAD_FAILED, held, error=error, signal=signal)

    return Driver


async def load_again(sys: Running, *, times: int) -> None:
    """Have node a loaded whenever its load has come to an end, until that was so often in all."""

    def ended() -> int:
        return sum(state in LOADS_END for state in sys.node_states("/a"))

    for _ in range(times - 1):
        await _after(sys, ended)
        sys.operated.restart(A)
    await _after(sys, ended)


async def _after(sys: Running, count: Callable[[], int]) -> None:
    """Wait until that has grown."""
    before = count()
    await sys.until(lambda: count() > before)


async def test_what_a_dead_constructor_had_opened_is_freed_with_its_container() -> None:
    makers = driver(SIGNAL, ERROR), driver()
    async with running(system(container("c", "a", "b")), launcher(*makers)) as sys:
        await load_again(sys, times=2)
        await sys.until(lambda: len(sys.launcher.containers["/c"]) == 2)
        await sys.until_loaded(2)
        assert sys.launcher.containers["/c"][0].process.stopped_with == ["ask"]
    (stopping,) = sys.container_events("/c", ContainerState.STOPPING)[:1]
    assert stopping.reason == (
        "/a cannot be loaded, and its constructor died in this container before (SIGSEGV): "
        "what it had opened stays open: the port is in use"
    )
    failed = sys.node_events("/a", NodeState.LOAD_FAILED)[-1]
    assert failed.reason == "the port is in use; its container is started anew"
    assert ProcessEventKind.RESTARTING not in sys.process_events("/c")


async def test_a_reload_that_fails_is_not_repeated_meanwhile() -> None:
    class Crashes(driver(FINE, SIGNAL, ERROR)):  # type: ignore[misc]
        def construct(self, held: Held) -> None:
            super().construct(held)
            if held.load.node_name == "a" and held.loaded:
                self.crash_node("a")

    limited = node("a", restart=RestartLimits(max_restarts=2))
    config = system(container("c", limited, "b"))
    async with running(config, launcher(Crashes, driver())) as sys:
        await sys.until(lambda: len(sys.launcher.containers.get("/c", ())) == 2)
        await sys.until_loaded(2)
    sent = sys.launcher.containers["/c"][0].link.sent
    loads = [each for each in sent if isinstance(each, Load) and each.node_name == "a"]
    assert len(loads) == 3
    assert NodeState.GAVE_UP not in sys.node_states("/a")


@pytest.mark.parametrize(
    ("ends", "options"),
    [
        ((ERROR, ERROR, ERROR), {}),
        ((SIGNAL, SIGNAL, SIGNAL), {}),
        ((SIGNAL, FINE, ERROR), {}),
        ((SIGNAL, ERROR), {"mechanism": "process"}),
        ((SIGNAL, ERROR), {"mechanism": ""}),
        ((SIGNAL, ERROR), {"max_restarts": 0}),
    ],
)
async def test_a_container_is_not_restarted_where_that_would_not_help(
    ends: tuple[str, ...], options: dict[str, Any]
) -> None:
    restarts = options.pop("max_restarts", 3)

    config = system(container("c", "a", "b", max_restarts=restarts))
    async with running(config, launcher(driver(*ends, **options))) as sys:
        await load_again(sys, times=len(ends) + 1)
        await sys.until_loaded(2)
        assert sys.container_states("/c").count(ContainerState.STARTING) == 1


async def test_a_container_is_started_anew_once_for_a_node_that_never_comes() -> None:
    config = system(container("c", "a", "b"))
    async with running(config, launcher(driver(SIGNAL, ERROR, ERROR))) as sys:
        await load_again(sys, times=5)
        assert len(sys.launcher.containers["/c"]) == 2

"""The actors with real containers and real processes."""

from __future__ import annotations

import asyncio
import platform
import re
import sys
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import psutil
import pytest
from msgspec.structs import replace

from play_launch.config.model import (
    ComposableNodeConfig,
    ContainerConfig,
    ContainerType,
    OnExit,
    ParameterConfig,
    ParameterType,
    ParameterValue,
    ProcessConfig,
    RestartLimits,
)
from play_launch.config.node_key import NodeKey
from play_launch.ros.fastdds.shared_memory import SweepReport
from play_launch.runtime.launcher import NativeLauncher
from play_launch.runtime.publisher import Publisher
from play_launch.runtime.run import run_system
from play_launch.runtime.stock_containers import StockContainers
from play_launch.supervisor.events import (
    NodeState,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
)
from play_launch.supervisor.world import Limits
from tests.support.stock import EXECUTABLE, PACKAGE, install

from .fakes import system
from .running import Running

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    from play_launch.config.model import ReplayConfig
    from play_launch.container.messages import Incoming
    from play_launch.process.lines import OutputCallback
    from play_launch.runtime.launcher import ControlLink, ManagedProcess

REAL_TIME = True
QUICK = RestartLimits(max_restarts=2, within=60.0, initial=0.05, maximum=0.1)


def parameter(name: str, value: float | bool | str) -> ParameterConfig:
    kinds = {bool: ParameterType.BOOL, float: ParameterType.DOUBLE, str: ParameterType.STRING}
    return ParameterConfig(name, ParameterValue(kinds[type(value)], value))


def node(
    name: str, plugin: str, package: str = "play_launch_demo", **parameters: float | bool | str
) -> ComposableNodeConfig:
    return ComposableNodeConfig(
        package=package,
        plugin=f"{package}::{plugin}",
        name=name,
        namespace="/",
        key=NodeKey("", f"/{name}"),
        parameters=tuple(parameter(key, value) for key, value in parameters.items()),
    )


def container(name: str, *nodes: ComposableNodeConfig, timeout: float = 10.0) -> ContainerConfig:
    return ContainerConfig(
        name=name,
        namespace="/",
        full_name=f"/{name}",
        restart=QUICK,
        loading_timeout=timeout,
        composable_nodes=tuple(
            replace(each, key=NodeKey(f"/{name}", each.key.name)) for each in nodes
        ),
    )


def python(name: str, code: str, *, on_exit: OnExit = OnExit.IGNORE) -> ProcessConfig:
    return ProcessConfig(
        name="",
        namespace="",
        full_name=f"/{name}",
        command=(sys.executable, "-c", code),
        on_exit=on_exit,
        restart=QUICK,
    )


@asynccontextmanager
async def running_natively(
    config: ReplayConfig, launcher: NativeLauncher | None = None, limits: Limits | None = None
) -> AsyncIterator[Running]:
    watching = Running()
    publisher, stop, begins = Publisher(watching), watching.stop, watching.begins
    watching.task = asyncio.create_task(
        run_system(config, publisher, stop, launcher=launcher, limits=limits, on_begin=begins)
    )
    try:
        async with asyncio.timeout(60):
            yield watching
            watching.stop.request(reason="the test is over")
            watching.outcome = await watching.task
    finally:
        watching.task.cancel()
        await asyncio.gather(watching.task, return_exceptions=True)
    assert not psutil.Process().children(recursive=True)


def pid_of(watching: Running, name: str) -> int:
    return watching.view.containers[name].process.pid


async def test_a_fault_of_our_own_stops_one_container_in_order_and_no_other() -> None:

    broken: list[ControlLink] = []

    class Launcher(NativeLauncher):
        async def start_container(
            self, config: ContainerConfig, on_output: OutputCallback
        ) -> tuple[ManagedProcess, ControlLink]:
            process, link = await super().start_container(config, on_output)
            if config.name == "bad":
                broken.append(link)
            return process, link

    config = system(
        container("bad", node("a", "Talker")),
        container("good", node("b", "Listener")),
        python("driver", "import time; time.sleep(600)"),
    )
    async with running_natively(config, await asyncio.to_thread(Launcher, config)) as sys:
        await sys.until_loaded(2)

        async def fails() -> Incoming:
            raise RuntimeError("failed to send the request")

        broken[0].receive = fails  # type: ignore[method-assign] # from its next message on
        await sys.until(lambda: "/bad" in sys.gave_up())
        await sys.until(lambda: ProcessEventKind.EXITED in sys.process_events("/bad"))
        assert sys.view.loaded == 1
        assert not set(sys.process_events("/good")) - {
            ProcessEventKind.STARTED,
            ProcessEventKind.READY,
        }
        assert sys.process_events("/driver") == [ProcessEventKind.STARTED]
    (ended,) = (
        event
        for event in sys.events
        if isinstance(event, ProcessEvent)
        and (event.name, event.kind) == ("/bad", ProcessEventKind.EXITED)
    )
    assert (ended.exit_code, ended.signal) == (0, 0), "it was asked, and ended in order"
    assert "RuntimeError" in sys.gave_up()["/bad"]
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 1


async def test_loads_fail_with_reasons_and_the_others_are_there() -> None:
    nodes = (
        node("throws", "ThrowingConstructor", reason="no such camera"),
        node("absent", "Absent"),
        node("broken", "MissingSymbol", package="play_launch_broken"),
        node("a", "Talker"),
    )
    async with running_natively(system(container("c", *nodes))) as sys:
        await sys.until(lambda: len(sys.view.failed) == 3)
        await sys.until_loaded(1)
        reasons = {each.node: each.reason for each in sys.view.failed}
    assert "no such camera" in reasons["/throws"]
    assert "Absent" in reasons["/absent"]
    assert reasons["/broken"]
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 1


async def test_a_slow_constructor_is_asked_about_and_loaded_once() -> None:
    slow = node("slow", "SlowConstructor", seconds=1.5)
    async with running_natively(system(container("c", slow, timeout=0.5))) as sys:
        await sys.until_loaded(1)
        report = sys.node_events("/slow", NodeState.LOADING)[1]
        assert report.pid == pid_of(sys, "/c")
        assert "its constructor runs for" in report.reason
    assert len(sys.node_events("/slow", NodeState.REQUESTED)) == 1


@pytest.mark.skipif(platform.machine() not in {"x86_64", "aarch64"}, reason="names of system calls")
async def test_what_a_constructor_waits_for_is_reported_in_every_mode() -> None:
    types = [each for each in ContainerType if each is not ContainerType.STOCK]

    config = system(
        *(
            replace(
                container(each, node(f"in_{each}", "SlowConstructor", seconds=3600.0), timeout=0.5),
                container_type=each,
            )
            for each in types
        )
    )
    async with running_natively(config, limits=Limits(report_interval=0.5)) as sys:

        def is_seen(name: str) -> bool:
            reasons = [event.reason for event in sys.node_events(name, NodeState.LOADING)]
            return any(re.search("; it waits in .*nanosleep", each) for each in reasons)

        await sys.until(lambda: all(is_seen(f"/in_{each}") for each in types))
    for each in types:
        assert len(sys.node_events(f"/in_{each}", NodeState.REQUESTED)) == 1


async def test_fifteen_containers_come_up_together() -> None:
    config = system(
        *(container(f"c{n}", *(node(f"n{n}_{k}", "Listener") for k in range(4))) for n in range(15))
    )
    async with running_natively(config) as sys:
        await sys.until_loaded(60)
        assert all(len(sys.node_events(f"/n{n}_0", NodeState.REQUESTED)) == 1 for n in range(15))
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 0


async def test_parameters_reach_an_ordinary_process_and_their_files_go() -> None:
    show = python("show", "import sys; print(*sys.argv[1:], sep=chr(10), flush=True)")
    show = replace(show, name="show", parameters=(parameter("rate", 2.0),))
    async with running_natively(system(show)) as sys:
        await sys.stop.requested.wait()
    arguments = [e.text for e in sys.events if isinstance(e, OutputLine)]
    file = Path(arguments[arguments.index("--params-file") + 1])
    assert not file.parent.exists()


async def test_a_stock_container_that_cannot_be_talked_to_is_not_left_running(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    double = install(tmp_path)
    double.program.write_text("#!/bin/sh\nexec sleep 6000\n")
    stock = replace(
        container("s"),
        container_type=ContainerType.STOCK,
        package=PACKAGE,
        executable=EXECUTABLE,
        environment=double.environment,
    )

    monkeypatch.setattr(StockContainers, "talk_to", lambda *_: 1 / 0)

    async with running_natively(system(stock, container("c"))) as sys:
        await sys.until(lambda: "/s" in sys.gave_up())
        while any(p.name() == "sleep" for p in psutil.Process().children(recursive=True)):
            await asyncio.sleep(0.05)


async def test_a_cancelled_run_leaves_nothing() -> None:
    watching = Running()
    config = system(container("a", node("talker", "Talker")), python("p", "input()"))
    task = asyncio.create_task(run_system(config, Publisher(watching), watching.stop))
    await watching.until_loaded(1)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert not psutil.Process().children(recursive=True)


async def test_clean_ups_at_the_same_time_are_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As the containers do that one signal has ended; each look goes through all of /proc."""
    sweeps = 0

    async def sweep() -> SweepReport:
        nonlocal sweeps
        sweeps += 1
        await asyncio.sleep(0)
        return SweepReport()

    monkeypatch.setattr("play_launch.runtime.launcher.sweep_shared_memory", sweep)

    launcher = await asyncio.to_thread(NativeLauncher, system(container("c")))
    try:
        await asyncio.gather(*(launcher.clean_up() for _ in range(15)))
        # The first is under way already when the others ask.
        assert sweeps <= 2
        await launcher.clean_up()
        assert sweeps <= 3
    finally:
        await launcher.close()

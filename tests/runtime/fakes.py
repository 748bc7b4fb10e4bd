"""A machine without processes: scripted containers and executables."""

from __future__ import annotations

import asyncio
import itertools
import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from msgspec.structs import replace

from play_launch.config.model import (
    ComposableNodeConfig,
    ContainerConfig,
    OnCrash,
    OnExit,
    ProcessConfig,
    ReplayConfig,
    RestartLimits,
)
from play_launch.config.node_key import NodeKey
from play_launch.container.channel import ChannelClosedError, ControlChannel, VersionMismatchError
from play_launch.container.codec import ControlError
from play_launch.container.messages import (
    PROTOCOL_VERSION,
    Accepted,
    Cancel,
    Hello,
    Incoming,
    Load,
    NodeStatus,
    NodeStatusState,
    Outgoing,
    Query,
    Rejected,
    Shutdown,
    Status,
    Unload,
)
from play_launch.process.child import Child
from play_launch.process.exit import Exit
from play_launch.process.lines import Line
from play_launch.process.stop import StopPolicy
from play_launch.runtime.launcher import MemberGroups, NativeLauncher
from play_launch.supervisor.events import ComponentEvent, ComponentEventKind, Stream

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.process.lines import OutputCallback
    from play_launch.runtime.launcher import StartError


class FakeProcess(Child):
    _pids = itertools.count(100)

    def __init__(self, argv: tuple[str, ...]) -> None:
        self.pid = next(self._pids)
        self.start_time = self.pid * 10
        self.argv = argv
        self.exit: Exit | None = None
        self.stopped_with: list[str] = []
        self.deaf_to: set[str] = set()
        self.stop_takes = 0.1
        self.lingers = 0.0
        """Seconds from its end to the end of what it leaves."""
        self.on_end: Callable[[], None] = lambda: None
        self._end_seen = asyncio.Event()

    def end(self, exit_: Exit) -> None:
        if self.exit is None:
            self.exit = exit_
            self._end_seen.set()
            self.on_end()

    async def wait(self) -> Exit:
        await self._end_seen.wait()
        assert self.exit is not None
        return self.exit

    async def gone(self) -> Exit:
        exit_ = await self.wait()
        await asyncio.sleep(self.lingers)
        return exit_

    def kill(self) -> None:
        self.stopped_with.append("kill")
        self.end(Exit(signal=9))

    async def stop(
        self, policy: StopPolicy, *, ask: Callable[[], bool] | None, hurry: asyncio.Event
    ) -> bool:
        levels = ([("ask", Exit())] if ask else []) + [
            ("SIGINT", Exit(signal=2)),
            ("SIGKILL", Exit(signal=9)),
        ]
        for level, exit_ in levels:
            if self.exit is not None:
                break
            self.stopped_with.append(level)
            if level == "ask" and ask is not None:
                ask()
            elif level not in self.deaf_to:
                self.end(exit_)
            waits = [asyncio.ensure_future(self.wait()), asyncio.ensure_future(hurry.wait())]
            try:
                await asyncio.wait(waits, timeout=2.0, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for wait in waits:
                    wait.cancel()
                await asyncio.gather(*waits, return_exceptions=True)
        return self.exit is not None


class FakeLink(ControlChannel):
    def __init__(self, container: FakeContainer) -> None:
        self._container = container
        self._incoming: asyncio.Queue[Incoming | ControlError] = asyncio.Queue()
        self.sent: list[Outgoing] = []
        """Everything but the questions that only ask whether it still answers."""
        self.closed = False

    def say(self, *messages: Incoming | ControlError) -> None:
        for message in messages:
            self._incoming.put_nowait(message)

    async def handshake(self, hello: Hello) -> Hello:
        first = await self.receive()
        assert isinstance(first, Hello)
        if first.protocol_version != PROTOCOL_VERSION:
            raise VersionMismatchError(first.protocol_version)
        self.send(hello)
        return first

    async def receive(self) -> Incoming:
        message = await self._incoming.get()
        if isinstance(message, ControlError):
            self._incoming.put_nowait(message)
            raise message
        return message

    def send(self, message: Outgoing) -> None:
        if self.closed or self._container.process.exit is not None:
            raise ChannelClosedError("the container is gone")
        if isinstance(message, Query) and message.unique_ids == (0,):
            self._container.on_watch(message)
            return
        self.sent.append(message)
        self._container.hear(message)

    def close(self) -> None:
        self.closed = True


@dataclass
class Held:
    load: Load
    unique_id: int
    loaded: bool = False


class FakeContainer:
    """Behaves; tests override what they want it to do wrong."""

    def __init__(self, config: ContainerConfig) -> None:
        self.config = config
        self.process = FakeProcess(("component_container", config.full_name))
        self.link = FakeLink(self)
        self.held: dict[int, Held] = {}
        self.process.on_end = lambda: self.link.say(ChannelClosedError("closed"))
        self._ids = itertools.count(1)
        self.start()

    def start(self) -> None:
        self.link.say(self.hello())

    def hello(self, protocol_version: int = PROTOCOL_VERSION) -> Hello:
        return Hello(
            version="1",
            protocol_version=protocol_version,
            pid=self.process.pid,
            full_node_name=self.config.full_name,
            mode="standard",
        )

    def hear(self, message: Outgoing) -> None:
        match message:
            case Load():
                self.on_load(message)
            case Query():
                self.on_query(message)
            case Cancel() | Unload():
                self.on_unload(message.unique_id)
            case Shutdown():
                self.on_shutdown()

    def on_load(self, load: Load) -> None:
        held = self.take(load)
        self.construct(held)

    def take(self, load: Load) -> Held:
        held = Held(load, next(self._ids))
        self.held[held.unique_id] = held
        self.link.say(Accepted(attempt=load.attempt, unique_id=held.unique_id))
        self.say(ComponentEventKind.LOADING, held)
        return held

    def construct(self, held: Held) -> None:
        held.loaded = True
        self.say(ComponentEventKind.LOADED, held)

    def on_query(self, query: Query) -> None:
        self.link.say(
            Status(
                query_id=query.query_id,
                nodes=tuple(
                    self.status(held)
                    for held in self.held.values()
                    if not query.unique_ids or held.unique_id in query.unique_ids
                ),
            )
        )

    def on_watch(self, query: Query) -> None:
        self.link.say(Status(query_id=query.query_id))

    def status(self, held: Held) -> NodeStatus:
        state = NodeStatusState.LOADED if held.loaded else NodeStatusState.CONSTRUCTING
        return NodeStatus(
            unique_id=held.unique_id,
            attempt=held.load.attempt,
            state=state,
            full_node_name=self.name_of(held),
            pid=self.process.pid,
            elapsed_ns=10_000_000_000,
            cpu_time_ns=3_000_000_000,
        )

    def name_of(self, held: Held) -> str:
        return f"{held.load.node_namespace.rstrip('/')}/{held.load.node_name}"

    def on_unload(self, unique_id: int) -> None:
        held = self.held.pop(unique_id, None)
        if held is None:
            self.link.say(Rejected(attempt=0, unique_id=unique_id, reason="no such node"))
        else:
            self.say(ComponentEventKind.UNLOADED, held)

    def on_shutdown(self) -> None:
        for unique_id in list(self.held):
            self.on_unload(unique_id)
        self.process.end(Exit())

    def crash_node(self, name: str, signal: int = 11, **facts: Any) -> None:
        """As an isolated container tells it; it lives on."""
        held = next(each for each in self.held.values() if each.load.node_name == name)
        del self.held[held.unique_id]
        self.say(ComponentEventKind.CRASHED, held, signal=signal, **facts)

    def crash(self, signal: int = 11) -> None:
        self.process.end(Exit(signal=signal))

    def say(
        self,
        kind: ComponentEventKind,
        held: Held,
        error: str = "",
        signal: int = 0,
        backtrace: tuple[str, ...] = (),
    ) -> None:
        self.link.say(
            ComponentEvent(
                stamp_ns=1,
                kind=kind,
                container=self.config.full_name,
                unique_id=held.unique_id,
                attempt=held.load.attempt,
                full_node_name=self.name_of(held),
                package_name=held.load.package_name,
                plugin_name=held.load.plugin_name,
                error_message=error,
                pid=self.process.pid,
                signal=signal,
                backtrace=backtrace,
            )
        )


def found(process: FakeProcess, on_output: OutputCallback, **values: Any) -> None:
    """End as the scratch process that loaded a library, with what it says."""
    told = {"library": "/lib.so", "error": "", "signal": 0, "backtrace": [], **values}
    on_output(Stream.STDOUT, [Line(json.dumps(told))])
    process.end(Exit(code=1 if told["error"] else 0))


def found_good(name: str, process: FakeProcess, on_output: OutputCallback) -> None:
    found(process, on_output)


class NoGroups(MemberGroups):
    def __init__(self) -> None:
        pass

    def enter(self, config: ComposableNodeConfig, attempt: int) -> tuple[str, ...]:
        return ()

    def leave(self, attempt: int) -> str:
        return ""

    def check(self, full_name: str, pid: int) -> None:
        pass


@dataclass
class FakeLauncher(NativeLauncher):
    """Starts fakes; the n-th start of a container takes the n-th of its makers, then the last."""

    makers: dict[str, list[Callable[[ContainerConfig], FakeContainer]]] = field(
        default_factory=dict
    )
    containers: dict[str, list[FakeContainer]] = field(default_factory=dict)
    processes: dict[str, list[FakeProcess]] = field(default_factory=dict)
    on_process: Callable[[FakeProcess], None] = lambda process: None
    libraries: dict[str, str] = field(default_factory=dict)
    probes: list[tuple[str, FakeProcess]] = field(default_factory=list)
    on_probe: Callable[[str, FakeProcess, OutputCallback], None] = found_good
    failures: dict[str, StartError] = field(default_factory=dict)
    prepared: list[ReplayConfig] = field(default_factory=list)
    cleaned: int = 0
    cleaned_before_a_start: list[int] = field(default_factory=list)
    closed: bool = False
    groups: MemberGroups = field(default_factory=NoGroups)
    hello: Hello = field(default_factory=lambda: Hello(version="1"))
    policy: StopPolicy = field(default_factory=StopPolicy)

    async def start_container(
        self, config: ContainerConfig, on_output: OutputCallback
    ) -> tuple[FakeProcess, FakeLink]:
        name = config.full_name
        self.cleaned_before_a_start.append(self.cleaned)
        if name in self.failures:
            raise self.failures[name]
        started = self.containers.setdefault(name, [])
        assert all(each.process.exit is not None for each in started), "two processes for one"
        makers = self.makers.get(name, [FakeContainer])
        container = makers[min(len(started), len(makers) - 1)](config)
        started.append(container)
        return container.process, container.link

    async def start_process(self, config: ProcessConfig, on_output: OutputCallback) -> FakeProcess:
        if config.full_name in self.failures:
            raise self.failures[config.full_name]
        process = FakeProcess(config.command or ())
        self.processes.setdefault(config.full_name, []).append(process)
        self.on_process(process)
        return process

    async def library_of(self, container: ContainerConfig, node: ComposableNodeConfig) -> str:
        return self.libraries.get(node.name, node.name)

    async def start_probe(
        self, container: ContainerConfig, node: ComposableNodeConfig, on_output: OutputCallback
    ) -> FakeProcess:
        if "probe" in self.failures:
            raise self.failures["probe"]
        process = FakeProcess(("component_container", "--probe", node.package, node.plugin))
        self.probes.append((node.name, process))
        # Nothing is heard of a process before it has been started.
        asyncio.get_running_loop().call_soon(self.on_probe, node.name, process, on_output)
        return process

    async def prepare(self, config: ReplayConfig) -> None:
        self.prepared.append(config)

    async def clean_up(self) -> None:
        self.cleaned += 1

    async def close(self) -> None:
        self.closed = True

    def alive(self) -> list[FakeProcess]:
        containers = [each.process for started in self.containers.values() for each in started]
        processes = [each for started in self.processes.values() for each in started]
        probes = [process for _, process in self.probes]
        everything = (*containers, *processes, *probes)
        return [process for process in everything if process.exit is None]


def node(
    name: str, on_crash: OnCrash = OnCrash.RELOAD, restart: RestartLimits | None = None
) -> ComposableNodeConfig:
    return ComposableNodeConfig(
        package="demo",
        plugin="demo::Node",
        name=name,
        namespace="/",
        key=NodeKey("", f"/{name}"),
        on_crash=on_crash,
        restart=restart or RestartLimits(max_restarts=3),
    )


def container(
    name: str, *nodes: str | ComposableNodeConfig, max_restarts: int = 3
) -> ContainerConfig:
    declared = [node(each) if isinstance(each, str) else each for each in nodes]
    return ContainerConfig(
        name=name,
        namespace="/",
        full_name=f"/{name}",
        restart=RestartLimits(max_restarts=max_restarts),
        composable_nodes=tuple(
            replace(each, key=NodeKey(f"/{name}", each.key.name)) for each in declared
        ),
    )


def process(name: str, *, on_exit: OnExit = OnExit.IGNORE, max_restarts: int = 3) -> ProcessConfig:
    return ProcessConfig(
        name=name,
        namespace="/",
        full_name=f"/{name}",
        command=(name,),
        on_exit=on_exit,
        restart=RestartLimits(max_restarts=max_restarts),
    )


def system(
    *members: ContainerConfig | ProcessConfig, duration: float | None = None
) -> ReplayConfig:
    from pathlib import Path

    return ReplayConfig(
        name="test",
        source=Path("test.yaml"),
        text=b"",
        duration=duration,
        containers=tuple(each for each in members if isinstance(each, ContainerConfig)),
        nodes=tuple(each for each in members if isinstance(each, ProcessConfig)),
    )

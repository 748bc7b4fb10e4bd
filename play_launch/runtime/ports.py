"""What the actors need of the outside world.

:mod:`play_launch.runtime.launcher` fulfils it with real processes, tests with scripted ones.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Collection, Iterable, Mapping, Sequence
    from contextlib import AbstractAsyncContextManager

    from play_launch.config.dependency import Condition
    from play_launch.config.model import (
        ComposableNodeConfig,
        ContainerConfig,
        ParameterConfig,
        ProcessConfig,
        ReplayConfig,
    )
    from play_launch.config.node_key import NodeKey
    from play_launch.container.messages import Hello, Incoming, Outgoing
    from play_launch.process.exit import Exit
    from play_launch.process.lines import OutputCallback


OnGraphChange = Callable[["Collection[tuple[Condition, str]]"], None]
"""Gets what exists of what is watched: NODE, TOPIC or SERVICE, with a full name."""


class StartError(Exception):
    """A process could not be started.

    Attributes:
        permanent: Whether the next try would fail in the same way.
    """

    def __init__(self, reason: str, *, permanent: bool) -> None:
        super().__init__(reason)
        self.permanent = permanent


class ManagedProcess(Protocol):
    """A process that we started."""

    @property
    def pid(self) -> int:
        """Its pid."""

    @property
    def start_time(self) -> int:
        """Clock ticks after boot."""

    @property
    def argv(self) -> tuple[str, ...]:
        """Its command line."""

    async def wait(self) -> Exit:
        """Wait until the process itself has ended."""

    async def gone(self) -> Exit:
        """Wait until nothing of it is left, its children and its output included."""

    def kill(self) -> None:
        """Kill it at once; harmless when it has ended."""

    async def stop(self, *, ask: Callable[[], bool] | None, hurry: asyncio.Event) -> bool:
        """Stop it and everything it left behind, from gentle to hard.

        Args:
            ask: Asks it in its own language; False when it could not be asked.
            hurry: Set to skip to the next stop signal.

        Returns:
            Whether it has ended; False when not even SIGKILL did it in time.
        """


class ControlLink(Protocol):
    """Our end of a control channel; errors as :mod:`play_launch.container.channel` has them."""

    async def handshake(self, hello: Hello) -> Hello:
        """Wait for the container's hello and answer it."""

    async def receive(self) -> Incoming:
        """Wait for the next message."""

    def send(self, message: Outgoing) -> None:
        """Send a message, without waiting."""

    def close(self) -> None:
        """Close it; a container that still runs stops in order then."""


class ParameterService(Protocol):
    """Sets parameters of nodes that run."""

    async def set(
        self,
        node: str,
        parameters: Sequence[ParameterConfig],
        environment: Mapping[str, str],
    ) -> str:
        """Set all of them or none.

        Args:
            node: Its full name.
            parameters: What it is to take.
            environment: The variables that the configuration gives its process.

        Returns:
            Why they are not set; empty when they are.
        """

    async def close(self) -> None:
        """Give back what it takes to talk to nodes."""


class ManagedNode(Protocol):
    """A way to talk to a managed node."""

    is_offered: bool
    """Whether its services have been available."""

    async def state(self) -> int:
        """Wait for its services and ask for its state, a number of ``lifecycle_msgs``."""

    async def change(self, transition: int) -> bool:
        """Ask for a transition and wait for its end; whether it succeeded."""


class Graph(Protocol):
    """A view of the ROS graph, see :mod:`play_launch.ros.graph_source`."""

    def watch(self, wanted: Iterable[tuple[Condition, str]]) -> None:
        """Watch these, and no others."""

    async def close(self) -> None:
        """End it."""


class RosAccess(Protocol):
    """What is asked of ROS for those that wait; fulfilled by :mod:`play_launch.ros.access`."""

    def watch_graph(self, on_change: OnGraphChange) -> Graph:
        """Give a view of the graph; it watches nothing yet."""

    def managed_node(
        self, name: str, on_state: Callable[[int], None]
    ) -> AbstractAsyncContextManager[ManagedNode]:
        """Give a client of a managed node; ``on_state`` gets every state that it enters."""


class NodeGroups(Protocol):
    """The control groups of nodes that are processes of their own."""

    def enter(self, config: ComposableNodeConfig, attempt: int) -> tuple[str, ...]:
        """Make the group of a node that is about to be loaded.

        Returns:
            What its process asks of the kernel to be born in it; nothing where there are none.

        Raises:
            StartError: When it has to have one, and cannot.
        """

    def leave(self, key: NodeKey, attempt: int) -> str:
        """Kill what an exited node left; returns why the kernel killed the node, if it did."""

    def check(self, full_name: str, pid: int) -> None:
        """Report the process of a member or node that is not in the group it was given."""


class Launcher(Protocol):
    """Starts processes; a start that is cancelled leaves none."""

    @property
    def groups(self) -> NodeGroups:
        """The control groups of nodes."""

    def hello(self) -> Hello:
        """Give the hello of the supervisor."""

    async def start_container(
        self, config: ContainerConfig, on_output: OutputCallback
    ) -> tuple[ManagedProcess, ControlLink]:
        """Start a container.

        Raises:
            StartError: When that is not possible.
        """

    async def library_of(self, container: ContainerConfig, node: ComposableNodeConfig) -> str:
        """Find the library of a component; empty where that is not known."""

    async def start_probe(
        self, container: ContainerConfig, node: ComposableNodeConfig, on_output: OutputCallback
    ) -> ManagedProcess:
        """Start a scratch process that loads the library of a node as the container would.

        Raises:
            StartError: When that is not possible.
        """

    async def start_process(
        self, config: ProcessConfig, on_output: OutputCallback
    ) -> ManagedProcess:
        """Start an ordinary executable.

        Raises:
            StartError: When that is not possible.
        """

    async def prepare(self, config: ReplayConfig) -> None:
        """Get ready for what a system needs that is to become this one.

        Raises:
            StartError: When something is not there.
        """

    async def clean_up(self) -> None:
        """Remove what killed processes left behind in the system."""

    async def close(self) -> None:
        """Give back what belongs to the launcher itself."""

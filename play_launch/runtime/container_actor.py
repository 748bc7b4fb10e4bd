"""One container: its process, its control channel, and whether it still answers."""

from __future__ import annotations

import logging
from functools import partial
from itertools import groupby
from typing import TYPE_CHECKING, Final

import anyio
from msgspec.structs import replace

from play_launch.container.channel import ChannelClosedError, VersionMismatchError
from play_launch.container.codec import ControlError, EncodeError
from play_launch.container.messages import Hello as HelloMessage
from play_launch.container.messages import Shutdown, Status, lock_holder
from play_launch.recording.console_format import logger_of, loggers_in
from play_launch.runtime.container_messages import (
    Queries,
    description,
    inputs_of,
    isolation_shortfall,
    load_request,
)
from play_launch.runtime.launcher import StartError
from play_launch.runtime.probes import probe_nodes
from play_launch.runtime.process_actor import ProcessActor
from play_launch.runtime.shared_process import SharedMember
from play_launch.runtime.watchdog import ContainerWatch
from play_launch.supervisor.events import ComponentEvent, NodeState
from play_launch.supervisor.inputs import Faulty, Greeted, HealthReported, NodeReported
from play_launch.supervisor.outcome import Cause
from play_launch.supervisor.transitions import IDLE, NodeFact, next_state
from play_launch.supervisor.world import Hello, Phase, is_wanted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from play_launch.config.model import ContainerConfig
    from play_launch.config.node_key import NodeKey
    from play_launch.container.messages import Incoming, Outgoing
    from play_launch.process.lines import Line
    from play_launch.runtime.launcher import ControlLink, ManagedProcess
    from play_launch.runtime.system import System
    from play_launch.supervisor.events import Stream
    from play_launch.supervisor.world import Node

_log = logging.getLogger(__name__)

_LAST_WORDS: Final = 0.5
"""Seconds from the exit of a container to the end of what it sent on the control channel."""
_EXIT_AFTER_CLOSE: Final = 2.0
"""Seconds from the end of the control channel to the exit of the container."""


class ContainerActor(ProcessActor):
    """Owns the process of one container and its channel."""

    def __init__(self, name: str, system: System) -> None:
        super().__init__(name, system)
        self._link: ControlLink | None = None
        self._listening: anyio.CancelScope | None = None
        self._has_ended = anyio.Event()
        self._is_draining = False
        """Whether its process exited, and what it sent before is still read."""
        self._well_with: tuple[int, int] | None = None
        """Counts of the last answer if that is no news when it is repeated; else None."""
        self._queries = Queries(name)
        self._dropped = 0
        """Frames that its process has dropped so far."""
        self._watch = ContainerWatch(name, self.send, 0)
        self._watching: anyio.CancelScope | None = None
        self._probes: list[anyio.CancelScope] = []

    @property
    def config(self) -> ContainerConfig:
        """Of its unit."""
        config = self._system.world.processes[self.name].container
        assert config is not None
        return config

    # Its process.

    async def _begin(self) -> ManagedProcess:
        self._has_ended = anyio.Event()
        self._is_draining = False
        self._well_with = None
        self._dropped = 0
        self._queries.clear()
        launcher = self._system.launcher
        process, self._link = await launcher.start_container(self.config, self._on_output)
        return process

    def _has_started(self, start: int) -> None:
        assert self._link is not None
        listen = partial(self._listen, self._link, start, self._has_ended)
        self._listening = self._system.tasks.begin(listen, self.name)

    def _ask_to_stop(self, reason: str) -> bool:
        if self._link is None:
            return False
        try:
            self._link.send(Shutdown(reason=reason))
        except ControlError:
            return False
        return True

    def _stops(self) -> None:
        """Silence means nothing from now on."""
        if self._watching is not None:
            self._watching.cancel()
            self._watching = None

    async def _drained(self) -> None:
        self._stops()
        self._is_draining = True
        with anyio.move_on_after(_LAST_WORDS):
            await self._has_ended.wait()

    def _let_go(self) -> None:
        if self._listening is not None:
            self._listening.cancel()
            self._listening = None
        if self._link is not None:
            self._link.close()
            self._link = None
        self._stops()

    async def _clean_up(self) -> None:
        # A lock that a killed participant left would keep the next one waiting.
        process = self._system.world.processes.get(self.name)
        if process is not None and is_wanted(self._system.world, process):
            await self._system.launcher.clean_up()

    async def _watch_it(self, watch: ContainerWatch, start: int) -> None:
        frozen = await watch.run()
        self._system.post(Faulty(self.name, start, frozen, cause=Cause.FROZEN))

    def _on_output(self, stream: Stream, lines: Sequence[Line]) -> None:
        """Publish what its process prints; of a shared one, in the name of each node's container.

        What names no node is that of this container, the first of the process.
        """
        if not isinstance(self._process, SharedMember):
            super()._on_output(stream, lines)
            return
        world = self._system.world
        owners = {logger_of(each.name): each.key.container for each in world.nodes.values()}
        owners |= {logger_of(name): name for name in world.processes}

        def owner(line: Line) -> str:
            found = (owners[each] for each in loggers_in(line.text) if each in owners)
            return next(found, self.name)

        for name, said in groupby(lines, owner):
            self._system.publisher.publish_output(name, self.pid, stream, list(said))

    # Its channel.

    async def _listen(self, link: ControlLink, start: int, has_ended: anyio.Event) -> None:
        """Post what the container sends, up to the end of the channel."""
        try:
            self._on_hello(await link.handshake(self._system.launcher.hello), start)
            while True:
                self._on_message(await link.receive(), start)
        except VersionMismatchError as error:
            self._fault(start, error, is_fatal=True)
        except ChannelClosedError as error:
            has_ended.set()
            # The channel ends a moment before the process does.
            await anyio.sleep(_EXIT_AFTER_CLOSE)
            self._fault(start, error)
        except ControlError as error:
            self._fault(start, error)
        finally:
            has_ended.set()

    def _fault(self, start: int, error: ControlError, *, is_fatal: bool = False) -> None:
        if not self._is_draining:
            self._system.post(Faulty(self.name, start, str(error), is_fatal=is_fatal))

    def _on_hello(self, hello: HelloMessage, start: int) -> None:
        config = self.config
        is_first = self._system.world.processes[self.name].phase is Phase.STARTING
        pid = hello.pid or self.pid
        if is_first and not config.prefix:  # a debugger may stop it
            self._watch = ContainerWatch(self.name, self.send, pid)
            self._watching = self._system.tasks.begin(
                partial(self._watch_it, self._watch, start), self.name
            )
        facts = Hello(mechanism=hello.mechanism, description=description(hello))
        self._system.post(Greeted(self.name, start, facts))
        if not is_first:
            return
        if hello.full_node_name != self.name:
            _log.warning("%s calls itself %s", self.name, hello.full_node_name)
        shortfall = isolation_shortfall(config, hello)
        if shortfall and self._system.publisher.is_news(shortfall):
            _log.warning("%s: %s", self.name, shortfall)
        self._check(self.name, config.resources, pid)

    def _on_message(self, message: Incoming, start: int) -> None:
        if isinstance(message, HelloMessage):
            _log.warning("%s said hello again", self.name)
            return
        if isinstance(message, Status) and self._on_status(message, start):
            return
        if isinstance(message, ComponentEvent):
            self._system.publisher.publish(message)
        nodes = {node.attempt: node for node in self._system.world.nodes_of(self.name)}
        for said in inputs_of(message, self.config, start, self._queries, nodes):
            # The kernel may have killed it, which only its control group knows.
            ended = said.attempt in nodes and _is_its_end(nodes[said.attempt], said.said)
            why = self._system.launcher.groups.leave(said.attempt) if ended else ""
            self._system.post(replace(said, reason=why, cause=Cause.OUT_OF_MEMORY) if why else said)
            if said.said in {NodeFact.LOADED, NodeFact.STATUS_LOADED} and said.attempt in nodes:
                node = self._system.world.nodes.get(nodes[said.attempt].key)
                if node is not None and node.state is NodeState.LOADED:
                    self._check(node.name, node.config.resources, node.pid)

    def _on_status(self, status: Status, start: int) -> bool:
        """Read what an answer tells of the container; whether it is all that it tells."""
        if status.dropped_frames > self._dropped:
            # One of the frames may have been the crash of a node.
            self._dropped = status.dropped_frames
            text = "%s has dropped %d frames so far: its outgoing queue was full"
            _log.warning(text, self.name, self._dropped)
            nodes = self._system.world.nodes_of(self.name)
            self.query([(n.key, n.attempt, n.unique_id) for n in nodes if n.state not in IDLE])
        if not self._watch.accept(status):
            return False
        silences = {each.attempt: each.silence_ns / 1e9 for each in status.nodes}
        counts, locks = (status.leaked, status.unquiesced), status.dead_locks
        is_well = not (silences or locks or all(counts))
        if is_well and self._well_with == counts:
            return True
        self._well_with = counts if is_well else None
        holder = lock_holder(locks[0]) if locks else 0
        self._system.post(HealthReported(self.name, start, *counts, locks, silences, holder))
        return True

    # Requests.

    def load(self, key: NodeKey, attempt: int) -> None:
        """Request a load."""
        config, groups = self._system.world.nodes[key].config, self._system.launcher.groups
        try:
            self.send(load_request(config, attempt, groups.enter(config, attempt)))
        except (StartError, EncodeError) as error:
            groups.leave(attempt)
            rejected, reason = NodeFact.REJECTED, str(error)
            self._system.post(
                NodeReported(
                    unit=self.name, start=self._start, said=rejected, attempt=attempt, reason=reason
                )
            )

    def query(self, about: Sequence[tuple[NodeKey, int, int]]) -> None:
        """Query it about nodes."""
        self.send(self._queries.put(about))

    def send(self, message: Outgoing) -> None:
        """Send a request; one that is not sent is noticed by what reads the channel."""
        try:
            if self._link is not None:
                self._link.send(message)
        except ControlError as error:
            _log.debug("%s: a request was not sent: %s", self.name, error)

    def probe(self, nodes: Sequence[NodeKey]) -> None:
        """Load the libraries of nodes in scratch processes."""
        probe = partial(probe_nodes, self._system, self.config, tuple(nodes))
        self._probes.append(self._system.tasks.begin(probe, self.name))

    def stop(self, start: int, *, asks: bool, reason: str) -> None:
        """Stop its process, from gentle to hard, and end its scratch processes."""
        for scope in self._probes:
            scope.cancel()
        self._probes.clear()
        super().stop(start, asks=asks, reason=reason)


def _is_its_end(node: Node, fact: NodeFact) -> bool:
    """Whether a node that is told this does not exist any more in its container."""
    state, _ = next_state(node, fact)
    return state is not node.state and state in IDLE

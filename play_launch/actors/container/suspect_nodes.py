"""Keeps the nodes that may have taken their container down from doing so again.

What is decided is in :mod:`play_launch.core.suspects`; here the libraries are probed.
"""

from __future__ import annotations

import asyncio
import logging
from collections import defaultdict
from functools import partial
from typing import TYPE_CHECKING, Protocol

from play_launch.actors.container.node_facts import blamed_frame
from play_launch.actors.first_of import first_of
from play_launch.core.suspects import Suspects

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from play_launch.actors.container.library_probes import LibraryProbes
    from play_launch.config.model import ComposableNodeConfig, ContainerConfig
    from play_launch.core.node_key import NodeKey
    from play_launch.core.probe import Finding

_log = logging.getLogger(__name__)


class SuspectLoads(Protocol):
    """What is done with the nodes."""

    def report_wait(self, node: NodeKey, reason: str) -> None:
        """Report why a node is not loaded yet."""

    def refuse(self, node: NodeKey, reason: str, finding: Finding | None = None) -> None:
        """Let the node fail unless it was sent to the container meanwhile."""

    def load_cleared(self) -> None:
        """Load the nodes that are due."""


class SuspectNodes:
    """The suspects of one container; `run` has to run meanwhile."""

    def __init__(
        self,
        config: ContainerConfig,
        probes: LibraryProbes | None,
        loads: SuspectLoads,
        deliver: Callable[[Callable[[], None]], None],
    ) -> None:
        """Know the container; nobody is ever suspected where ``probes`` is None.

        ``deliver`` has something done to the container's member.
        """
        self._deliver = deliver
        self._config = config
        self._probes = probes
        self._loads = loads
        self._nodes = {node.key: node for node in config.composable_nodes}
        self._suspects = Suspects(self._nodes)
        self._to_probe: asyncio.Queue[list[NodeKey]] = asyncio.Queue()
        self._stopped = asyncio.Event()
        self._is_closed = False

    async def run(self) -> None:
        """Probe libraries until it is cancelled or closed; then no process is left."""
        while not self._is_closed:
            self._stopped.clear()
            await first_of(self._serve(), self._stopped.wait())

    def adopt(self, config: ContainerConfig) -> None:
        """Take another configuration of the container."""
        self._config = config

    def declare(self, node: ComposableNodeConfig) -> None:
        """Take in a node, or one whose declaration has changed."""
        self._nodes[node.key] = node
        self._suspects.trust(node.key)

    def forget(self, node: NodeKey) -> None:
        """Nobody is going to load this one any more."""
        del self._nodes[node]
        self._suspects.forget(node)

    def close(self) -> None:
        """End `run`."""
        self._is_closed = True
        self.stop()

    def stop(self) -> None:
        """Give up what is being probed: the container is stopped."""
        while not self._to_probe.empty():
            self._to_probe.get_nowait()
        self._suspects.probes_cancelled()
        self._stopped.set()

    def container_died(self, under_way: Collection[NodeKey], reason: str) -> None:
        """Take a death; the nodes that were being loaded have become suspects."""
        if self._probes is None:
            return
        probe, refused = self._suspects.container_died(under_way)
        if under_way:
            _log.warning("%s ended while it was loading %s", self._name, self._names(under_way))
        for node in refused:
            deaths = self._suspects.of(node).deaths
            why = f"it took the container down {deaths} times while it was loaded: {reason}"
            self._loads.refuse(node, why)
        for node in probe:
            self._loads.report_wait(node, "its library is loaded in a scratch process first")
        if probe:
            self._to_probe.put_nowait(probe)

    def excuse_death(self) -> bool:
        """Return whether a death now does not count as a restart: a suspect was being loaded."""
        return self._suspects.excuse_death()

    def survived(self, node: NodeKey) -> None:
        """The load of a node has come to an end, and its container lives."""
        self._suspects.survived(node)

    def holds(self, node: NodeKey) -> bool:
        """Whether the container does not get the node yet, or not at all."""
        return self._suspects.holds(node)

    def due(self, under_way: Collection[NodeKey]) -> list[NodeKey]:
        """Choose the nodes that are loaded now, while others are being loaded."""
        return self._suspects.due(under_way)

    @property
    def _name(self) -> str:
        return self._config.full_name

    def _names(self, nodes: Collection[NodeKey]) -> str:
        first = next(iter(nodes)).name
        return f"{first} and {len(nodes) - 1} more" if len(nodes) > 1 else first

    async def _serve(self) -> None:
        async with asyncio.TaskGroup() as tasks:
            while True:
                for group in await self._by_library(await self._to_probe.get()):
                    tasks.create_task(self._probe(group))

    async def _by_library(self, nodes: Sequence[NodeKey]) -> list[list[ComposableNodeConfig]]:
        assert self._probes is not None
        groups: defaultdict[str, list[ComposableNodeConfig]] = defaultdict(list)
        for node in [self._nodes[key] for key in nodes if key in self._nodes]:
            library = await self._probes.library_of(self._config, node)
            groups[library].append(node)
        return list(groups.values())

    async def _probe(self, group: list[ComposableNodeConfig]) -> None:
        """Probe nodes of one library, in most cases by the first of them."""
        assert self._probes is not None
        while group:
            first = group[0]
            finding = await self._probes.probe(self._config, first)
            is_about_all = finding is None or finding.is_about_library
            settled = [node for node in group if is_about_all or node.plugin == first.plugin]
            group = [node for node in group if node not in settled]
            self._deliver(partial(self._conclude, settled, finding))

    def _conclude(self, settled: Collection[ComposableNodeConfig], finding: Finding | None) -> None:
        loads = finding is None or finding.loads
        for node in settled:
            if self._nodes.get(node.key) is not node:
                continue  # it was taken out or declared anew meanwhile
            self._suspects.probe_ended(node.key, loads=loads)
            if finding is not None and not loads:
                self._loads.refuse(node.key, self._why(finding), finding)
        self._loads.load_cleared()

    def _why(self, finding: Finding) -> str:
        reason = finding.error
        if finding.backtrace:
            reason += f" at {blamed_frame(finding.backtrace)}"
        where = f"in a scratch process, tried because {self._name} ended while it loaded the node"
        return f"{reason} ({where})"

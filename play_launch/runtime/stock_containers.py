"""Starts stock containers, or attaches to them, and talks to each over ROS."""

from __future__ import annotations

import asyncio
import logging
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import anyio

from play_launch.config.model import ContainerType
from play_launch.container.messages import Hello
from play_launch.container.ros import NotInstalledError
from play_launch.process.descendants import first_of
from play_launch.process.exit import Exit
from play_launch.ros.composition import CompositionClient
from play_launch.ros.thread import RosThread, node_pool
from play_launch.runtime.stock_link import StockLink

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.config.model import ContainerConfig, ReplayConfig
    from play_launch.process.child import Child
    from play_launch.process.stop import StopPolicy

_log = logging.getLogger(__name__)

_DOMAIN: Final = "ROS_DOMAIN_ID"
_WAITING: Final = 10.0
"""Seconds after which the absence of a container that something else starts is reported."""


@dataclass(frozen=True, slots=True, repr=False)
class Detached(Exit):
    """The end of an attachment; how the process ended, if it did, is not known."""

    reason: str = ""

    def __str__(self) -> str:
        return self.reason


class AttachedContainer:
    """Stands for the process of a container that something else has started.

    It ends when the services of the container have left the graph, soon after an orderly end and
    with the lease of its participant (20 s by default) after SIGKILL, or when it is detached.
    """

    pid = 0
    start_time = 0
    argv: tuple[str, ...] = ()

    def __init__(self, name: str, link: StockLink) -> None:
        self._name = name
        self._link = link
        link.start(self._report_absence())

    async def wait(self) -> Exit:
        """Wait until it is gone or detached."""
        await self._link.ended.wait()
        return Detached(reason=self._link.end_reason)

    gone = wait

    def kill(self) -> None:
        """Let it go; it is not killed."""
        self._link.end("detached")

    async def stop(
        self, policy: StopPolicy, *, ask: Callable[[], bool] | None, hurry: asyncio.Event
    ) -> bool:
        """Unload what was loaded by us within ``policy.ask`` seconds, and let it go."""
        del ask
        with anyio.move_on_after(policy.ask):
            await first_of(self._link.unload_all(), hurry.wait(), self._link.ended.wait())
        left = ", ".join(load.label for load in self._link.unfinished())
        if left and not self._link.ended.is_set():
            _log.warning("%s keeps %s: not unloaded in time", self._name, left)
        self._link.end("detached")
        return True

    async def _report_absence(self) -> None:
        with anyio.move_on_after(_WAITING) as waiting:
            await self._link.services.ready()
        if waiting.cancelled_caught:
            _log.warning("waiting for %s: no container of that name is running", self._name)


async def _follow(process: Child, link: StockLink) -> None:
    """Report the end of a process of ours."""
    exit_ = await process.wait()
    link.end(str(exit_), in_order=exit_.ok)


class StockContainers:
    """The ROS side of all stock containers of a system."""

    def __init__(self) -> None:
        self._threads: dict[str, RosThread] = {}
        self._slots: asyncio.Semaphore | None = None

    def extend(self, config: ReplayConfig) -> None:
        """Start what the stock containers of a system need beside what runs already.

        Imports rclpy and waits for a DDS participant, so it is for another thread than the event
        loop's.

        Raises:
            NotInstalledError: When that is not possible here.
        """
        domains = {
            _domain(each)
            for each in config.containers
            if each.container_type is ContainerType.STOCK
        }
        acquired: dict[str, RosThread] = {}
        try:
            import rcl_interfaces.msg  # noqa: F401, PLC0415

            for domain in sorted(domains - self._threads.keys()):
                acquired[domain] = thread = node_pool.acquire({_DOMAIN: domain})
                thread.until_started()
        except Exception as error:
            for thread in acquired.values():
                node_pool.release(thread)
            reason = f"container_type stock cannot be used here: {error}"
            raise NotInstalledError(f"{reason} (see play-launch doctor)") from error
        self._threads |= acquired

    def attach(self, config: ContainerConfig) -> tuple[AttachedContainer, StockLink]:
        """Attach to a container that something else starts or has started."""
        link = self._link(config)
        return AttachedContainer(config.full_name, link), link

    def talk_to(self, config: ContainerConfig, process: Child) -> StockLink:
        """Begin the conversation with a container that was started by us."""
        link = self._link(config, process.pid, process.start_time)
        link.start(_follow(process, link))
        return link

    def close(self) -> None:
        """Release the threads; waits for the end of those without other users."""
        for thread in self._threads.values():
            node_pool.release(thread)
        self._threads = {}

    def _link(self, config: ContainerConfig, pid: int = 0, start_time: int = 0) -> StockLink:
        if self._slots is None:
            # A load is discovery and a constructor, so CPU time.
            self._slots = asyncio.Semaphore(max(4, 2 * (os.cpu_count() or 1)))
        thread = self._threads[_domain(config)]
        hello = Hello(
            version="",
            pid=pid,
            start_time=start_time,
            full_node_name=config.full_name,
            mode="stock",
            rmw_implementation=thread.rmw_implementation,
            domain_id=thread.domain_id,
        )
        services = CompositionClient(thread, config.full_name)
        timeout = config.loading_timeout
        return StockLink(hello, services, slots=self._slots, loading_timeout=timeout)


def _domain(config: ContainerConfig) -> str:
    """The domain that the configuration gives the container; empty for the environment's."""
    return config.environment.get(_DOMAIN, "")

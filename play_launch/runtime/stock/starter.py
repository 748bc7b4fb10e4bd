"""Starts stock containers, or attaches to them, and gives each a dialogue over ROS."""

from __future__ import annotations

import asyncio
import os
from collections import Counter
from typing import TYPE_CHECKING, Any, Final

from play_launch.config.model import ContainerType
from play_launch.install.ros import NotInstalledError
from play_launch.ros.composition import CompositionClient
from play_launch.ros.parameters import to_parameter_message
from play_launch.ros.thread import RosThread
from play_launch.runtime.stock.attached import AttachedContainer
from play_launch.runtime.stock.link import StockLink
from play_launch.runtime.stock.ports import STOCK_LIMITS, StockLimits
from play_launch.runtime.stock.reports import ContainerIdentity
from play_launch.wire.codec import EncodeError
from play_launch.wire.messages import Hello

if TYPE_CHECKING:
    from play_launch.config.model import ContainerConfig, ReplayConfig
    from play_launch.runtime.ports import ControlLink, ManagedProcess
    from play_launch.wire.messages import Load

_DOMAIN: Final = "ROS_DOMAIN_ID"


class StockContainers:
    """The ROS side of all stock containers of a system: one thread for each domain."""

    def __init__(
        self, threads: dict[int | None, RosThread], *, ask: float, limits: StockLimits
    ) -> None:
        """Take what `of` made."""
        self._threads = threads
        self._own: list[RosThread] = []
        """Those of single containers."""
        self._made: Counter[str] = Counter()
        self._ask = ask
        self._limits = limits
        self._places: asyncio.Semaphore | None = None
        self._following: set[asyncio.Task[None]] = set()

    @classmethod
    def of(cls, config: ReplayConfig, *, limits: StockLimits = STOCK_LIMITS) -> StockContainers:
        """Start what the system's containers need, nothing if they are all our own.

        Imports rclpy and waits for a DDS participant, so it is for another thread than the event
        loop's.

        Raises:
            NotInstalledError: When that is not possible here.
        """
        made = cls({}, ask=config.stop.ask, limits=limits)
        try:
            made.extend(config)
        except NotInstalledError:
            made.close()
            raise
        return made

    def extend(self, config: ReplayConfig) -> None:
        """Start what the containers of a further system need as well; as `of`."""
        self._ask = config.stop.ask
        domains = {
            _domain(each)
            for each in config.containers
            if each.container_type is ContainerType.STOCK
        }
        try:
            for domain in sorted(domains - self._threads.keys(), key=str):
                import composition_interfaces.srv  # noqa: F401, PLC0415 - takes long
                import rcl_interfaces.msg  # noqa: F401, PLC0415

                # A name that `ros2 node list` does not show.
                thread = RosThread(f"_play_launch_{os.getpid()}", domain_id=domain)
                thread.start()
                self._threads[domain] = thread
        except Exception as error:
            reason = f"container_type stock cannot be used here: {error}"
            raise NotInstalledError(f"{reason} (see play-launch doctor)") from error

    def attach(self, config: ContainerConfig) -> tuple[ManagedProcess, ControlLink]:
        """Attach to a container that somebody else starts or has started."""
        name = config.full_name
        link, services = self._link(config, ContainerIdentity(name=name))
        process = AttachedContainer(name, link, services, ask=self._ask, limits=self._limits)
        return process, link

    def talk_to(self, config: ContainerConfig, process: ManagedProcess) -> ControlLink:
        """Begin the dialogue with a container that was started by us."""
        container = ContainerIdentity(
            name=config.full_name, pid=process.pid, start_time=process.start_time
        )
        link, _ = self._link(config, container)
        task = asyncio.get_running_loop().create_task(_follow(process, link))
        self._following.add(task)
        task.add_done_callback(self._following.discard)
        return link

    @property
    def is_open(self) -> bool:
        """Whether there is anything that takes part in ROS."""
        return bool(self._threads)

    def close(self) -> None:
        """End the threads; waits for them."""
        for thread in (*self._threads.values(), *self._own):
            thread.close()
        self._threads = {}

    def _services(self, config: ContainerConfig, thread: RosThread) -> CompositionClient:
        """Make the client, for a second process of the same container in a thread of its own.

        To a participant that still knows the dead one, which had the same address, DDS takes some
        four seconds longer to introduce the new one.
        """
        name = config.full_name
        self._made[name] += 1
        if self._made[name] == 1:
            return CompositionClient(thread, name)
        self._own = [each for each in self._own if each.is_alive]
        own = RosThread(f"{thread.name}_{sum(self._made.values())}", domain_id=thread.domain_id)
        self._own.append(own)
        own.begin()
        return CompositionClient(own, name, owns_thread=True)

    def _link(
        self, config: ContainerConfig, container: ContainerIdentity
    ) -> tuple[StockLink, CompositionClient]:
        if self._places is None:
            # A load is discovery and a constructor, so CPU time.
            self._places = asyncio.Semaphore(max(4, 2 * (os.cpu_count() or 1)))
        thread = self._threads[_domain(config)]
        services = self._services(config, thread)
        link = StockLink(
            container,
            services,
            hello=Hello(
                version="",
                rmw_implementation=thread.rmw_implementation,
                domain_id=thread.domain_id,
            ),
            encode=load_node_request,
            places=self._places,
            loading_timeout=config.loading_timeout,
            limits=self._limits,
        )
        return link, services


def load_node_request(load: Load) -> Any:
    """Make a ``composition_interfaces/LoadNode`` request.

    Raises:
        EncodeError: When a value does not fit.
    """
    # Takes long; imported before by `StockContainers.of`.
    from composition_interfaces.srv import LoadNode  # noqa: PLC0415

    request = LoadNode.Request(check_fields=True)
    try:
        request.package_name = load.package_name
        request.plugin_name = load.plugin_name
        request.node_name = load.node_name
        request.node_namespace = load.node_namespace
        request.log_level = load.log_level
        request.remap_rules = list(load.remap_rules)
        request.parameters = [to_parameter_message(each) for each in load.parameters]
        request.extra_arguments = [to_parameter_message(each) for each in load.extra_arguments]
    except (AssertionError, TypeError, ValueError) as error:
        raise EncodeError(load, error) from error
    return request


async def _follow(process: ManagedProcess, link: StockLink) -> None:
    """Report the end of the process to the dialogue."""
    exit_ = await process.wait()
    link.end(str(exit_), in_order=exit_.ok)


def _domain(config: ContainerConfig) -> int | None:
    """The domain that the configuration gives the container; None for the environment's."""
    given = config.environment.get(_DOMAIN, "")
    return int(given) if given else None

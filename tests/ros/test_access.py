"""Nodes of our own in the ROS graph, the thread that runs them, and the composition client."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, asynccontextmanager, closing
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from blockbuster import blockbuster_ctx
from composition_interfaces.srv import LoadNode
from rclpy.context import Context
from rclpy.node import Node
from std_msgs.msg import String

from play_launch.config.dependency import Condition
from play_launch.config.model import ParameterConfig, ParameterType, ParameterValue
from play_launch.ros import access, waiting
from play_launch.ros.access import GraphSource, Wanted
from play_launch.ros.composition import CompositionClient
from play_launch.ros.parameters import ParameterSetter
from play_launch.ros.thread import NodePool, RosThread, RosThreadError
from play_launch.ros.waiting import GraphGuard, GraphGuardError, Waiter
from tests.support.container import running_container

TIMEOUT = 60.0
NEVER = 1000.0
"""Seconds, more than any test takes."""


@pytest.fixture(name="ros")
def _ros(ros_domain: int) -> Iterator[RosThread]:
    ros = RosThread("bridge")
    ros.start()
    assert ros.domain_id == ros_domain
    yield ros
    ros.close()
    assert not [thread for thread in threading.enumerate() if thread.name == "ros bridge"]


def run(main: asyncio.Future[None] | object) -> None:
    async def bounded() -> None:
        async with asyncio.timeout(TIMEOUT):
            await main  # type: ignore[misc]

    with blockbuster_ctx("play_launch"):
        asyncio.run(bounded())


def talker() -> LoadNode.Request:
    return LoadNode.Request(
        package_name="play_launch_demo", plugin_name="play_launch_demo::Talker", node_name="one"
    )


@asynccontextmanager
async def container(log: Path) -> AsyncIterator[None]:
    with ExitStack() as stack:
        await asyncio.to_thread(stack.enter_context, running_container(log=log))
        try:
            yield
        finally:
            await asyncio.to_thread(stack.close)


def test_the_event_of_the_graph_is_waited_for(
    monkeypatch: pytest.MonkeyPatch, ros: RosThread, tmp_path: Path
) -> None:
    """Else the graph would be looked at four times a second, as rclpy itself does it."""
    monkeypatch.setattr(waiting, "GRAPH_POLL", NEVER)
    run(a_container_is_found(ros, tmp_path))


def test_the_graph_is_looked_at_where_its_event_cannot_be_had(
    monkeypatch: pytest.MonkeyPatch, ros_domain: int, tmp_path: Path
) -> None:
    def fails(_: GraphGuard, __: object) -> None:
        raise GraphGuardError("another rcl")

    monkeypatch.setattr(GraphGuard, "__init__", fails)
    with closing(RosThread("bridge", domain_id=ros_domain)) as ros:
        ros.start()
        run(a_container_is_found(ros, tmp_path))


async def a_container_is_found(ros: RosThread, folder: Path) -> None:
    client = CompositionClient(ros, "/container")
    before = ros.graph_changes
    ready = asyncio.create_task(client.ready())
    assert not await client.is_ready()
    async with container(folder / "log"):
        await ready
        assert ros.graph_changes > before
    client.close()


def test_many_changes_of_the_graph_are_reported_as_one(
    monkeypatch: pytest.MonkeyPatch, ros: RosThread
) -> None:
    """A thousand come while a system does; what waits for one looks at the graph each time."""

    async def main() -> None:
        def publish(node: Any) -> None:
            node.create_publisher(String, f"topic_{len(list(node.publishers))}", 1)

        before = ros.graph_changes
        await ros.call(publish)
        await ros.until(lambda _: ros.graph_changes > before)
        monkeypatch.setattr(waiting, "GRAPH_PAUSE", NEVER)
        await ros.call(publish)
        await ros.until(lambda _: ros.graph_changes > before + 1)
        for _ in range(20):
            await ros.call(publish)
        assert ros.graph_changes == before + 2

    run(main())


def test_closing_gives_up_what_is_expected_and_leaves_the_thread_to_others(ros: RosThread) -> None:
    async def main() -> None:
        absent = CompositionClient(ros, "/absent")
        expected = absent.list_nodes()
        absent.close()
        absent.close()
        with pytest.raises(asyncio.CancelledError):
            await expected
        assert await ros.call(lambda node: node.get_name()) == "bridge"
        assert await ros.call(lambda node: len(list(node.clients))) == 0

    run(main())


def test_what_fails_in_the_thread_is_raised_where_it_was_asked_for(ros: RosThread) -> None:
    async def main() -> None:
        def fail(_: object) -> None:
            raise LookupError("as intended")

        with pytest.raises(LookupError, match="as intended"):
            await ros.call(fail)
        assert await ros.call(lambda node: node.get_name()) == "bridge"

    run(main())


def test_a_thread_that_cannot_start_says_why() -> None:
    ros = RosThread("no valid name!")
    with pytest.raises(Exception, match="no valid name!"):
        ros.start()
    ros.close()


def test_a_request_that_is_none_is_refused(ros: RosThread) -> None:
    async def main() -> None:
        client = CompositionClient(ros, "/absent")
        with pytest.raises(TypeError):
            await client.load_node("something else")
        client.close()

    run(main())


def test_what_is_asked_of_a_thread_that_does_not_start_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fails(self: RosThread) -> None:
        raise RuntimeError("failed to create the domain participant")

    monkeypatch.setattr(RosThread, "_open", fails)

    async def main() -> None:
        ros = RosThread("bridge")
        client = CompositionClient(ros, "/other")
        asked_before = asyncio.ensure_future(client.ready())
        list_before = client.list_nodes()
        await asyncio.sleep(0)
        ros.begin()
        for refused in (asked_before, list_before):
            with pytest.raises(RosThreadError, match="domain participant"):
                await refused
        with pytest.raises(RosThreadError, match="domain participant"):
            await client.ready()
        with pytest.raises(RosThreadError, match="domain participant"):
            await client.list_nodes()
        client.close()

    run(main())


pytestmark = pytest.mark.anyio

TALKER = (Condition.NODE, "/talker")
SERVICE = (Condition.SERVICE, "/c/load")


class StandIn:
    """All that is wanted is there; it comes and goes when the test lets it."""

    def __init__(self) -> None:
        self.is_leaving = asyncio.Event()
        self.may_leave = asyncio.Event()
        self.checked = asyncio.Event()
        self.graph_changes = 0
        self.times = 0

    @asynccontextmanager
    async def used(self, _environment: object) -> AsyncIterator[StandIn]:
        self.times += 1
        try:
            yield self
        finally:
            self.is_leaving.set()
            await self.may_leave.wait()

    def check_again(self) -> None:
        self.checked.set()

    async def until(self, holds: Callable[[object], bool]) -> None:
        while not holds(self):
            await self.checked.wait()
            self.checked.clear()

    async def call(self, work: partial[Wanted]) -> Any:
        return work.keywords["wanted"]


async def test_what_is_wanted_while_the_node_leaves_is_looked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ros = StandIn()
    monkeypatch.setattr(access, "node_pool", ros)
    seen: asyncio.Queue[Wanted] = asyncio.Queue()
    source = GraphSource({}, seen.put_nowait)
    source.watch([TALKER])
    assert await seen.get() == {TALKER}
    source.watch([])
    await ros.is_leaving.wait()
    source.watch([SERVICE])
    ros.may_leave.set()
    assert await asyncio.wait_for(seen.get(), 60) == {SERVICE}
    await source.close()
    assert ros.times == 2


async def test_a_graph_that_cannot_be_read_is_reported_and_read_again(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    class NoRosAtFirst(StandIn):
        @asynccontextmanager
        async def used(self, _environment: object) -> AsyncIterator[StandIn]:
            self.times += 1
            if self.times == 1:
                raise ImportError("no rclpy")
            yield self

    monkeypatch.setattr(access, "_RETRY_INTERVAL", 0.0)
    monkeypatch.setattr(access, "node_pool", NoRosAtFirst())
    seen: asyncio.Queue[Wanted] = asyncio.Queue()
    source = GraphSource({}, seen.put_nowait)
    source.watch([TALKER])
    assert await asyncio.wait_for(seen.get(), 60) == {TALKER}
    await source.close()
    told = [each.getMessage() for each in caplog.records if each.name == access.__name__]
    assert told == ["the ROS graph cannot be read, next try in 0 s: no rclpy"]


RATE = ParameterConfig("rate", ParameterValue(ParameterType.DOUBLE, 1.0))


async def test_users_of_a_domain_share_a_node_until_the_last_one_leaves(
    ros_domain: int, other_domain: int
) -> None:
    pool = NodePool()
    here = {"ROS_DOMAIN_ID": str(ros_domain)}
    async with pool.used({"ROS_DOMAIN_ID": str(other_domain)}) as elsewhere:
        async with pool.used({}) as first:
            async with pool.used(here) as second:
                assert second is first
                names = [
                    await each.call(lambda node: node.get_name()) for each in (first, elsewhere)
                ]
                assert names[0].startswith("_play_launch_")
                assert (first.domain_id, elsewhere.domain_id) == (ros_domain, other_domain)
            assert not first.has_ended
        assert first.has_ended
        async with pool.used(here) as third:
            assert third is not first
            await third.call(lambda node: node.get_name())


async def test_a_domain_that_could_not_be_joined_is_joined_the_next_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As after a time in which /dev/shm was full."""
    failures = iter([OSError("no space"), LookupError("joined")])

    def fails(_: RosThread) -> tuple[Context, Node, Waiter]:
        raise next(failures)

    monkeypatch.setattr(RosThread, "_open", fails)
    setter = ParameterSetter()
    assert "no space" in await setter.set("/n", [RATE], {})
    assert "joined" in await setter.set("/n", [RATE], {})
    await setter.close()


async def test_a_use_that_is_cancelled_twice_leaves_no_thread() -> None:
    pool = NodePool()
    loop = asyncio.get_running_loop()
    executor = ThreadPoolExecutor(1)
    loop.set_default_executor(executor)
    is_free = threading.Event()
    used: asyncio.Future[RosThread] = loop.create_future()

    async def use() -> None:
        async with pool.used({}) as thread:
            used.set_result(thread)
            await asyncio.Event().wait()

    task = asyncio.create_task(use())
    thread = await used
    await asyncio.to_thread(thread.until_started)
    # The thread that is to end the use is not to be had yet, as on a busy machine.
    busy = executor.submit(is_free.wait)
    for _ in range(3):
        task.cancel()
        await asyncio.sleep(0)
    is_free.set()
    await asyncio.gather(task, return_exceptions=True)
    busy.result()
    await loop.shutdown_default_executor()
    assert thread.has_ended
    assert not thread._thread.is_alive()

"""The rclpy thread and the client of the composition services, against the real container."""

from __future__ import annotations

import asyncio
import gc
import threading
import weakref
from collections.abc import AsyncIterator, Iterator
from contextlib import ExitStack, asynccontextmanager, closing
from typing import TYPE_CHECKING, Any

import pytest
from blockbuster import blockbuster_ctx
from composition_interfaces.srv import LoadNode
from std_msgs.msg import String

from play_launch.ros import waiting
from play_launch.ros.composition import CompositionClient
from play_launch.ros.thread import RosThread, RosThreadError
from play_launch.ros.waiting import GraphGuard, GraphGuardError
from tests.support.container import running_container

if TYPE_CHECKING:
    from pathlib import Path

PATIENCE = 60.0
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
        async with asyncio.timeout(PATIENCE):
            await main  # type: ignore[misc]

    with blockbuster_ctx("play_launch"):
        asyncio.run(bounded())


def talker() -> LoadNode.Request:
    return LoadNode.Request(
        package_name="play_launch_demo", plugin_name="play_launch_demo::Talker", node_name="one"
    )


def services_and_clients(node: Any) -> tuple[list[str], list[str]]:
    both = [each.srv_name for each in node.services], [each.srv_name for each in node.clients]
    services, clients = ([name.rpartition("/")[2] for name in names] for names in both)
    return services, clients


@asynccontextmanager
async def container(log: Path) -> AsyncIterator[None]:
    with ExitStack() as stack:
        await asyncio.to_thread(stack.enter_context, running_container(log=log))
        try:
            yield
        finally:
            await asyncio.to_thread(stack.close)


def test_nodes_are_loaded_listed_and_unloaded(ros: RosThread, tmp_path: Path) -> None:
    async def main() -> None:
        client = CompositionClient(ros, "/container")
        assert not await client.is_ready()
        async with container(tmp_path / "log"):
            await client.ready()
            assert await client.constructs_in_background()
            assert await client.all_nodes() == {}
            # Whatever is here, all others have to discover; that for unloading is seldom needed.
            assert await ros.call(services_and_clients) == ([], ["load_node", "list_nodes"])
            reply = await client.load_node(talker())
            assert (reply.success, reply.full_node_name) == (True, "/one"), reply
            assert await client.list_nodes() == {reply.unique_id: "/one"}
            again = await client.load_node(talker())
            assert not again.success
            assert "/one" in again.error_message
            assert (await client.unload_node(reply.unique_id)).success
            gone = await client.unload_node(reply.unique_id)
            assert not gone.success
            assert gone.error_message
        await client.gone()
        client.close()

    run(main())


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


def test_what_is_not_waited_for_any_more_is_forgotten(ros: RosThread) -> None:
    class Never:
        def __call__(self, _: object) -> bool:
            return False

    async def main() -> None:
        never = Never()
        is_kept = weakref.ref(never)
        waiting_for_it = asyncio.ensure_future(ros.until(never))
        del never
        await asyncio.sleep(0)
        waiting_for_it.cancel()
        await asyncio.gather(waiting_for_it, return_exceptions=True)
        del waiting_for_it
        for _ in range(2):
            await ros.call(lambda node: node.get_name())
        gc.collect()
        assert is_kept() is None

    run(main())


def test_who_waits_for_the_graph_hears_that_the_thread_has_ended(ros: RosThread) -> None:
    async def main() -> None:
        client = CompositionClient(ros, "/nobody")
        ready = asyncio.ensure_future(client.ready())
        assert not await client.is_ready()
        await asyncio.to_thread(ros.close)
        with pytest.raises(RosThreadError, match="closed"):
            await ready
        client.close()

    run(main())


def test_closing_gives_up_what_is_expected_and_leaves_the_thread_to_others(ros: RosThread) -> None:
    async def main() -> None:
        nobody = CompositionClient(ros, "/nobody")
        expected = nobody.list_nodes()
        nobody.close()
        nobody.close()
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
        client = CompositionClient(ros, "/nobody")
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
        client = CompositionClient(ros, "/somebody")
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


def test_what_is_asked_of_a_thread_that_has_ended_is_refused(ros: RosThread) -> None:
    async def main() -> None:
        client = CompositionClient(ros, "/somebody")
        assert not await client.is_ready()
        await asyncio.to_thread(ros.close)
        with pytest.raises(RosThreadError, match="closed"):
            await client.is_ready()
        client.close()

    run(main())

"""The rclpy thread and the client of the composition services, against the real container."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Iterator
from contextlib import ExitStack, asynccontextmanager
from typing import TYPE_CHECKING

import pytest
from blockbuster import blockbuster_ctx
from composition_interfaces.srv import LoadNode

from play_launch.ros.composition import CompositionClient, ListedNode
from play_launch.ros.graph import GraphEvents
from play_launch.ros.thread import RosThread, RosThreadError
from tests.support.container import running_container

if TYPE_CHECKING:
    from pathlib import Path

PATIENCE = 60.0


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
            assert len(await client.servers()) == 1
            assert await client.constructs_in_background()
            assert await client.list_nodes() == ()
            reply = await client.load_node(talker())
            assert (reply.success, reply.full_node_name) == (True, "/one"), reply
            assert await client.list_nodes() == (ListedNode(reply.unique_id, "/one"),)
            again = await client.load_node(talker())
            assert not again.success
            assert "/one" in again.error_message
            assert (await client.unload_node(reply.unique_id)).success
            gone = await client.unload_node(reply.unique_id)
            assert not gone.success
            assert gone.error_message
        while await client.is_ready():
            await client.graph_change()
        client.close()

    run(main())


def test_the_event_of_the_graph_is_waited_for(ros: RosThread, tmp_path: Path) -> None:
    """Else the graph would be looked at four times a second, as rclpy itself does it."""

    async def main() -> None:
        changes = 0

        def count() -> None:
            nonlocal changes
            changes += 1

        waitables = await ros.call(lambda node: list(node.waitables))
        assert any(isinstance(each, GraphEvents) for each in waitables)
        client = CompositionClient(ros, "/container")
        client.on_graph_change(count)
        waiting = asyncio.create_task(client.ready())
        await asyncio.sleep(0)
        async with container(tmp_path / "log"):
            await waiting
            assert changes > 0
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
        client = CompositionClient(ros, "/somebody", owns_thread=True)
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

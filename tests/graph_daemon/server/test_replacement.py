"""A replaced node never shows fewer nodes than the old one."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Any

import pytest

from play_launch.graph_daemon.server.replacement import Replacer, covers
from play_launch.graph_daemon.server.service import GraphService
from tests.graph_daemon.server.graphs import FakeGraph
from tests.graph_daemon.server.test_service import Service, run


async def until(done: Callable[[], bool]) -> None:
    while not done():
        await asyncio.sleep(0.01)


async def replacing(
    service: GraphService, build: Callable[[], Any], **settings: float
) -> tuple[Replacer, asyncio.Task[None]]:
    replacer = Replacer(service, build, look=0.01, **settings)
    return replacer, asyncio.create_task(replacer.run())


def test_the_new_node_is_used_when_it_knows_all() -> None:
    async def scenario() -> None:
        service, old, new = Service(), FakeGraph("old", ("a", "b")), FakeGraph("new")
        old.topics.add("/chatter")
        service.use(old)
        replacer, task = await replacing(service, lambda: new)
        generation = service.generation
        replacer.request()
        for name in ("a", "b"):
            await asyncio.sleep(0.1)
            assert service.graph is old
            new.known.add(name)
        await asyncio.sleep(0.1)
        assert service.graph is old
        new.topics.add("/chatter")
        await until(lambda: old.closed)
        assert service.graph is new
        assert service.generation > generation
        assert replacer.replacements == 1
        task.cancel()

    run(scenario)


def test_who_is_gone_in_reality_is_not_waited_for() -> None:
    async def scenario() -> None:
        service, old, new = Service(), FakeGraph("old", ("a", "gone")), FakeGraph("new", ("a",))
        service.use(old)
        replacer, task = await replacing(service, lambda: new)
        replacer.request()
        await asyncio.sleep(0.1)
        assert service.graph is old
        old.known.discard("gone")
        await until(lambda: service.graph is new)
        task.cancel()

    run(scenario)


def test_after_a_while_the_new_one_is_used_in_any_case(caplog: pytest.LogCaptureFixture) -> None:
    async def scenario() -> None:
        service, old, new = Service(), FakeGraph("old", ("a",)), FakeGraph("new")
        service.use(old)
        replacer, task = await replacing(service, lambda: new, longest=0.1)
        replacer.request()
        await until(lambda: old.closed)
        assert service.graph is new
        task.cancel()

    run(scenario)
    assert "does not know all" in caplog.text


def test_where_no_node_can_be_made_the_old_one_stays(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL, "play_launch.graph_daemon.server.replacement")

    async def scenario() -> None:
        service, old, new = Service(), FakeGraph("old"), FakeGraph("new")
        service.use(old)
        attempts: list[int] = []

        def build() -> FakeGraph:
            attempts.append(1)
            if len(attempts) < 3:
                raise RuntimeError("no interface is up")
            return new

        replacer, task = await replacing(service, build, retry=0.01)
        replacer.request()
        await until(lambda: service.graph is new)
        assert len(attempts) == 3
        task.cancel()

    run(scenario)


def test_the_end_closes_a_node_that_is_not_yet_used() -> None:
    async def scenario() -> None:
        service, old, new = Service(), FakeGraph("old", ("a",)), FakeGraph("new")
        built = asyncio.Event()
        loop = asyncio.get_running_loop()

        def build() -> FakeGraph:
            loop.call_soon_threadsafe(built.set)
            return new

        service.use(old)
        replacer, task = await replacing(service, build)
        replacer.request()
        await built.wait()
        await asyncio.sleep(0.05)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        assert new.closed
        assert not old.closed

    run(scenario)


def test_the_two_do_not_have_to_know_each_other() -> None:
    old, new = FakeGraph("old", ("a",)), FakeGraph("new", ("a",))
    assert covers(new, old)
    old.known.add("new")
    assert covers(new, old)
    old.known.add("b")
    assert not covers(new, old)

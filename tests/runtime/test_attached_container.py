"""What stands for the process of a container that is not ours."""

from __future__ import annotations

import asyncio

import pytest

from play_launch.process.stop import StopPolicy
from play_launch.runtime.stock_containers import AttachedContainer
from play_launch.runtime.stock_link import StockLink

from .stock_services import Services, greeted, load, settle

POLICY = StopPolicy(ask=3.0)


async def attached(services: Services) -> tuple[AttachedContainer, StockLink]:
    link = await greeted(services)
    container = AttachedContainer("/box", link)
    await settle()
    services.change()
    await settle()
    return container, link


async def loaded(services: Services, link: StockLink, attempt: int, name: str) -> None:
    link.send(load(attempt, name))
    await settle()
    if len(services.loads) and not services.loads[-1][1].done():
        services.construct()
    await settle()


async def test_a_load_under_way_is_waited_for_and_unloaded_and_no_other_is_sent() -> None:
    services = Services()
    container, link = await attached(services)
    link.send(load(1, "slow"))
    link.send(load(2, "queued"))
    await settle()
    stopping = asyncio.create_task(container.stop(POLICY, ask=None, hurry=asyncio.Event()))
    await asyncio.sleep(1)
    services.construct()
    assert await stopping
    assert services.nodes == {}
    assert len(services.loads) == 1
    link.close()


@pytest.mark.parametrize("hurries", [False, True])
async def test_it_is_let_go_in_time(hurries: bool, caplog: pytest.LogCaptureFixture) -> None:
    services = Services()
    container, link = await attached(services)
    await loaded(services, link, 1, "a")
    services.answers_unloads = False
    loop, hurry = asyncio.get_running_loop(), asyncio.Event()
    began = loop.time()
    if hurries:
        loop.call_later(1, hurry.set)
    assert await container.stop(POLICY, ask=None, hurry=hurry)
    assert loop.time() - began == pytest.approx(1 if hurries else 3, abs=0.1)
    assert "/box keeps /a: not unloaded in time" in caplog.text
    link.close()


async def test_a_container_that_refuses_is_not_asked_for_ever() -> None:
    services = Services()
    container, link = await attached(services)
    await loaded(services, link, 1, "a")

    def refuse(unique_id: int) -> asyncio.Future[object]:
        services.unloaded.append(unique_id)
        return services._reply(True, type("Reply", (), {"success": False, "error_message": "no"}))

    services.unload_node = refuse  # type: ignore[method-assign, assignment]
    assert await container.stop(POLICY, ask=None, hurry=asyncio.Event())
    assert services.unloaded == [11, 11]
    link.close()

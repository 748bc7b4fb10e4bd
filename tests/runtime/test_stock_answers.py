"""What answers of a stock container mean, together with its list and without it."""

from __future__ import annotations

import asyncio

import pytest

from play_launch.ros.composition import LoadReply
from play_launch.runtime.stock_link import StockLink
from play_launch.supervisor.events import ComponentEvent, ComponentEventKind

from .stock_services import Services, ask, greeted, load, settle


async def event(link: StockLink, kind: ComponentEventKind) -> ComponentEvent:
    """The next event of that kind."""
    while True:
        said = await link.receive()
        if isinstance(said, ComponentEvent) and said.kind is kind:
            return said


LOADED, LOAD_FAILED = ComponentEventKind.LOADED, ComponentEventKind.LOAD_FAILED


async def test_a_name_that_has_become_free_meanwhile_is_loaded() -> None:
    services = Services()
    services.nodes = {1: "/a"}
    link = await greeted(services)
    services.nodes = {}
    link.send(load(1, "a"))
    await settle()
    assert len(services.loads) == 1
    link.close()


async def test_where_constructors_run_in_the_background_silence_stays_silence() -> None:
    services = Services()
    services.is_serial = False
    link = await greeted(services)
    link.send(load(1, "slow"))
    link.send(load(2, "next"))
    await asyncio.sleep(10)
    (slow, _) = (await ask(link)).nodes
    assert "lists other nodes only" in slow.note
    await settle()
    assert len(services.loads) == 1
    services.construct(0)
    assert (await event(link, LOADED)).attempt == 1
    link.close()


@pytest.mark.parametrize(
    ("listed", "found"), [({5: "/own"}, 5), ({5: "/own", 6: "/other"}, 0), ({}, 0)]
)
async def test_a_silent_node_without_a_name_is_found_as_the_only_new_one(
    listed: dict[int, str], found: int
) -> None:
    services = Services()
    services.nodes = {1: "/old"}
    link = await greeted(services)
    link.send(load(1, ""))
    await asyncio.sleep(10)
    services.nodes |= listed
    assert [each.unique_id for each in (await ask(link)).nodes] == ([found] if found else [])
    link.close()


@pytest.mark.parametrize(
    ("answer", "kind", "text"),
    [
        (LoadReply(True, "", "/a", 5), LOADED, ""),
        (LoadReply(True, "", "/b", 5), LOADED, "it calls itself /b"),
        (LoadReply(False, "no"), LOAD_FAILED, "no"),
        (LoadReply(False), LOAD_FAILED, "gave no reason"),
    ],
)
async def test_the_answer_to_a_load_is_its_result_and_nothing_is_listed(
    answer: LoadReply, kind: ComponentEventKind, text: str
) -> None:
    services = Services()
    link = await greeted(services)
    lists = services.lists
    link.send(load(1, "a"))
    await settle()
    services.loads[0][1].set_result(answer)
    result = await event(link, kind)
    assert (result.attempt, result.unique_id) == (1, answer.unique_id)
    assert text in result.error_message
    assert result.confirmed_by == ""
    assert services.lists == lists
    link.close()


async def test_a_late_answer_of_a_lost_load_is_not_used() -> None:
    services = Services()
    link = await greeted(services)
    link.send(load(1, "a"))
    await asyncio.sleep(10)
    assert (await ask(link)).nodes == ()
    assert services.loads[0][1].cancelled()
    link.send(load(2, "a"))
    await settle()
    assert len(services.loads) == 2
    link.close()

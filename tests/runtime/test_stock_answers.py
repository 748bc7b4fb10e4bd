"""What answers of a stock container mean, together with its list and without it."""

from __future__ import annotations

import asyncio

import pytest

from play_launch.ros.composition import LoadReply
from play_launch.runtime.stock.link import StockLink
from play_launch.supervisor.events import ComponentEvent, ComponentEventKind

from .stock_services import Services, ask, greeted, load, run, settle


async def event(link: StockLink, kind: ComponentEventKind) -> ComponentEvent:
    """The next event of that kind."""
    while True:
        said = await link.receive()
        if isinstance(said, ComponentEvent) and said.kind is kind:
            return said


async def lost(services: Services) -> StockLink:
    """A link whose first load for /a was neither answered nor listed."""
    link = await greeted(services)
    link.send(load(1, "a"))
    await asyncio.sleep(10)
    assert (await ask(link)).nodes == ()
    return link


LOADED, LOAD_FAILED = ComponentEventKind.LOADED, ComponentEventKind.LOAD_FAILED


@pytest.mark.parametrize(
    ("answer", "listed", "kind", "text", "unique_id"),
    [
        (LoadReply(True, "", "/a", 5), {5: "/a"}, LOADED, "", 5),
        (LoadReply(True, "", "/b", 5), {5: "/b"}, LOADED, "it calls itself /b", 5),
        (LoadReply(True, "", "/a", 5), {}, LOAD_FAILED, "does not list it", 0),
        (LoadReply(True, "", "/a", 5), {6: "/a"}, LOADED, "said that its unique_id is 5", 6),
        (LoadReply(True, "", "/a", 5), {5: "/a", 6: "/a"}, LOADED, "other nodes have that name", 5),
        (LoadReply(False, "no"), {5: "/a"}, LOADED, "said that it failed (no), but lists 5", 5),
        (LoadReply(False, "no"), {}, LOAD_FAILED, "no", 0),
        (LoadReply(False), {}, LOAD_FAILED, "does not say why", 0),
    ],
)
def test_an_answer_counts_together_with_the_list(
    answer: LoadReply, listed: dict[int, str], kind: ComponentEventKind, text: str, unique_id: int
) -> None:
    async def main() -> None:
        services = Services()
        link = await greeted(services)
        link.send(load(1, "a"))
        await settle()
        services.nodes = listed
        services.loads[0][1].set_result(answer)
        told = await event(link, kind)
        assert (told.attempt, told.unique_id) == (1, unique_id)
        assert text in told.error_message
        assert (told.confirmed_by == "list_nodes") is ("but lists" in told.error_message)
        link.close()

    run(main())


def test_a_name_that_was_there_before_is_refused_and_nothing_is_sent() -> None:
    async def main() -> None:
        services = Services()
        services.nodes = {1: "/a"}
        link = await greeted(services)
        link.send(load(1, "a"))
        failed = await event(link, LOAD_FAILED)
        assert "has a node of that name already (unique_id 1)" in failed.error_message
        assert not services.loads
        link.close()

    run(main())


def test_a_name_that_has_become_free_meanwhile_is_loaded() -> None:
    async def main() -> None:
        services = Services()
        services.nodes = {1: "/a"}
        link = await greeted(services)
        services.nodes = {}
        link.send(load(1, "a"))
        await settle()
        assert len(services.loads) == 1
        link.close()

    run(main())


def test_a_lost_load_that_appears_before_it_is_sent_anew_is_not_loaded_twice() -> None:
    async def main() -> None:
        services = Services()
        link = await lost(services)
        services.nodes = {5: "/a"}
        link.send(load(2, "a"))
        found = await event(link, LOADED)
        assert (found.attempt, found.unique_id, found.confirmed_by) == (2, 5, "list_nodes")
        assert len(services.loads) == 1
        services.loads[0][1].set_result(LoadReply(True, "", "/a", 5))
        await settle()
        assert services.unloaded == []
        link.close()

    run(main())


def test_a_lost_load_that_is_answered_after_the_second_one_is_unloaded() -> None:
    async def main() -> None:
        services = Services()
        link = await lost(services)
        link.send(load(2, "a"))
        await settle()
        services.nodes = {5: "/a", 6: "/a"}
        services.loads[1][1].set_result(LoadReply(True, "", "/a", 6))
        assert (await event(link, LOADED)).unique_id == 6
        services.loads[0][1].set_result(LoadReply(True, "", "/a", 5))
        await settle()
        assert services.nodes == {6: "/a"}
        link.close()

    run(main())


def test_where_constructors_run_in_the_background_silence_stays_silence() -> None:
    async def main() -> None:
        services = Services()
        services.is_serial = False
        link = await greeted(services)
        link.send(load(1, "slow"))
        link.send(load(2, "next"))
        await asyncio.sleep(10)
        (slow, _) = (await ask(link)).nodes
        assert "lists other nodes only" in slow.note
        await settle()
        assert len(services.loads) == 2, "its turn has gone to the next"
        services.construct(0)
        assert (await event(link, LOADED)).attempt == 1
        link.close()

    run(main())


@pytest.mark.parametrize(
    ("listed", "found"), [({5: "/own"}, 5), ({5: "/own", 6: "/other"}, 0), ({}, 0)]
)
def test_a_silent_node_without_a_name_is_found_as_the_only_new_one(
    listed: dict[int, str], found: int
) -> None:
    async def main() -> None:
        services = Services()
        services.nodes = {1: "/old"}
        link = await greeted(services)
        link.send(load(1, ""))
        await asyncio.sleep(10)
        services.nodes |= listed
        assert [each.unique_id for each in (await ask(link)).nodes] == ([found] if found else [])
        link.close()

    run(main())

"""The dialogue with a stock container: when what is sent, said and waited for."""

from __future__ import annotations

import asyncio

import pytest

from play_launch.container.channel import ChannelClosedError
from play_launch.container.codec import ControlError, EncodeError
from play_launch.container.messages import (
    Cancel,
    Hello,
    Load,
    Query,
    Rejected,
    Shutdown,
    Unload,
)
from play_launch.ros.thread import RosThreadError
from play_launch.supervisor.events import ComponentEvent, ComponentEventKind

from .stock_services import Services, ask, greeted, link_to, load, settle, status

LOADED, UNLOADED = ComponentEventKind.LOADED, ComponentEventKind.UNLOADED
LOADING = ComponentEventKind.LOADING


async def test_it_says_hello_when_the_container_lists_its_nodes() -> None:
    services = Services()
    services.nodes = {1: "/there"}
    link = link_to(services)
    hello = await link.handshake(Hello(version="1"))
    assert (hello.mode, hello.rmw_implementation, hello.domain_id) == ("stock", "rmw_test", 7)
    assert hello.notes == ("1 node(s) existed already",)
    link.close()
    assert services.closed


async def test_the_first_question_is_put_again_and_not_too_many_stay_open() -> None:
    services = Services()
    services.answers_lists = False
    link = link_to(services)
    greeting = asyncio.create_task(link.handshake(Hello(version="1")))
    await asyncio.sleep(60)
    open_ = [reply for reply in services.unanswered if not reply.done()]
    assert services.lists > 10 > len(open_)
    services.answers_lists = True
    services.change()
    await greeting
    assert all(reply.done() for reply in services.unanswered)
    link.close()


async def test_a_load_is_told_step_by_step() -> None:
    services = Services()
    link = await greeted(services)
    link.send(load(1, "a"))
    loading = await link.receive()
    assert isinstance(loading, ComponentEvent)
    assert (loading.kind, loading.attempt, loading.unique_id) == (LOADING, 1, 0)
    services.construct()
    loaded = await link.receive()
    assert isinstance(loaded, ComponentEvent)
    assert (loaded.kind, loaded.unique_id, loaded.full_node_name) == (LOADED, 11, "/a")
    assert (loaded.package_name, loaded.plugin_name) == ("demo", "demo::Node")
    link.close()


async def test_whether_it_lives_is_answered_for_the_container() -> None:
    services = Services()
    link = await greeted(services)
    services.answers_lists = False
    link.send(load(1, "a"))
    await asyncio.sleep(1000)
    link.send(Query(query_id=5, unique_ids=(0,)))
    assert (await status(link, 5)).nodes == ()
    link.close()


async def test_loads_of_different_containers_are_bounded_but_a_slow_one_gives_way() -> None:
    slots = asyncio.Semaphore(1)
    first, second = Services(), Services()
    one, two = await greeted(first, slots=slots), await greeted(second, slots=slots)
    one.send(load(1, "a"))
    await settle()
    two.send(load(2, "b"))
    await asyncio.sleep(9.9)
    assert (len(first.loads), len(second.loads)) == (1, 0)
    await asyncio.sleep(0.2)
    assert len(second.loads) == 1
    one.close()
    two.close()


async def test_a_container_whose_services_are_away_takes_no_place() -> None:
    slots = asyncio.Semaphore(1)
    away, there = Services(), Services()
    one, two = await greeted(away, slots=slots), await greeted(there, slots=slots)
    away.is_present = False
    one.send(load(1, "a"))
    await settle()
    two.send(load(2, "b"))
    await settle()
    assert (len(away.loads), len(there.loads)) == (0, 1)
    away.change()
    there.construct()
    await settle()
    assert len(away.loads) == 1
    one.close()
    two.close()


async def test_unloading_without_an_answer_is_decided_by_the_list() -> None:
    services = Services()
    link = await greeted(services)
    link.send(load(1, "a"))
    await settle()
    services.construct()
    await settle()
    services.answers_unloads = False
    link.send(Unload(unique_id=11))
    await asyncio.sleep(11)
    link.send(Query(query_id=1, unique_ids=(0,)))
    said = [await link.receive() for _ in range(4)]
    (rejected,) = (each for each in said if isinstance(each, Rejected))
    assert (rejected.attempt, rejected.unique_id) == (0, 11)
    assert "no answer within 10 s" in rejected.reason
    services.answers_unloads = True
    link.send(Unload(unique_id=11))
    unloaded = await link.receive()
    assert isinstance(unloaded, ComponentEvent)
    assert unloaded.kind is UNLOADED
    link.close()


async def test_a_load_that_cannot_be_sent_is_refused_at_once() -> None:
    link = await greeted(Services())
    with pytest.raises(EncodeError):
        link.send(Load(attempt=1, package_name="a", plugin_name="a::A", log_level=1000))
    assert (await ask(link)).nodes == ()
    link.close()


async def test_a_container_that_is_being_stopped_gets_no_further_load() -> None:
    services = Services()
    link = await greeted(services)
    link.send(load(1, "a"))
    link.send(load(2, "b"))
    await settle()
    with pytest.raises(ControlError):
        link.send(Shutdown(reason="x"))
    services.construct()
    await asyncio.sleep(5)
    assert len(services.loads) == 1
    link.close()


async def test_there_is_no_word_for_stopping_and_none_for_cancelling() -> None:
    link = await greeted(Services())
    with pytest.raises(ControlError):
        link.send(Shutdown(reason="x"))
    link.send(Cancel(unique_id=0))
    link.close()


@pytest.mark.parametrize(("in_order", "told"), [(True, 1), (False, 0)])
async def test_a_container_that_exits_as_told_has_unloaded_nodes(in_order: bool, told: int) -> None:
    services = Services()
    link = await greeted(services)
    link.send(load(1, "a"))
    await settle()
    services.construct()
    await settle()
    with pytest.raises(ControlError):
        link.send(Shutdown(reason="x"))
    link.end("exited", in_order=in_order)
    kinds = [getattr(await link.receive(), "kind", None) for _ in range(2 + told)]
    assert kinds == [LOADING, LOADED] + [UNLOADED] * told
    for _ in range(2):
        with pytest.raises(ChannelClosedError, match="exited"):
            await link.receive()
    link.close()


async def test_an_end_that_was_not_requested_is_no_unloading() -> None:
    services = Services()
    link = await greeted(services)
    link.send(load(1, "a"))
    await settle()
    services.construct()
    await settle()
    link.end("exited with status 0", in_order=True)
    kinds = [getattr(await link.receive(), "kind", None) for _ in range(2)]
    assert kinds == [LOADING, LOADED]
    with pytest.raises(ChannelClosedError):
        await link.receive()
    link.close()


async def test_silence_of_an_idle_container_is_told_once_and_so_is_its_end(
    caplog: pytest.LogCaptureFixture,
) -> None:
    services = Services()
    link = await greeted(services)
    services.answers_lists = False
    await asyncio.sleep(120)
    assert caplog.text.count("has not answered for") == 1
    assert "answers again" not in caplog.text
    assert len([reply for reply in services.unanswered if not reply.done()]) <= 8
    services.answers_lists = True
    await asyncio.sleep(10)
    assert caplog.text.count("answers again") == 1
    link.close()


async def test_a_node_that_is_gone_is_noticed_without_being_asked_for() -> None:
    services = Services()
    link = await greeted(services)
    link.send(load(1, "a"))
    await settle()
    services.construct()
    link.send(load(2, "b"))
    await settle()
    services.construct()
    await settle()
    del services.nodes[11]
    for _ in range(4):
        await link.receive()
    event = await link.receive()
    assert isinstance(event, ComponentEvent)
    assert event.kind is UNLOADED
    assert "another program unloaded it" in event.error_message
    link.close()


async def test_a_fault_in_the_dialogue_ends_it(caplog: pytest.LogCaptureFixture) -> None:
    services = Services()
    link = await greeted(services)

    def broken() -> None:
        raise LookupError("as intended")

    services.list_nodes = broken  # type: ignore[method-assign, assignment]
    with pytest.raises(ControlError, match="requests to the container failed: as intended"):
        await link.receive()
    link.close()
    assert "as intended" in caplog.text


async def test_a_load_whose_turn_comes_after_the_stop_is_not_sent() -> None:
    services = Services()
    slots = asyncio.Semaphore(1)
    await slots.acquire()  # another container loads
    link = await greeted(services, slots=slots)
    link.send(load(1, "a"))
    await settle()
    ending = asyncio.create_task(link.unload_all())
    await settle()
    slots.release()
    await ending
    await settle()
    assert not services.loads
    link.close()


async def test_a_supervisor_without_a_node_of_its_own_reports_that_and_does_not_wait() -> None:
    class Deaf(Services):
        async def ready(self) -> None:
            raise RosThreadError("the supervisor's ROS node does not start: no participant")

    link = link_to(Deaf())
    with pytest.raises(ControlError, match="no participant"):
        await link.handshake(Hello(version="1"))
    link.close()

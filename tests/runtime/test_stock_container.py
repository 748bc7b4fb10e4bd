"""What is needed for all stock containers of a system, and what is not."""

from __future__ import annotations

import asyncio
from bisect import bisect
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import pytest
from msgspec.structs import replace

from play_launch.config.model import (
    ContainerType,
    ParameterConfig,
    ParameterType,
    ParameterValue,
)
from play_launch.container.codec import EncodeError
from play_launch.container.messages import Load
from play_launch.container.ros import NotInstalledError
from play_launch.ros.composition import CompositionClient
from play_launch.runtime.stock_containers import StockContainers
from play_launch.runtime.stock_link import load_node_request

from .fakes import container, system
from .jumping_loop import run as run_jumping

if TYPE_CHECKING:
    from collections.abc import Callable


def test_each_domain_has_a_participant(ros_domain: int, other_domain: int) -> None:
    here = replace(container("a"), container_type=ContainerType.STOCK)
    elsewhere = replace(
        here, full_name="/b", environment=MappingProxyType({"ROS_DOMAIN_ID": str(other_domain)})
    )
    stock = StockContainers()
    stock.extend(system(here, elsewhere, replace(here, full_name="/c")))
    try:
        assert {each.domain_id for each in stock._threads.values()} == {ros_domain, other_domain}
    finally:
        stock.close()
    assert not stock._threads


class Graph:
    """A ROS thread in whose graph services come and go at certain times."""

    def __init__(self, *changes: float) -> None:
        self._changes = changes

    def post(self, work: object) -> None:
        pass

    async def until(self, holds: Callable[[Any], bool]) -> None:
        while not holds(None):
            await asyncio.sleep(0.001)

    def service_is_ready(self) -> bool:
        return bisect(self._changes, asyncio.get_running_loop().time()) % 2 == 0


@pytest.mark.parametrize(("changes", "expected"), [((1.0,), 2.0), ((1.0, 1.002, 5.0), 6.0)])
def test_services_that_are_away_for_a_moment_are_not_gone(
    changes: tuple[float, ...], expected: float
) -> None:
    async def gone() -> float:
        loop = asyncio.get_running_loop()
        began = loop.time()
        graph: Any = Graph(*(began + each for each in changes))
        client = CompositionClient(graph, "/theirs")
        client._clients = dict.fromkeys(("load_node", "list_nodes"), graph)
        await client.gone()
        return loop.time() - began

    assert run_jumping(gone()) == pytest.approx(expected, abs=0.01)


def test_what_keeps_ros_from_working_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: object) -> None:
        raise RuntimeError("no such network")

    monkeypatch.setattr("play_launch.ros.thread.RosThread.until_started", refuse)
    config = system(replace(container("a"), container_type=ContainerType.STOCK))
    with pytest.raises(NotInstalledError, match=r"no such network.*doctor"):
        StockContainers().extend(config)


def test_a_request_holds_everything_with_its_type() -> None:
    rate = ParameterConfig("rate", ParameterValue(ParameterType.DOUBLE, 1.0))
    intra = ParameterConfig("use_intra_process_comms", ParameterValue(ParameterType.BOOL, True))
    request = load_node_request(
        Load(
            attempt=1,
            package_name="demo",
            plugin_name="demo::Node",
            node_name="n",
            node_namespace="/a",
            log_level=30,
            remap_rules=("x:=/y",),
            parameters=(rate,),
            extra_arguments=(intra,),
        )
    )
    assert (request.package_name, request.plugin_name) == ("demo", "demo::Node")
    assert (request.node_name, request.node_namespace, request.log_level) == ("n", "/a", 30)
    assert list(request.remap_rules) == ["x:=/y"]
    assert (request.parameters[0].value.type, request.parameters[0].value.double_value) == (3, 1.0)
    assert request.extra_arguments[0].value.bool_value is True


def test_a_value_that_does_not_fit_is_refused() -> None:
    with pytest.raises(EncodeError):
        load_node_request(
            Load(attempt=1, package_name="demo", plugin_name="demo::Node", log_level=1000)
        )

"""One node of our own for each domain, shared by its users."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from play_launch.config.model import ParameterConfig, ParameterType, ParameterValue
from play_launch.ros.parameters import ParameterSetter
from play_launch.ros.thread import NodePool, RosThread

if TYPE_CHECKING:
    from rclpy.context import Context
    from rclpy.node import Node

    from play_launch.ros.waiting import Waiting

pytestmark = pytest.mark.anyio

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

    def fails(_: RosThread) -> tuple[Context, Node, Waiting]:
        raise next(failures)

    monkeypatch.setattr(RosThread, "_open", fails)
    setter = ParameterSetter()
    assert "no space" in await setter.set("/n", [RATE], {})
    assert "joined" in await setter.set("/n", [RATE], {})
    await setter.close()

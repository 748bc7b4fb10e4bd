"""The channel against the real container: both sides mean the same bytes."""

from __future__ import annotations

import asyncio
import os
import subprocess
from contextlib import asynccontextmanager, closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from play_launch.config.model import (
    ContainerConfig,
    ParameterConfig,
    ParameterType,
    ParameterValue,
)
from play_launch.container.channel import ChannelClosedError, ControlChannel, control_pair
from play_launch.container.command import container_argv
from play_launch.container.environment import child_environment
from play_launch.container.messages import (
    PROTOCOL_VERSION,
    Accepted,
    Hello,
    Incoming,
    Load,
    NodeStatusState,
    Query,
    Rejected,
    Shutdown,
    Status,
    Unload,
)
from play_launch.container.ros import component_container, ros_installation
from play_launch.supervisor.events import ComponentEvent, ComponentEventKind

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

pytestmark = pytest.mark.anyio
NAME = "/native/container"
TALKER = Load(
    attempt=7,
    package_name="play_launch_demo",
    plugin_name="play_launch_demo::Talker",
    node_name="my_talker",
    node_namespace="/ns",
    remap_rules=("chatter:=/elsewhere",),
    parameters=(ParameterConfig("rate", ParameterValue(ParameterType.DOUBLE, 5.0)),),
)


class Talk:
    """A running container, its channel and its hello."""

    def __init__(self, process: subprocess.Popen[bytes], channel: ControlChannel) -> None:
        self.process = process
        self.channel = channel
        self.hello = Hello(version="")

    async def hear(self) -> Incoming:
        async with asyncio.timeout(60):
            return await self.channel.receive()

    async def hear_event(self, kind: ComponentEventKind) -> ComponentEvent:
        message = await self.hear()
        assert isinstance(message, ComponentEvent), message
        assert message.kind is kind, message
        return message

    async def exit_code(self) -> int:
        async with asyncio.timeout(60):
            return await asyncio.to_thread(self.process.wait)


@asynccontextmanager
async def talking() -> AsyncIterator[Talk]:
    config = ContainerConfig(name="container", namespace="/native", full_name=NAME, thread_num=2)
    ros = await asyncio.to_thread(ros_installation)
    binary = await asyncio.to_thread(component_container)
    with control_pair() as pair:
        environment = child_environment(os.environ, ros, pair.environment)
        process = await asyncio.to_thread(
            subprocess.Popen,
            container_argv(config, binary),
            env=environment,
            pass_fds=[pair.child_fd],
        )
        try:
            pair.close_child_end()
            with closing(ControlChannel(pair.ours, container=NAME)) as channel:
                talk = Talk(process, channel)
                async with asyncio.timeout(60):
                    talk.hello = await channel.handshake(Hello(version="test"))
                yield talk
        finally:
            pair.close()  # it ends by itself, as the last test here shows
            try:
                await asyncio.to_thread(process.wait, 20)
            finally:
                process.kill()
                process.wait()


async def test_hello_says_who_it_is() -> None:
    async with talking() as talk:
        hello = talk.hello
        assert (hello.full_node_name, hello.pid) == (NAME, talk.process.pid)
        assert hello.protocol_version == PROTOCOL_VERSION
        assert hello.mode == "standard"
        assert "native" in hello.backends
        assert hello.domain_id == int(os.environ["ROS_DOMAIN_ID"])
        stat = Path(f"/proc/{hello.pid}/stat").read_text().rpartition(")")[2].split()
        assert hello.start_time == int(stat[19])


async def test_the_life_of_a_node() -> None:
    async with talking() as talk:
        talk.channel.send(TALKER)
        accepted = await talk.hear()
        assert isinstance(accepted, Accepted)
        assert accepted.attempt == TALKER.attempt
        loading = await talk.hear_event(ComponentEventKind.LOADING)
        loaded = await talk.hear_event(ComponentEventKind.LOADED)
        for event in (loading, loaded):
            assert (event.attempt, event.unique_id) == (TALKER.attempt, accepted.unique_id)
            assert event.container == NAME
        assert loaded.full_node_name == "/ns/my_talker"
        assert (loaded.package_name, loaded.plugin_name) == (
            TALKER.package_name,
            TALKER.plugin_name,
        )
        assert loaded.pid == talk.process.pid
        assert loaded.stamp_ns >= loading.stamp_ns > 10**18

        talk.channel.send(
            Query(query_id=3, unique_ids=(accepted.unique_id, accepted.unique_id + 100))
        )
        status = await talk.hear()
        assert isinstance(status, Status)
        (node,) = status.nodes
        assert (status.query_id, node.unique_id, node.state, node.full_node_name) == (
            3,
            accepted.unique_id,
            NodeStatusState.LOADED,
            "/ns/my_talker",
        )

        talk.channel.send(Unload(unique_id=accepted.unique_id))
        assert (await talk.hear_event(ComponentEventKind.UNLOADED)).unique_id == accepted.unique_id
        talk.channel.send(Unload(unique_id=accepted.unique_id))
        rejected = await talk.hear()
        assert isinstance(rejected, Rejected)
        assert rejected.unique_id == accepted.unique_id
        assert rejected.reason


async def test_shutdown_unloads_and_ends_well() -> None:
    async with talking() as talk:
        talk.channel.send(TALKER)
        talk.channel.send(Shutdown(reason="the test is over"))
        kinds: list[ComponentEventKind] = []
        with suppress(ChannelClosedError):
            while True:
                message = await talk.hear()
                if isinstance(message, ComponentEvent):
                    kinds.append(message.kind)
        assert kinds[-1] is ComponentEventKind.UNLOADED
        assert await talk.exit_code() == 0


async def test_a_container_without_a_supervisor_ends() -> None:
    async with talking() as talk:
        talk.channel.send(TALKER)
        assert isinstance(await talk.hear(), Accepted)
        talk.channel.close()
        await talk.exit_code()

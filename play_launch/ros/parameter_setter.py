"""Sets parameters of running nodes through their services, over a ROS node of our own."""

from __future__ import annotations

import asyncio
import os
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

import anyio

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from play_launch.config.model import ParameterConfig
    from play_launch.ros.thread import RosThread

_DOMAIN: Final = "ROS_DOMAIN_ID"
FIND_LIMIT: Final = 10.0
"""Seconds until a node counts as one that has no parameter services. DDS takes up to three to
introduce a new participant to existing ones, and longer on a busy machine; after a shorter
timeout, nodes would be reloaded without need."""
ANSWER_LIMIT: Final = 3.0
"""Seconds for the answer of a service that is there."""


class ParameterSetter:
    """Sets parameters of running nodes.

    One ROS node for each domain is created when it is first needed, and kept: DDS takes seconds to
    introduce others to a second one at the address of the first.
    Belongs to the event loop's thread.
    """

    def __init__(self) -> None:
        """Take part in no domain yet."""
        self._threads: dict[int | None, asyncio.Future[RosThread]] = {}

    async def set(
        self, node: str, parameters: Sequence[ParameterConfig], environment: Mapping[str, str]
    ) -> str:
        """Set all of them or none; return why not."""
        given = environment.get(_DOMAIN, "")
        try:
            ros = await self._thread(int(given) if given else None)
            return await self._ask(ros, node, parameters)
        except Exception as error:  # noqa: BLE001 - whatever keeps us from it, there is another way
            return f"its parameters cannot be set: {error}"

    async def close(self) -> None:
        """End the ROS nodes."""
        threads, self._threads = self._threads, {}
        for thread in threads.values():
            with suppress(Exception):
                await asyncio.to_thread((await thread).close)

    async def _thread(self, domain: int | None) -> RosThread:
        known = self._threads.get(domain)
        has_failed = known is not None and known.done() and known.exception() is not None
        if known is None or has_failed:
            started = asyncio.ensure_future(asyncio.to_thread(_start, domain))
            self._threads[domain] = started
        # Several wait for it; one that gives up must not end it for the others.
        return await asyncio.shield(self._threads[domain])

    async def _ask(self, ros: RosThread, node: str, parameters: Sequence[ParameterConfig]) -> str:
        # Takes long, and is needed for changes only.
        from rcl_interfaces.srv import SetParametersAtomically  # noqa: PLC0415

        from play_launch.ros.parameters import to_parameter_message  # noqa: PLC0415

        service = f"{node}/set_parameters_atomically"
        client: Any = await ros.call(
            lambda ours: ours.create_client(SetParametersAtomically, service)
        )
        try:
            with anyio.move_on_after(FIND_LIMIT) as finding:
                await ros.until(lambda _: client.service_is_ready())
            if finding.cancelled_caught:
                return f"its parameter service is not found within {FIND_LIMIT:g} s"
            request = SetParametersAtomically.Request()
            request.parameters = [to_parameter_message(each) for each in parameters]
            with anyio.move_on_after(ANSWER_LIMIT) as asking:
                answer = await ros.request(lambda _: client.call_async(request))
            if asking.cancelled_caught:
                return f"its parameter service does not answer within {ANSWER_LIMIT:g} s"
        finally:
            ros.post(lambda ours: _destroy(ours, client))
        if answer.result.successful:
            return ""
        return answer.result.reason or "it refuses the parameters"


def _destroy(ours: Any, client: Any) -> None:
    ours.destroy_client(client)


def _start(domain: int | None) -> RosThread:
    from play_launch.ros.thread import RosThread  # noqa: PLC0415

    thread = RosThread(f"_play_launch_parameters_{os.getpid()}", domain_id=domain)
    thread.start()
    return thread

"""A client of one managed node: its state, its transitions."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, Final

import anyio

from play_launch.ros.thread import hand_over

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

    from play_launch.ros.thread import RosThread


_FIRST_LIMIT: Final = 1.0
"""Seconds until a state is asked for again; each time twice as many. A node that sees our request
before it sees where its answer goes drops it."""


class ManagedNodeClient:
    """Talks to the node of a name; belongs to one event loop.

    Attributes:
        is_offered: Whether its services have been discovered.
    """

    def __init__(self, ros: RosThread, name: str, on_state: Callable[[int], None]) -> None:
        """Talk to the node with this full name; ``on_state`` gets every state that it enters.

        States are numbers of ``lifecycle_msgs/msg/State``.
        """
        self._ros = ros
        self._name = name
        self._on_state = on_state
        self._heard = 0
        self.is_offered = False
        self._loop = asyncio.get_running_loop()
        self._entities: dict[str, Any] = {}
        ros.post(self._create)

    async def state(self) -> int:
        """Wait until the node offers its services, and ask for its state.

        One that it enters meanwhile is newer than the answer may be: then it is asked once more.
        """
        await self._ros.until(lambda _: self._is_ready())
        self.is_offered = True
        while True:
            heard = self._heard
            reply = await self._state_asked_until_answered()
            if self._heard == heard:
                return int(reply.current_state.id)

    async def change(self, transition: int) -> bool:
        """Ask for a transition and wait for its end; whether it succeeded."""

        def with_transition(request: Any) -> Any:
            request.transition.id = transition
            return request

        reply = await self._call("change_state", with_transition)
        return bool(reply.success)

    def close(self) -> None:
        """End it; answers that are still expected are dropped."""
        self._ros.post(self._destroy)

    def _hear(self, state: int) -> None:
        self._heard += 1
        self._on_state(state)

    def _is_ready(self) -> bool:
        clients = [self._entities.get(name) for name in ("get_state", "change_state")]
        return all(each is not None and each.service_is_ready() for each in clients)

    async def _state_asked_until_answered(self) -> Any:
        limit = _FIRST_LIMIT
        while True:
            with anyio.move_on_after(limit):
                return await self._call("get_state", lambda request: request)
            limit *= 2

    async def _call(self, name: str, fill: Callable[[Any], Any]) -> Any:
        # It is gone only when this was closed, and has no waiters.
        return await self._ros.request(
            lambda _: self._entities[name], lambda kind: fill(kind.Request())
        )

    def _create(self, node: Node) -> None:
        # Takes long, so it is done in the thread.
        from lifecycle_msgs.msg import TransitionEvent  # noqa: PLC0415
        from lifecycle_msgs.srv import ChangeState, GetState  # noqa: PLC0415

        def on_event(event: Any) -> None:
            hand_over(self._loop, self._hear, int(event.goal_state.id))

        self._entities = {
            "transition_event": node.create_subscription(
                TransitionEvent, f"{self._name}/transition_event", on_event, 10
            ),
            "change_state": node.create_client(ChangeState, f"{self._name}/change_state"),
            "get_state": node.create_client(GetState, f"{self._name}/get_state"),
        }

    def _destroy(self, node: Node) -> None:
        entities, self._entities = self._entities, {}
        for name, entity in entities.items():
            if name == "transition_event":
                node.destroy_subscription(entity)
            else:
                node.destroy_client(entity)

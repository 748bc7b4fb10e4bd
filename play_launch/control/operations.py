"""The operations of the control socket on a running system."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING, Any

from play_launch.control.action_record import ActionRecords
from play_launch.control.actions import Actions
from play_launch.control.follow import Follower
from play_launch.control.outcome import Action
from play_launch.control.protocol import (
    ROS_VARIABLES,
    Code,
    ControlError,
    flag_argument,
    names_argument,
)
from play_launch.control.rows import Clock, add_groups, rows_of
from play_launch.control.selection import KINDS, selection_of
from play_launch.control.targets import chosen, members_of, nodes_of
from play_launch.recording.topic_recorder.snapshot import SnapshotError
from play_launch.supervisor.events import ProcessSample

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Mapping, Sequence

    from play_launch.control.connection import Stream
    from play_launch.control.feed import Feed
    from play_launch.control.place import Peer
    from play_launch.control.protocol import Request
    from play_launch.control.rows import Samples
    from play_launch.control.targets import Target
    from play_launch.recording.topic_recorder.snapshot import Snapshots
    from play_launch.runtime.publisher import Publisher
    from play_launch.runtime.system import System
    from play_launch.supervisor.events import RunEvent
    from play_launch.supervisor.view import SystemView

    Operation = Callable[[dict[str, Any], Peer, Stream], Awaitable[object]]


class Operations:
    """What can be asked of one session. It belongs to the thread of the event loop."""

    def __init__(
        self,
        system: System,
        publisher: Publisher,
        feed: Feed,
        *,
        snapshots: Snapshots,
        environment: Mapping[str, str],
    ) -> None:
        """Know the system; what happens in it comes from the feed.

        ``environment`` is that of its processes.
        """
        self._environment = {
            name: value for name, value in environment.items() if name.startswith(ROS_VARIABLES)
        }
        self._publisher = publisher
        self._feed = feed
        self._system = system
        self._samples: Samples = {}
        self._snapshots = snapshots
        self.records = ActionRecords(publisher)
        """Where whatever changes the system is recorded."""
        actions = Actions(system, publisher, feed, self.records)
        self._table: dict[str, Operation] = {
            "ps": self._ps,
            "events": self._events,
            "wait": actions.wait,
            "snapshot": self._snapshot,
            "environment": self._give_environment,
            **{action.value: partial(actions.act, action) for action in Action},
        }
        publisher.add_sink(self)

    def add(self, name: str, operation: Operation) -> None:
        """Offer an operation more; a name means one only."""
        if name in self._table:
            raise ValueError(f"there is an operation {name} already")
        self._table[name] = operation

    async def __call__(self, request: Request, peer: Peer, stream: Stream) -> object:
        """Carry a request out; raises ControlError."""
        operation = self._table.get(request.operation)
        if operation is None:
            known = ", ".join(sorted(self._table))
            raise ControlError(
                Code.UNKNOWN_OPERATION,
                f"there is no operation {request.operation!r:.80}; there are: {known}",
            )
        return await operation(dict(request.arguments), peer, stream)

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:  # noqa: ARG002 - a sink
        """See an event."""
        if isinstance(event, ProcessSample):
            self._samples[event.kind, event.key] = event

    async def _ps(self, arguments: dict[str, Any], _peer: Peer, _stream: Stream) -> object:
        view = self._publisher.view
        rows = rows_of(view, self._system.processes, self._samples, Clock())
        wanted = names_argument(arguments)
        if wanted:
            found = {str(target) for target in self.chosen(wanted)}
            rows = [row for row in rows if _key(row) in found]
        await asyncio.to_thread(add_groups, rows)
        return rows

    async def _events(self, arguments: dict[str, Any], _peer: Peer, stream: Stream) -> object:
        names, kinds = names_argument(arguments), names_argument(arguments, "kinds")
        if wrong := set(kinds) - KINDS:
            raise ControlError(
                Code.BAD_ARGUMENTS,
                f"there are no events {min(wrong)!r:.80}; there are: {', '.join(sorted(KINDS))}",
            )
        follower = Follower(selection_of(kinds, self.chosen(names) if names else None))
        follows = flag_argument(arguments, "follow")
        past = [] if flag_argument(arguments, "only_new") else self._feed.recent()
        with self._feed.followed_by(follower.take):
            await follower.send_all(past, stream)
            if follows:
                await follower.follow(stream)
        return {"events": "sent"}

    async def _give_environment(
        self, _arguments: dict[str, Any], _peer: Peer, _stream: Stream
    ) -> object:
        return self._environment

    async def _snapshot(self, _arguments: dict[str, Any], peer: Peer, _stream: Stream) -> object:
        async with self.records.recorded("snapshot", (), peer):
            try:
                snapshot = await self._snapshots.take()
            except SnapshotError as error:
                raise ControlError(Code.REFUSED, str(error)) from None
        return {
            "messages": snapshot.messages,
            "bytes": snapshot.bytes,
            "seconds": snapshot.seconds,
        }

    def chosen(self, wanted: Sequence[str]) -> list[Target]:
        """Find what names and patterns mean; raises ControlError."""
        view = self._publisher.view
        return chosen(wanted, [*members_of(view, self._system.processes), *nodes_of(view)])


def _key(row: dict[str, Any]) -> str:
    return f"{row['container']}:{row['name']}" if row["container"] else str(row["name"])

"""Runs a daemon for as long as a system runs, and publishes which nodes come and go."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import time
from collections import Counter
from typing import TYPE_CHECKING, Final

from play_launch.core.events import GraphChanged
from play_launch.graph_daemon.client.graph_client import DaemonError, GraphClient
from play_launch.graph_daemon.contract import LISTENING, NODE_PREFIX, STATUS_METHOD, daemon_address
from play_launch.graph_daemon.control.start_stop import (
    PortHeldError,
    Started,
    StartError,
    start_daemon,
    stop_daemon,
)

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Iterable, Mapping

    from play_launch.core.events import EventSink
    from play_launch.graph_daemon.contract import DaemonAddress

LOOK: Final = 0.5
"""Seconds between two questions whether the graph has changed, while it changes."""
LONGEST_LOOK: Final = 2.0
"""Seconds between them at rest."""
FORSAKEN: Final = 60.0
"""Seconds without a question after which the daemon ends by itself: we ask all the time, so then
we were killed."""
_WAIT: Final = 10.0
_RECORDER_PREFIX: Final = "_play_launch_recorder_"
"""Of the node in `container_native/src/topic_recorder/ros.cpp`."""
_log = logging.getLogger(__name__)


def changes(before: Counter[str], now: Counter[str], stamp_ns: int) -> GraphChanged | None:
    """Compare two lists of nodes, each with how often a name occurs; None when they are equal."""
    if before == now:
        return None
    return GraphChanged(
        stamp_ns=stamp_ns,
        appeared=tuple(sorted((now - before).elements())),
        vanished=tuple(sorted((before - now).elements())),
        nodes=now.total(),
    )


def next_look(pause: float, *, changed: bool) -> float:
    """Return the seconds until the next question, ``pause`` being those before this one.

    A graph that has changed changes again soon; at rest the pauses grow.
    """
    return LOOK if changed else min(1.25 * pause, LONGEST_LOOK)


@contextlib.asynccontextmanager
async def observed_graph(environment: Mapping[str, str], sink: EventSink) -> AsyncIterator[None]:
    """Have a daemon serve while the block runs, and publish a `GraphChanged` for each change.

    A daemon that ran before goes on afterwards; one that was started for the block is stopped. The
    block runs in any case: what keeps the daemon from starting is logged as a warning.

    Args:
        environment: That of the system's processes, for domain and discovery.
        sink: Takes the events, in the loop's thread.
    """
    address = daemon_address(environment)
    try:
        # The daemon must know its settings, the nodes need not wait until it knows them.
        started = await asyncio.to_thread(
            start_daemon,
            address,
            wait_for=LISTENING,
            idle_timeout=FORSAKEN,
            environment=environment,
        )
    except (PortHeldError, StartError, OSError) as error:
        _log.warning("no graph daemon: %s", error)
        yield
        return
    log = _log.info if started.started else _log.warning
    for message in started.messages:
        log("graph daemon: %s", message)
    observer = _Observer(address, sink)
    watching = asyncio.create_task(observer.run())
    try:
        yield
    finally:
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)
        await observer.look()
        if started.started:
            await asyncio.to_thread(_stop, address, started)


def _stop(address: DaemonAddress, started: Started) -> None:
    try:
        # Somebody may have replaced it by another one.
        if started.process is not None and started.process.poll() is None:
            stop_daemon(address)
    except (PortHeldError, OSError) as error:
        _log.warning("the graph daemon did not end: %s", error)
    if started.process is not None:
        started.process.kill()
        started.process.wait(_WAIT)


class _Observer:
    def __init__(self, address: DaemonAddress, sink: EventSink) -> None:
        self._client = GraphClient(address)
        self._sink = sink
        self._known: Counter[str] = Counter()
        self._generation = -1
        self._failing = False

    async def run(self) -> None:
        """Look again and again; ends by cancellation."""
        pause = LOOK
        while True:
            changed = await self.look()
            pause = next_look(pause, changed=changed)
            await asyncio.sleep(pause)

    async def look(self) -> bool:
        """Publish what has changed since the last look; whether a change is to be expected soon."""
        try:
            known = str(self._generation)
            text = await asyncio.to_thread(self._client.call, STATUS_METHOD, known)
            if not text:
                self._failing = False
                return False
            status = json.loads(str(text))
            generation, unchanged_for = int(status["generation"]), float(status["unchanged_for"])
            stamp_ns = time.time_ns() - round(1e9 * unchanged_for)
            # Before that the daemon does not answer, and a list that is not complete is no change.
            if not status["warm"]:
                return True
            nodes = await asyncio.to_thread(self._client.nodes)
        except (DaemonError, ValueError, KeyError, TypeError) as error:
            if not self._failing:
                _log.warning("the graph daemon does not answer: %s", error)
            self._failing = True
            return True
        self._failing = False
        self._generation = generation
        event = self._fold((node.full_name for node in nodes if not _is_ours(node.name)), stamp_ns)
        if event is not None:
            self._sink.publish(event)
        return True

    def _fold(self, nodes: Iterable[str], stamp_ns: int) -> GraphChanged | None:
        now = Counter(nodes)
        event = changes(self._known, now, stamp_ns)
        self._known = now
        return event


def _is_ours(name: str) -> bool:
    """Whether it is a daemon, or what records topics."""
    return name.startswith((NODE_PREFIX, _RECORDER_PREFIX))

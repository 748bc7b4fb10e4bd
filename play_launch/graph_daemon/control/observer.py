"""Has a daemon serve while a system runs, and publishes which nodes come and go."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import threading
import time
from collections import Counter
from concurrent.futures import Future
from functools import partial
from typing import TYPE_CHECKING, Final, TypeVar

from play_launch.graph_daemon.client.graph_client import (
    BadReplyError,
    DaemonError,
    GraphClient,
    NoDaemonError,
    RemoteError,
)
from play_launch.graph_daemon.contract import (
    LISTENING,
    NODE_PREFIX,
    STATUS_METHOD,
    DomainError,
    daemon_address,
)
from play_launch.graph_daemon.control.start_stop import PortHeldError, StartError, start_daemon
from play_launch.supervisor.events import GraphChanged

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from play_launch.graph_daemon.contract import DaemonAddress
    from play_launch.supervisor.events import EventSink

_Result = TypeVar("_Result")

LOOK: Final = 0.5
"""Seconds between two questions whether the graph has changed, while it changes."""
LONGEST_LOOK: Final = 2.0
"""Seconds between them at rest."""
FORSAKEN: Final = 60.0
"""Seconds without a question after which the daemon ends by itself: each session asks all the time,
so then the last one has ended."""
BETWEEN_STARTS: Final = 10.0
"""Seconds from one start of the daemon to the next at least."""
_LAST_LOOK: Final = 2.0
_GONE: Final = (NoDaemonError, RemoteError, BadReplyError, ValueError, KeyError, TypeError)
"""What means that our daemon does not have the port any more."""
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


async def observe_graph(environment: Mapping[str, str], sink: EventSink) -> None:
    """Have a daemon serve, and publish a `GraphChanged` for each change, until cancelled.

    A daemon that runs is used as it is; one that is gone is started again. It is never stopped:
    other sessions may ask it, and without a question it ends by itself.

    Args:
        environment: That of the system's processes, for domain and discovery.
        sink: Takes the events, in the loop's thread.
    """
    try:
        address = daemon_address(environment)
    except DomainError as error:
        _log.warning("no graph daemon: %s", error)
        return
    observer = _Observer(address, sink)
    loop = asyncio.get_running_loop()
    while True:
        earliest = loop.time() + BETWEEN_STARTS
        try:
            # The daemon must know its settings, the nodes need not wait until it knows them.
            started = await _in_a_thread(
                partial(
                    start_daemon,
                    address,
                    wait_for=LISTENING,
                    idle_timeout=FORSAKEN,
                    environment=environment,
                )
            )
        except (PortHeldError, StartError, OSError) as error:
            observer.warn_once(f"no graph daemon: {error}")
        else:
            log = _log.info if started.started else _log.warning
            for message in started.messages:
                log("graph daemon: %s", message)
            if started.process is not None:  # it is reaped whenever it ends
                threading.Thread(target=started.process.wait, daemon=True).start()
            await observer.run()
        await asyncio.sleep(earliest - loop.time())


class _Observer:
    def __init__(self, address: DaemonAddress, sink: EventSink) -> None:
        self._client = GraphClient(address)
        self._sink = sink
        self._known: Counter[str] = Counter()
        self._generation = -1
        self._warning = ""

    def warn_once(self, text: str) -> None:
        """Log a warning, unless it is the last one and the daemon has not answered since."""
        if text != self._warning:
            _log.warning("%s", text)
        self._warning = text

    async def run(self) -> None:
        """Look again and again until the daemon is gone, and once more when cancelled."""
        self._generation = -1
        pause = LOOK
        try:
            while True:
                changed = await self._look()
                pause = next_look(pause, changed=changed)
                await asyncio.sleep(pause)
        except _GONE as error:
            self.warn_once(f"the graph daemon does not answer: {error}")
        except asyncio.CancelledError:
            with contextlib.suppress(TimeoutError, *_GONE):
                async with asyncio.timeout(_LAST_LOOK):
                    await self._look()
            raise

    async def _look(self) -> bool:
        """Publish what has changed since the last look; whether a change is to be expected soon."""
        try:
            known = str(self._generation)
            text = await _in_a_thread(partial(self._client.call, STATUS_METHOD, known))
            if not text:
                self._warning = ""
                return False
            status = json.loads(str(text))
            generation, unchanged_for = int(status["generation"]), float(status["unchanged_for"])
            stamp_ns = time.time_ns() - round(1e9 * unchanged_for)
            # Before that the daemon does not answer, and a list that is not complete is no change.
            if not status["warm"]:
                return True
            nodes = await _in_a_thread(self._client.nodes)
        except _GONE:
            raise
        except DaemonError as error:  # it is busy or stopped, perhaps
            self.warn_once(f"the graph daemon does not answer: {error}")
            return True
        self._warning = ""
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


def _in_a_thread(work: Callable[[], _Result]) -> asyncio.Future[_Result]:
    """Run it in a thread that nothing waits for at the end: a daemon may take a minute to start."""
    done: Future[_Result] = Future()
    done.set_running_or_notify_cancel()

    def run() -> None:
        try:
            done.set_result(work())
        except Exception as error:  # noqa: BLE001 - it is raised where it is awaited
            done.set_exception(error)

    threading.Thread(target=run, name="graph daemon", daemon=True).start()
    return asyncio.wrap_future(done)

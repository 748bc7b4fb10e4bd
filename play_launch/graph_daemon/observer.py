"""Keeps a daemon running beside a system, and publishes which nodes appear and vanish."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import threading
import time
from collections import Counter
from functools import partial
from typing import TYPE_CHECKING, Final

from play_launch import UserError
from play_launch.graph_daemon.contract import (
    LISTENING,
    LONGEST_USE,
    NODE_PREFIX,
    STATUS_METHOD,
    DomainError,
    daemon_address,
)
from play_launch.graph_daemon.graph_client import (
    BadReplyError,
    DaemonError,
    GraphClient,
    NoDaemonError,
    RemoteError,
)
from play_launch.graph_daemon.start_stop import start_daemon
from play_launch.process.descendants import in_a_thread
from play_launch.supervisor.events import GraphChanged

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from play_launch.graph_daemon.contract import DaemonAddress
    from play_launch.supervisor.endpoints import Endpoint


POLL: Final = 0.5
"""Seconds between two queries while the graph changes."""
LONGEST_POLL: Final = 2.0
"""Seconds between them while it does not."""
ORPHAN_TIMEOUT: Final = 60.0
"""Seconds without a request after which the daemon exits: each session sends requests all the time,
so then the last one has ended."""
BETWEEN_STARTS: Final = 10.0
"""Seconds from one start of the daemon to the next at least."""
_LAST_POLL_TIMEOUT: Final = 2.0
_GONE: Final = (NoDaemonError, RemoteError, BadReplyError, ValueError, KeyError, TypeError)
"""Errors which mean that our daemon has lost the port."""
_OWN_NODES: Final = (NODE_PREFIX, "_play_launch_recorder_")
"""Prefixes of daemons' nodes, and of the one in `container_native/src/topic_recorder/ros.cpp`."""
_OWN_ENDPOINTS: Final = tuple(f"/{prefix}" for prefix in _OWN_NODES)
MOST_ENDPOINTS: Final = 20_000
"""Publishers and subscriptions that are recorded; some 100 bytes each."""
_log = logging.getLogger(__name__)


async def observe_graph(
    environment: Mapping[str, str], publish: Callable[[GraphChanged], None]
) -> None:
    """Keep a daemon running, and publish a `GraphChanged` for each change, until cancelled.

    A daemon that runs is used as it is; one that has ended is started again. It is never stopped:
    other sessions may use it, and without requests it exits.

    The environment is that of the system's processes, for domain and discovery.
    """
    try:
        address = daemon_address(environment)
    except DomainError as error:
        _log.warning("no graph daemon: %s", error)
        return
    observer = _Observer(address, publish)
    loop = asyncio.get_running_loop()
    while True:
        earliest = loop.time() + BETWEEN_STARTS
        try:
            # Listening is enough: requests wait for the graph by themselves.
            started = await in_a_thread(
                partial(
                    start_daemon,
                    address,
                    wait_for=LISTENING,
                    idle_timeout=ORPHAN_TIMEOUT,
                    environment=environment,
                )
            )
        except (UserError, OSError) as error:
            observer.warn_once(f"no graph daemon: {error}")
        else:
            log = _log.info if started.started else _log.warning
            for message in started.messages:
                log("graph daemon: %s", message)
            if started.process is not None:  # reap it whenever it ends
                threading.Thread(target=started.process.wait, daemon=True).start()
            await observer.run()
        await asyncio.sleep(earliest - loop.time())


class _Observer:
    def __init__(self, address: DaemonAddress, publish: Callable[[GraphChanged], None]) -> None:
        self._client = GraphClient(address)
        self._publish = publish
        self._known: Counter[str] = Counter()
        self._endpoints: Counter[Endpoint] = Counter()
        self._reports_endpoints = True
        self._generation = -1
        self._warning = ""

    def warn_once(self, text: str) -> None:
        """Log a warning, unless it is the last one and the daemon has not answered since."""
        if text != self._warning:
            _log.warning("%s", text)
        self._warning = text

    async def run(self) -> None:
        """Poll until the daemon has ended, and once more when cancelled."""
        self._generation = -1
        self._reports_endpoints = True
        pause = POLL
        try:
            while True:
                changed = await self._poll()
                pause = POLL if changed else min(1.25 * pause, LONGEST_POLL)
                await asyncio.sleep(pause)
        except _GONE as error:
            self.warn_once(f"the graph daemon does not answer: {error}")
        except asyncio.CancelledError:
            with contextlib.suppress(TimeoutError, *_GONE):
                async with asyncio.timeout(_LAST_POLL_TIMEOUT):
                    await self._poll()
            raise

    async def _poll(self) -> bool:
        """Publish what has changed since the last poll; return whether to poll again soon."""
        try:
            generation_known = str(self._generation)
            text = await in_a_thread(partial(self._client.call, STATUS_METHOD, generation_known))
            if not text:
                self._warning = ""
                return False
            status = json.loads(str(text))
            generation, unchanged_for = int(status["generation"]), float(status["unchanged_for"])
            stamp_ns = time.time_ns() - round(1e9 * unchanged_for)
            # Before that the list is not complete, which is no change of the graph.
            if not status["warm"]:
                return True
            nodes = await in_a_thread(self._client.nodes)
            endpoints = await self._query_endpoints()
        except _GONE:
            raise
        except DaemonError as error:  # it may be busy or stopped
            self.warn_once(f"the graph daemon does not answer: {error}")
            return True
        self._warning = ""
        # A younger change may not be in what was answered: the daemon repeats answers for a while.
        self._generation = generation if unchanged_for >= LONGEST_USE else -1
        before, known = self._known, self._endpoints
        now = Counter(each.full_name for each in nodes if not each.name.startswith(_OWN_NODES))
        self._known, self._endpoints = now, endpoints
        if before != now or known != endpoints:
            self._publish(
                GraphChanged(
                    stamp_ns=stamp_ns,
                    appeared=tuple(sorted((now - before).elements())),
                    vanished=tuple(sorted((before - now).elements())),
                    nodes=now.total(),
                    endpoints_appeared=tuple(sorted((endpoints - known).elements())),
                    endpoints_vanished=tuple(sorted((known - endpoints).elements())),
                )
            )
        return True

    async def _query_endpoints(self) -> Counter[Endpoint]:
        """Return those that are to be recorded; what was known before where they cannot be had."""
        if not self._reports_endpoints:
            return self._endpoints
        try:
            every = await in_a_thread(self._client.endpoints)
        except RemoteError as error:
            if "no method of the graph" not in error.text:  # an older daemon's answer
                raise DaemonError(str(error)) from error
            _log.info("publishers and subscriptions are not recorded: %s", error)
            self._reports_endpoints = False
            return self._endpoints
        if len(every) > MOST_ENDPOINTS:
            self.warn_once(
                f"publishers and subscriptions are not recorded: {len(every)} are more than "
                f"{MOST_ENDPOINTS}"
            )
            self._reports_endpoints = False
            return Counter()
        return Counter(each for each in every if not each.node.startswith(_OWN_ENDPOINTS))

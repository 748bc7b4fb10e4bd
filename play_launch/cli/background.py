"""Tasks beside a run: samples, topics, control, upkeep; and the output of libraries.

Their code is imported when the system has had the machine for its start.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import os
from functools import partial
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.cli.output import printable, stdout_is_kept
from play_launch.config.text import listed
from play_launch.control.event_words import names_of
from play_launch.process.lines import LineReader
from play_launch.process.time_slice import run_ahead, run_along
from play_launch.recording.forms import is_failure
from play_launch.recording.topic_recorder import SnapshotError
from play_launch.supervisor.view import is_up

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Coroutine, Iterator, Sequence

    from play_launch.cli.run import RunOptions, RunSink
    from play_launch.config.model import ReplayConfig
    from play_launch.control.registration import ControlSocket
    from play_launch.process.lines import Line
    from play_launch.recording.session import Session
    from play_launch.recording.topic_recorder import Snapshots
    from play_launch.recording.topic_recorder.supervision import TopicRecording
    from play_launch.runtime.publisher import Publisher
    from play_launch.runtime.signals import StopRequests
    from play_launch.runtime.system import System
    from play_launch.supervisor.events import RunEvent
    from play_launch.supervisor.expectations import Expectations, Measured
    from play_launch.supervisor.view import SystemView

_log = logging.getLogger(__name__)
_CONTROL_DELAY: Final = 0.2
"""Seconds from the start of the first processes until commands are answered."""
_GRAPH_DELAY: Final = 0.1
"""Seconds from the start until the graph is observed."""
_START_CHECK: Final = 0.1
"""Seconds between two looks whether the system is up: less of the start than one at each event."""
_LONGEST_WAIT: Final = 3.0
"""Seconds after which samples and topics are recorded although nodes are still being loaded."""
_LONGEST_START: Final = 30.0
"""Seconds after which it runs along even though nodes are still being loaded."""
_PRIORITY_INTERVAL: Final = 1.0
"""Seconds between two checks for the end of the start, and for further threads of our own."""
_NAMES: Final = 3
_FULL_PIPE: Final = 32 * 1024
"""Bytes of one read from which on the pipe may have been full: it holds 64 KiB, or half of that."""


class Background(Struct):
    """The parts of a run that its tasks use."""

    config: ReplayConfig
    session: Session
    sink: RunSink
    options: RunOptions
    control: ControlSocket
    publisher: Publisher
    stop: StopRequests
    snapshots: Snapshots
    expectations: Expectations
    system: asyncio.Future[System]
    operable: asyncio.Future[None]
    """Done when commands are answered, or never will be."""

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Run all tasks while the block runs; they end in reverse order."""
        tasks = {
            # They end last: the watchdog is notified while the others end.
            "the priority of the start": run_ahead_of(self.publisher, self.stop),
            "reports to systemd": self._report(),
            "samples of processes": self._sample(),
            "care for earlier recordings": self._maintain_recordings(),
            "the recording of ROS topics": self._record_topics(),
            "control by commands": self._serve_control(),
            "the record of the ROS graph": self._observe_graph(),
            "the page": self._show_page(),
            "a look for the same system elsewhere": self._look_for_twins(),
        }
        async with contextlib.AsyncExitStack() as stack:
            for what, work in tasks.items():
                await stack.enter_async_context(going_on(what, work))
            yield

    async def _report(self) -> None:
        if self.options.manager is None:
            return
        from play_launch.deploy.sd_notify import ServiceReport, seen_of  # noqa: PLC0415 - for services

        look = partial(seen_of, self.publisher, self.stop, self.system, self.operable)
        report = ServiceReport(self.options.manager, self.stop, look)
        self.publisher.add_sink(report)
        for each in (self.system, self.operable):
            each.add_done_callback(lambda _: report.changed.set())
        await report.run()

    async def _system_is_up(self) -> None:
        """Leave the start of the system to itself."""
        await asyncio.sleep(_START_CHECK)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_LONGEST_WAIT):
                while not is_up(self.publisher.view):  # noqa: ASYNC110
                    await asyncio.sleep(_START_CHECK)

    async def _look_for_twins(self) -> None:
        """Warn of other sessions with the same nodes: a service, or another terminal."""
        await self._system_is_up()
        from play_launch.control.sessions import twins  # noqa: PLC0415

        config = self.config
        names = [each.full_name for each in config.members]
        names += [node.key.name for each in config.containers for node in each.composable_nodes]
        named = [name for name in names if "[" not in name]
        domain = {**os.environ, **config.environment}.get("ROS_DOMAIN_ID") or "0"
        # A part is in the session of the coordinator as well.
        but = config.name if config.machine else ""
        for hello, shared in await asyncio.to_thread(twins, named, domain, but=but):
            _log.warning(
                "session %s (pid %d) runs %s as well: end one of the two",
                *(hello.name, hello.pid, listed(shared, _NAMES)),
            )

    async def _sample(self) -> None:
        period = self.config.record.sampling.period
        if not math.isfinite(period):
            return
        await self._system_is_up()
        from play_launch.process.sampling.sampling import sample  # noqa: PLC0415

        folder = self.session.folder
        publisher = self.publisher
        await sample(lambda: publisher.view, publisher.publish, period=period, folder=folder)

    async def _maintain_recordings(self) -> None:
        await self._system_is_up()
        from play_launch.container.ros import spawn_guard  # noqa: PLC0415
        from play_launch.postmortem.upkeep import look_after_sessions  # noqa: PLC0415

        keep, publisher = self.config.record.keep, self.publisher
        folder = self.session.folder.parent
        await look_after_sessions(folder, keep, lambda: publisher.view, spawn_guard())

    async def _record_topics(self) -> None:
        if not self.config.record.ros and not self.config.expect:
            return
        await self._system_is_up()
        from play_launch.recording.topic_recorder.supervision import TopicRecording  # noqa: PLC0415

        recording = TopicRecording(
            self.config, self.session.recorder, self._judge, self.expectations.forget
        )
        if self.config.record.before_crash is None:
            await recording.run()
            return
        watch = FailureWatch(recording, self.stop)
        self.publisher.add_sink(watch)
        with self.snapshots.taken_by(partial(recording.take, "snapshot")):
            async with asyncio.TaskGroup() as tasks:
                watching = tasks.create_task(watch.run())
                try:
                    await recording.run()
                finally:
                    watching.cancel()

    def _judge(self, measured: Measured) -> None:
        """Publish what follows for a topic; not when publishers end because all is stopped."""
        if not self.stop.requested.is_set():
            stamp_ns, up = self.publisher.stamp_ns(), is_up(self.publisher.view)
            for event in self.expectations.take(measured, stamp_ns, is_up=up):
                self.publisher.publish(event)

    async def _serve_control(self) -> None:
        operated = await self.system
        await asyncio.sleep(_CONTROL_DELAY)
        try:
            from play_launch.control.serve import serve_control  # noqa: PLC0415

            await serve_control(
                self.config,
                self.session,
                operated,
                control=self.control,
                publisher=self.publisher,
                feed=self.sink.feed,
                snapshots=self.snapshots,
                expectations=self.expectations,
                hide_secrets=self.sink.hide_secrets,
                adopt=self.sink.adopt,
                keeps_duration=self.options.keeps_duration,
                watched=self.options.watched,
                operable=self.operable,
            )
        finally:
            if not self.operable.done():
                self.operable.set_result(None)
            await asyncio.to_thread(self.control.close)

    async def _observe_graph(self) -> None:
        if self.config.graph_daemon:
            await asyncio.sleep(_GRAPH_DELAY)
            from play_launch.graph_daemon.observer import observe_graph  # noqa: PLC0415

            await observe_graph({**os.environ, **self.config.environment}, self.publisher.publish)

    async def _show_page(self) -> None:
        if self.config.web is not None:
            await asyncio.wait({self.operable})  # which is of others, too: not to be cancelled
            await self._system_is_up()
            from play_launch.cli.web import run_page  # noqa: PLC0415

            await run_page(self.config.web, self.session.folder, self.sink.show_output)


async def run_ahead_of(publisher: Publisher, stop: StopRequests) -> None:
    """Run before what starts, and before what ends, see docs/decisions/start.md.

    In between the nodes go on undisturbed: importing ROS for a parameter that is set takes half a
    second, and messages of others were 50 ms late while that ran ahead.
    """
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(_LONGEST_START):
            while run_ahead() and not stop.requested.is_set():
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(stop.requested.wait(), _PRIORITY_INTERVAL)
                if is_up(publisher.view):
                    break
    run_along()
    await stop.requested.wait()
    run_ahead()


@contextlib.asynccontextmanager
async def going_on(what: str, work: Coroutine[None, None, None]) -> AsyncIterator[None]:
    """Run a coroutine while the block runs, which continues without ``what`` if that fails."""
    task = asyncio.create_task(_failure_logged(what, work))
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        work.close()  # it has not begun where the block has ended at once


async def _failure_logged(what: str, work: Coroutine[None, None, None]) -> None:
    try:
        await work
    except Exception:  # noqa: BLE001 - it is logged, and the system continues
        _log.exception("the system continues without %s", what)


@contextlib.contextmanager
def library_output_logged() -> Iterator[None]:
    """Log each line that libraries write to descriptor 1, within a running event loop.

    On a terminal it would appear across the live view, and would be missing in the recording.
    A write to the full pipe is lost: the writing thread may hold the interpreter's lock, and would
    wait for this process forever. The log has a warning then.
    """
    if not stdout_is_kept():
        yield
        return
    before = os.dup(1)
    read, write = os.pipe()
    os.set_blocking(write, False)
    reader = LineReader(read, _log_lines)
    os.dup2(write, 1)
    os.close(write)
    try:
        yield
    finally:
        os.dup2(before, 1)
        os.close(before)
        reader.close()


def _log_lines(lines: Sequence[Line]) -> None:
    for line in lines:
        if text := printable(line.text).strip():
            cut = " [cut]" if line.truncated else ""
            _log.warning("stdout of a library: %s%s", text, cut)
    if sum(len(line.text) for line in lines) > _FULL_PIPE:
        _log.warning("stdout of libraries: too many; lines may be missing here")


class FailureWatch:
    """Writes the pre-crash buffer when something fails, but for processes that are stopped."""

    def __init__(self, recording: TopicRecording, stop: StopRequests) -> None:
        self._recording = recording
        self._stop = stop
        self._failed = asyncio.Event()
        self._reason = ""

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:  # noqa: ARG002 - a sink
        names = names_of(event)
        is_seen = self._stop.requested.is_set() or self._failed.is_set()
        if names and not is_seen and is_failure(event):
            self._reason = f"{names[0]} failed"
            self._failed.set()

    async def run(self) -> None:
        while True:
            await self._failed.wait()
            self._failed.clear()
            with contextlib.suppress(SnapshotError):  # it was reported why nothing is recorded
                await self._recording.take(self._reason)

"""Runs a system on several machines: recording, display and signals around the coordinator."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
import logging
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from play_launch import ExitCode
from play_launch.cli.background import going_on
from play_launch.cli.check import describe
from play_launch.cli.events import text_of
from play_launch.cli.output import report, say_live
from play_launch.cli.show.display import Screen, Style, encode
from play_launch.cli.show.event_lines import has_line
from play_launch.cli.systemd_unit import program
from play_launch.config.machines import MachineConfig, used_machines
from play_launch.control.event_words import event_object, words_of
from play_launch.control.registration import ControlSocket
from play_launch.control.serve import hello_of
from play_launch.control.server import serving
from play_launch.deploy.machines.coordinator import Coordinator
from play_launch.deploy.machines.hosts import HostError
from play_launch.recording.folder import MACHINES, age_in
from play_launch.recording.log_handler import log_published
from play_launch.recording.session import announce, open_session
from play_launch.runtime.signals import RunSignals, StopRequests

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from play_launch.config.model import ReplayConfig
    from play_launch.deploy.notification import ServiceManager
    from play_launch.recording.session import Session, SessionDescription
    from play_launch.supervisor.events import LogRecord, OutputLine

_log = logging.getLogger(__name__)


class _Lines(Style[dict[str, Any]]):
    """Events of all machines, each a line."""

    def __init__(self, *, as_json: bool, quiet: bool) -> None:
        self._as_json = as_json
        self._hidden = {"output"} if quiet else set()

    def show(self, batch: Sequence[dict[str, Any]], missed: int) -> None:
        if self._as_json:
            lines = [encode(event) for event in batch]
            lines += [encode({"event": "missed", "lines": missed})] if missed else []
        else:
            told = (event for event in batch if event["event"] not in self._hidden)
            lines = [_text(event) for event in told if has_line(event)]
            text = f"{missed} lines are missing here; the recordings have them"
            lines += [text] if missed else []
        if lines:
            sys.stdout.write("".join(f"{line}\n" for line in lines))
            sys.stdout.flush()


def _text(event: dict[str, Any]) -> str:
    machine, source = event["machine"], event["source"]
    return text_of({**event, "source": f"{machine} {source}" if machine else source})


class MachinesScreen(Screen[dict[str, Any]]):
    """Shows the events of all machines."""

    def show(self, event: dict[str, Any]) -> None:
        self.put(event, is_output=event["event"] == "output")

    def show_output(self, line: OutputLine) -> None:
        self.show({"machine": "", **event_object(line), **words_of(line)._asdict()})


def run_machines(
    config: ReplayConfig,
    description: SessionDescription,
    *,
    arguments: Sequence[str],
    log_folder: Path | None,
    as_json: bool,
    quiet: bool,
    detach: bool,
    manager: ServiceManager | None = None,
) -> int:
    """Bring the system up on its machines, keep it until its end, and return the exit code."""
    screen = MachinesScreen(_Lines(as_json=as_json, quiet=quiet))
    with RunSignals() as signals, contextlib.ExitStack() as opened:
        opened.callback(screen.leave)  # the last of all
        session = open_session(
            description, log_folder=log_folder or config.log_dir, record=config.record
        )
        control = ControlSocket(str(session.folder))
        opened.callback(session.recorder.close)
        opened.callback(control.close)
        if as_json:
            values = {"id": session.id, "name": config.name, "folder": str(session.folder)}
            say_live(encode({"machine": "", "event": "session", **values}))
        else:
            names = ", ".join(used_machines(config))
            recorded = f"recording to {session.folder}"
            say_live(f"{config.name}: {describe(config)} on {names}, {recorded}")
        opened.callback(screen.close)
        coordinator = Coordinator(config, arguments, str(program()), screen.show, session.recorder)
        work = _until_the_end(
            coordinator,
            session,
            control,
            signals,
            screen.show_output,
            detach=detach,
            manager=manager,
        )
        try:
            return asyncio.run(work)
        except HostError as error:
            report(f"nothing was started\n{error}")
            return ExitCode.NODE_FAILED


async def _until_the_end(
    coordinator: Coordinator,
    session: Session,
    control: ControlSocket,
    signals: RunSignals,
    show: Callable[[OutputLine], None],
    *,
    detach: bool,
    manager: ServiceManager | None,
) -> int:
    gc.enable()  # see `entry`
    loop = asyncio.get_running_loop()
    stop = StopRequests()

    def publish_log(record: LogRecord) -> None:
        try:
            loop.call_soon_threadsafe(coordinator.publish, record)
        except RuntimeError:  # it is closed
            session.recorder.publish(record)

    config = coordinator.config
    hello = hello_of(config, session, control)
    machines = Path(control.folder) / MACHINES
    left = await asyncio.to_thread(_left_running, session.folder, config.name)

    def note_recordings() -> None:
        half = machines.with_name(f"{MACHINES}.new")
        try:
            half.write_text(json.dumps(coordinator.recordings(), indent=1))
            half.replace(machines)
        except OSError as error:
            _log.warning("the recordings of the machines cannot be listed: %s", error.strerror)

    coordinator.on_change = note_recordings
    reports: contextlib.AbstractAsyncContextManager[None] = contextlib.nullcontext()
    if manager is not None:
        from play_launch.deploy.sd_notify import ServiceReport  # noqa: PLC0415 - for services only

        report = ServiceReport(manager, stop, coordinator.seen)

        def on_change() -> None:
            note_recordings()
            report.changed.set()

        coordinator.on_change = on_change
        reports = going_on("reports to systemd", report.run())
    page: contextlib.AbstractAsyncContextManager[None] = contextlib.nullcontext()
    if config.web is not None:
        from play_launch.cli.web import run_page  # noqa: PLC0415

        page = going_on("the page", run_page(config.web, session.folder, show))
    with log_published(publish_log), signals.delivered_to(stop.request):
        problem: HostError | None = None
        code: int = ExitCode.OK
        async with reports, serving(control, hello, coordinator.requests), page:
            try:
                code = await coordinator.run(stop.requested, stop.hurry, left=left, detach=detach)
            except HostError as error:
                problem = error  # not within the group of tasks, which would wrap it
        if problem is not None:
            raise problem
        note_recordings()
        announce(session.folder)  # that of the local part was announced since
        await asyncio.sleep(0)  # the last records of the log
    return code if stop.signum is None or code else ExitCode.SIGNAL_BASE + stop.signum


def _left_running(folder: Path, system: str) -> list[MachineConfig]:
    """Find the machines on which something may run that an earlier session has left there.

    That is the latest session of the system beside this one: one that was detached or killed.
    """
    from play_launch.postmortem.archive import session_entry  # noqa: PLC0415 - slow

    names = sorted(
        (each.parent.name for each in folder.parent.glob(f"*/{MACHINES}")),
        key=age_in(folder.parent),
        reverse=True,
    )
    for name in names:
        try:
            recorded = json.loads((folder.parent / name / MACHINES).read_text())
            if name == folder.name or {each["system"] for each in recorded} != {system}:
                continue
            if (entry := session_entry(folder.parent / name)) is not None and entry.is_running:
                return []  # its coordinator lives
            return [
                MachineConfig(name=each["machine"], local=each["local"], ssh=each["ssh"])
                for each in recorded
                if each["may_run"]
            ]
        except (OSError, ValueError, LookupError, TypeError):
            continue  # of an older version, or changed by hand
    return []

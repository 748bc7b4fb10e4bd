"""Serves the control socket of the running session, and applies other configurations."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from play_launch.config.load import load_config, parse_config
from play_launch.config.machines import part_of
from play_launch.config.problems import ConfigError
from play_launch.config.substitutions import Inputs, parse_arguments, share_folder
from play_launch.container.cdr.structure import text_bytes
from play_launch.control.actions import ActionLog
from play_launch.control.client import own_command
from play_launch.control.messages import Caller, SessionHello
from play_launch.control.operations import Operations
from play_launch.control.protocol import Code, OperationError
from play_launch.control.server import serving
from play_launch.process.descendants import in_a_thread
from play_launch.recording.environment import OURSELVES, package_version
from play_launch.recording.resolved_form import resolved_form
from play_launch.recording.topics import APPLIED, RESOLVED
from play_launch.runtime.applying import STEP_LIMIT
from play_launch.supervisor.plan import Plan, Result

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.config.model import ReplayConfig
    from play_launch.control.config_watch import Watched
    from play_launch.control.feed import Feed
    from play_launch.control.messages import ChangeRequest
    from play_launch.control.registration import ControlSocket
    from play_launch.recording.recorder import Recorder
    from play_launch.recording.session import Session
    from play_launch.recording.topic_recorder import Snapshots
    from play_launch.runtime.applying import Applying
    from play_launch.runtime.publisher import Publisher
    from play_launch.runtime.system import System
    from play_launch.supervisor.expectations import Expectations
    from play_launch.supervisor.plan import Applied, StepOutcome

_log = logging.getLogger(__name__)


def hello_of(config: ReplayConfig, session: Session, control: ControlSocket) -> SessionHello:
    """Make the first message to each client; reads the installed version from a file."""
    return SessionHello(
        version=package_version(OURSELVES),
        pid=os.getpid(),
        name=config.name,
        session=session.id,
        folder=control.folder,
        started_ns=time.time_ns(),
        source=str(config.source.absolute()),
        machine=config.machine,
    )


async def serve_control(
    config: ReplayConfig,
    session: Session,
    system: System,
    *,
    control: ControlSocket,
    publisher: Publisher,
    feed: Feed,
    snapshots: Snapshots,
    expectations: Expectations,
    hide_secrets: Callable[[ReplayConfig], None],
    adopt: Callable[[ReplayConfig], None],
    keeps_duration: bool,
    watched: Watched | None,
    operable: asyncio.Future[None],
) -> None:
    """Serve clients until this is cancelled; the run continues whatever fails here.

    ``hide_secrets`` is called with each configuration before it is applied, ``adopt`` with the
    configuration of the system after each change; ``keeps_duration`` is whether the duration comes
    from the command line; ``watched`` is applied when it changes; ``operable`` is set as soon as
    requests are served.
    """
    changes = Changes(
        started_with=config,
        system=system,
        recorder=session.recorder,
        log=ActionLog(publisher),
        hide_secrets=hide_secrets,
        adopt=adopt,
        keeps_duration=keeps_duration,
    )
    operations = Operations(
        system,
        publisher,
        feed,
        snapshots=snapshots,
        expectations=expectations,
        environment={**os.environ, **config.environment},
        recorder=session.recorder,
        log=changes.log,
        apply=changes.apply,
    )
    hello = await asyncio.to_thread(hello_of, config, session, control)
    try:
        async with serving(control, hello, operations):
            operable.set_result(None)
            if watched is not None:
                await changes.watch(watched)
            await asyncio.Event().wait()
    except Exception:  # noqa: BLE001 - it is logged, and the run goes on
        _log.exception("the session can no longer be controlled")


class Changes(Struct, kw_only=True, eq=False):
    """Compares a running system with other configurations, and applies them."""

    started_with: ReplayConfig
    system: System
    recorder: Recorder
    log: ActionLog
    hide_secrets: Callable[[ReplayConfig], None]
    adopt: Callable[[ReplayConfig], None]
    keeps_duration: bool
    number: int = 0
    """Of the configurations that were applied."""
    task: asyncio.Task[Applied] | None = None
    source: str = ""
    """File of the configuration that is being applied, or was applied last."""

    async def apply(self, request: ChangeRequest, caller: Caller) -> object:
        """Send the plan, and apply it unless it is a dry run; raises OperationError."""
        target = self._with_command_line(await read_change(request, self.started_with.machine))
        if request.dry_run:
            applying = self.source if self._is_busy else None
            return {"plan": self._applying.plan(target), "applying": applying}
        ended: asyncio.Queue[Plan | StepOutcome | None] = asyncio.Queue()
        task = self._begin(
            target,
            caller,
            limit=request.timeout,
            rolls_back=request.rollback_on_failure,
            report=ended.put_nowait,
        )
        task.add_done_callback(lambda _: ended.put_nowait(None))
        while (each := await ended.get()) is not None:
            await caller.send("plan" if isinstance(each, Plan) else "step", each)
        return {"applied": task.result()}

    async def watch(self, watched: Watched) -> None:
        """Apply the configuration of the command line whenever it changes."""
        from play_launch.control.config_watch import watch  # noqa: PLC0415 - only for this

        caller = Caller(os.getpid(), os.getuid(), own_command())

        async def apply(target: ReplayConfig) -> None:
            target = self._with_command_line(target)
            while self.task is not None and self._is_busy:
                await asyncio.wait({self.task})
            if not self._applying.plan(target).to_do:
                return
            try:
                await asyncio.wait({self._begin(target, caller)})
            except OperationError as error:
                text = "%s is not applied: %s; it is applied at its next change"
                _log.warning(text, target.source, error)

        try:
            await watch(watched, self.started_with, apply)
        except Exception:  # noqa: BLE001 - the run goes on
            _log.exception("%s is no longer watched", watched.path)

    def _with_command_line(self, target: ReplayConfig) -> ReplayConfig:
        """Put into ``target`` what the command line of the session said."""
        began = self.started_with
        if self.keeps_duration:
            target = replace(target, duration=began.duration)
        folders = began.log_dir, target.log_dir
        if began.machine:
            if began.machine not in target.machines:
                text = f"it has no machine {began.machine}, whose part this session runs"
                raise OperationError(Code.BAD_ARGUMENTS, text)
            target = part_of(target, began.machine)
        if None not in folders and len({str(each and each.absolute()) for each in folders}) == 1:
            target = replace(target, log_dir=began.log_dir)  # one of them is a relative path
        return target

    @property
    def _is_busy(self) -> bool:
        return self.task is not None and not self.task.done()

    @property
    def _applying(self) -> Applying:
        return self.system.applying

    def _begin(
        self,
        target: ReplayConfig,
        caller: Caller,
        *,
        limit: float = STEP_LIMIT,
        rolls_back: bool = False,
        report: Callable[[Plan | StepOutcome], None] = lambda _: None,
    ) -> asyncio.Task[Applied]:
        if self.system.is_stopping:
            raise OperationError(Code.REFUSED, "the session is being stopped")
        if self._is_busy:
            raise OperationError(
                Code.REFUSED, "another configuration is being applied; try again when it is done"
            )
        self.source = str(target.source)

        async def carry_out() -> Applied:
            plan = self._applying.plan(target)
            report(plan)
            names = [step.name for step in plan.steps if step.name]
            async with self.log.recorded("apply", names, caller, str(target.source)):
                if plan.to_do:
                    self.number += 1
                    self.hide_secrets(target)
                    _attach(self.recorder, target, self.number)
                try:
                    applied = await self._applying.apply(
                        target, limit=limit, rolls_back=rolls_back, on_outcome=report
                    )
                finally:
                    self.adopt(self._applying.config)
                if not applied.succeeded:
                    raise OperationError(
                        Code.FAILED, _failures(applied), applied=msgspec.to_builtins(applied)
                    )
                return applied

        # It is carried out to its end also when the client disconnects.
        self.task = asyncio.create_task(carry_out())
        # Its failure is published; that the client disconnected first is not worth a log.
        self.task.add_done_callback(lambda task: task.cancelled() or task.exception())
        return self.task


async def read_change(request: ChangeRequest, machine: str = "") -> ReplayConfig:
    """Read what is to be applied on a machine; raises OperationError."""
    path = Path(request.path)
    environment = os.environ if request.environment is None else request.environment
    try:
        inputs = Inputs(
            arguments=parse_arguments(request.arguments),
            environ=dict(environment),
            find_share=partial(share_folder, environ=environment),
        )
        if request.text is None:
            return await in_a_thread(partial(load_config, path, inputs, machine=machine))
        read = partial(parse_config, request.text.encode(), path, inputs=inputs, machine=machine)
        return await in_a_thread(read)
    except ConfigError as error:
        text = f"{request.path} cannot be used, nothing was changed\n{error.for_people()}"
        raise OperationError(Code.BAD_ARGUMENTS, text) from None
    except ValueError as error:
        raise OperationError(Code.BAD_ARGUMENTS, str(error)) from None


def _failures(applied: Applied) -> str:
    """Describe what failed, how many steps are done, and whether they were rolled back."""
    failed = [each for each in applied.outcomes if each.result is Result.FAILED]
    reasons = [f"{each.step.name or each.step.kind}: {each.reason}" for each in failed]
    if not reasons:
        reasons = sorted({each.reason for each in applied.outcomes if each.reason})
    done = sum(each.result is Result.DONE for each in applied.outcomes)
    text = f"{'; '.join(reasons)} ({done} of {len(applied.outcomes)} steps are done"
    if applied.rollback is None:
        return f"{text})"
    is_back = all(each.result is Result.DONE for each in applied.rollback)
    return f"{text}; {'rolled back' if is_back else 'the rollback failed as well'})"


def _attach(recorder: Recorder, config: ReplayConfig, number: int) -> None:
    """Attach it as ``applied/<number>/...``: as it was given, its files, and resolved."""
    place = f"{APPLIED}{number}"
    yaml = "application/yaml"
    recorder.attach(f"{place}/config{config.source.suffix or '.yaml'}", yaml, config.text)
    for kind, files in (
        ("includes", config.included_files),
        ("parameters", config.parameter_files),
    ):
        for index, file in enumerate(files):
            recorder.attach(f"{place}/{kind}/{index}-{file.path.name}", yaml, file.text)
    resolved = json.dumps(resolved_form(config), ensure_ascii=False)
    recorder.attach(f"{place}/{RESOLVED}", "application/json", text_bytes(resolved))

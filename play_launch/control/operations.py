"""Operations of the control socket on a running system."""

from __future__ import annotations

import asyncio
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
from msgspec import Struct

from play_launch.config.load import load_config, parse_config
from play_launch.config.problems import ConfigError
from play_launch.config.substitutions import Inputs, parse_arguments, share_folder
from play_launch.container.cdr.layout import CdrError
from play_launch.container.cdr.messages import NODE_PARAMETERS
from play_launch.control.actions import ActionLog, Actions, OperatorAction
from play_launch.control.feed import KINDS, Follower, selection_of
from play_launch.control.messages import (
    ActionRequest,
    ChangeRequest,
    EventsRequest,
    LastLine,
    ParameterNames,
    RestartRecord,
    Selected,
    SignalRequest,
    SnapshotResult,
    UnitRow,
    UnitStatus,
    WaitRequest,
    read_arguments,
)
from play_launch.control.protocol import ROS_VARIABLES, Code, OperationError
from play_launch.control.units import (
    chosen,
    full_name,
    key_of,
    members_of,
    nodes_of,
    rows_of,
    status_of,
    with_groups,
)
from play_launch.recording.topic_recorder import SnapshotError
from play_launch.runtime.applying import STEP_LIMIT
from play_launch.supervisor.events import (
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
    ProcessSample,
)
from play_launch.supervisor.plan import Applied, Plan, Result, StepOutcome

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence

    from play_launch.config.model import ReplayConfig
    from play_launch.control.feed import Feed
    from play_launch.control.messages import Caller, Request
    from play_launch.control.units import Samples, Target
    from play_launch.recording.topic_recorder import Snapshots
    from play_launch.runtime.applying import Applying
    from play_launch.runtime.publisher import Publisher
    from play_launch.runtime.system import System
    from play_launch.supervisor.events import RunEvent
    from play_launch.supervisor.view import SystemView

_SHOWN: int = 10
"""Restarts and lines of output in a status."""
_RESTARTS = frozenset(
    {ProcessEventKind.EXITED, ProcessEventKind.RESTARTING, ProcessEventKind.GAVE_UP}
)
_CRASHES = frozenset({NodeState.CRASHED, NodeState.LOST, NodeState.LOAD_FAILED, NodeState.GAVE_UP})


class Nothing(Struct, frozen=True):
    """Arguments of an operation that has none."""


class Operations:
    """Operations on one session. Belongs to the thread of the event loop."""

    def __init__(
        self,
        system: System,
        publisher: Publisher,
        feed: Feed,
        *,
        snapshots: Snapshots,
        environment: Mapping[str, str],
        parameters_of: Callable[[str], bytes | None],
        changes: Changes,
    ) -> None:
        """Operate a system.

        Args:
            system: The running system.
            publisher: Publishes its events.
            feed: Has its recent events.
            snapshots: Write the seconds before a crash.
            environment: That of its processes.
            parameters_of: Returns the latest ``play_launch_msgs/NodeParameters`` of a node.
            changes: Apply other configurations.
        """
        self._environment = {
            name: value for name, value in environment.items() if name.startswith(ROS_VARIABLES)
        }
        self._system = system
        self._publisher = publisher
        self._feed = feed
        self._snapshots = snapshots
        self._parameters_of = parameters_of
        self._samples: Samples = {}
        self._log = changes.log
        actions = Actions(system, publisher, feed, self._log)
        self._table: dict[str, tuple[type[Struct], Callable[[Any, Caller], Awaitable[object]]]] = {
            "ps": (Selected, self._ps),
            "status": (Selected, self._status),
            "events": (EventsRequest, self._events),
            "parameters": (Selected, self._parameters),
            "environment": (Nothing, self._give_environment),
            "wait": (WaitRequest, actions.wait),
            **{
                action.value: (
                    SignalRequest if action is OperatorAction.SIGNAL else ActionRequest,
                    partial(actions.act, action),
                )
                for action in OperatorAction
            },
            "snapshot": (Nothing, self._snapshot),
            "apply": (ChangeRequest, changes.apply),
        }
        publisher.add_sink(self)

    async def __call__(self, request: Request, caller: Caller) -> object:
        """Carry a request out; raises OperationError."""
        if request.op not in self._table:
            known = ", ".join(sorted(self._table))
            text = f"unknown operation {request.op!r:.80}; there are: {known}"
            raise OperationError(Code.UNKNOWN_OPERATION, text)
        kind, operation = self._table[request.op]
        return await operation(read_arguments(request.arguments, kind), caller)

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:  # noqa: ARG002 - a sink
        if isinstance(event, ProcessSample):
            self._samples[event.kind, event.key] = event

    async def _ps(self, request: Selected, _caller: Caller) -> list[UnitRow]:
        view = self._publisher.view
        rows = rows_of(view, self._system.processes, self._samples)
        if request.names:
            found = {str(target) for target in self._chosen(request.names)}
            rows = [row for row in rows if key_of(row) in found]
        return await asyncio.to_thread(with_groups, rows)

    async def _status(self, request: Selected, caller: Caller) -> list[UnitStatus]:
        rows = await self._ps(request, caller)
        targets = {str(target): target for target in self._chosen([key_of(row) for row in rows])}
        recent = self._feed.recent()
        found = [
            status_of(
                row,
                self._system.world,
                self._publisher.view,
                tuple(_restarts_of(targets[key_of(row)], recent))[-_SHOWN:],
                tuple(_output_of(targets[key_of(row)], recent))[-_SHOWN:],
            )
            for row in rows
            if key_of(row) in targets
        ]
        return [each for each in found if each is not None]

    async def _events(self, request: EventsRequest, caller: Caller) -> object:
        if wrong := set(request.kinds) - KINDS:
            listed = ", ".join(sorted(KINDS))
            text = f"kinds: there are no events {min(wrong)!r:.80}; there are: {listed}"
            raise OperationError(Code.BAD_ARGUMENTS, text)
        targets = self._chosen(request.names) if request.names else None
        follower = Follower(selection_of(request.kinds, targets))
        past = [] if request.only_new else self._feed.recent()
        with self._feed.followed_by(follower.append):
            await follower.send_all(past, caller.send)
            if request.follow:
                await follower.follow(caller.send)
        return {"events": "sent"}

    async def _parameters(self, request: Selected, _caller: Caller) -> list[ParameterNames]:
        """List names of parameters, configured or recorded."""
        configured = dict(_configured(self._system.config))
        found = []
        for target in self._chosen(request.names):
            if target in configured:
                recorded = _names_in(self._parameters_of(full_name(target)))
                names = sorted({*configured[target], *recorded})
                found.append(ParameterNames(full_name(target), names))
        return found

    async def _give_environment(self, _request: Nothing, _caller: Caller) -> dict[str, str]:
        return self._environment

    async def _snapshot(self, _request: Nothing, caller: Caller) -> SnapshotResult:
        async with self._log.recorded("snapshot", (), caller):
            try:
                taken = await self._snapshots.take()
            except SnapshotError as error:
                raise OperationError(Code.REFUSED, str(error)) from None
        return SnapshotResult(messages=taken.messages, bytes=taken.bytes, seconds=taken.seconds)

    def _chosen(self, wanted: Sequence[str]) -> list[Target]:
        view = self._publisher.view
        return chosen(wanted, [*members_of(view, self._system.processes), *nodes_of(view)])


class Changes:
    """Compares a running system with other configurations, and applies them."""

    def __init__(
        self,
        system: System,
        publisher: Publisher,
        *,
        with_command_line: Callable[[ReplayConfig], ReplayConfig],
        on_begin: Callable[[ReplayConfig, int], None],
        on_end: Callable[[ReplayConfig], None],
    ) -> None:
        """Change a system.

        Args:
            system: The running system.
            publisher: Publishes its events.
            with_command_line: Applies the options of the session's command line.
            on_begin: Called before a configuration is applied, with its number.
            on_end: Called afterwards with the resulting configuration.
        """
        self.log = ActionLog(publisher)
        """Numbers and publishes the actions of the session."""
        self._system = system
        self._with_command_line = with_command_line
        self._on_begin = on_begin
        self._on_end = on_end
        self._number = 0
        self._task: asyncio.Task[Applied] | None = None
        self._source = ""
        """File of the configuration that is being applied, or was applied last."""

    async def apply(self, request: ChangeRequest, caller: Caller) -> object:
        """Send the plan, and apply it unless it is a dry run; raises OperationError."""
        try:
            target = await asyncio.to_thread(_read, request)
        except ConfigError as error:
            text = f"{request.path} cannot be used, nothing was changed\n{error.for_people()}"
            raise OperationError(Code.BAD_ARGUMENTS, text) from None
        except ValueError as error:
            raise OperationError(Code.BAD_ARGUMENTS, str(error)) from None
        target = self._with_command_line(target)
        if request.dry_run:
            applying = self._source if self._is_busy else None
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

    async def apply_own(self, target: ReplayConfig, caller: Caller) -> None:
        """Apply a configuration that this process has read; the result is published.

        Raises:
            OperationError: When it cannot begin.
        """
        target = self._with_command_line(target)
        while self._task is not None and self._is_busy:
            await asyncio.wait({self._task})
        if self._applying.plan(target).to_do:
            await asyncio.wait({self._begin(target, caller)})

    @property
    def _is_busy(self) -> bool:
        return self._task is not None and not self._task.done()

    @property
    def _applying(self) -> Applying:
        return self._system.applying

    def _begin(
        self,
        target: ReplayConfig,
        caller: Caller,
        *,
        limit: float = STEP_LIMIT,
        rolls_back: bool = False,
        report: Callable[[Plan | StepOutcome], None] = lambda _: None,
    ) -> asyncio.Task[Applied]:
        if self._system.is_stopping:
            raise OperationError(Code.REFUSED, "the session is being stopped")
        if self._is_busy:
            raise OperationError(
                Code.REFUSED, "another configuration is being applied; try again when it is done"
            )
        self._source = str(target.source)

        async def carry_out() -> Applied:
            plan = self._applying.plan(target)
            report(plan)
            names = [step.name for step in plan.steps if step.name]
            async with self.log.recorded("apply", names, caller, str(target.source)):
                if plan.to_do:
                    self._number += 1
                    self._on_begin(target, self._number)
                try:
                    applied = await self._applying.apply(
                        target, limit=limit, rolls_back=rolls_back, on_outcome=report
                    )
                finally:
                    self._on_end(self._applying.config)
                if not applied.succeeded:
                    raise OperationError(
                        Code.FAILED, _failures(applied), applied=msgspec.to_builtins(applied)
                    )
                return applied

        # It is carried out to its end also when the client disconnects.
        self._task = asyncio.create_task(carry_out())
        # Its failure is published; that the client disconnected first is not worth a log.
        self._task.add_done_callback(lambda task: task.cancelled() or task.exception())
        return self._task


def _read(request: ChangeRequest) -> ReplayConfig:
    """Read a configuration; raises ConfigError, ValueError."""
    inputs = Inputs(
        arguments=parse_arguments(request.arguments),
        environ=request.environment,
        find_share=partial(share_folder, environ=request.environment),
    )
    path = Path(request.path)
    if request.text is None:
        return load_config(path, inputs)
    return parse_config(request.text.encode(), path, inputs=inputs)


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


def _restarts_of(target: Target, events: Sequence[RunEvent]) -> Iterator[RestartRecord]:
    for event in events:
        match event:
            case ProcessEvent() if event.name == target and event.kind in _RESTARTS:
                cause = event.message or event.kind.name.lower().replace("_", " ")
                yield RestartRecord(event.stamp_ns, cause)
            case NodeStateChanged() if event.key == target and event.state in _CRASHES:
                yield RestartRecord(
                    event.stamp_ns, f"{event.state}: {event.reason}".removesuffix(": ")
                )


def _output_of(target: Target, events: Sequence[RunEvent]) -> Iterator[LastLine]:
    selection = selection_of({"output"}, [target])
    for event in events:
        if isinstance(event, OutputLine) and selection.wants(event):
            yield LastLine(event.stamp_ns, event.stream.value, event.text)


def _configured(config: ReplayConfig) -> Iterator[tuple[Target, list[str]]]:
    for container in config.containers:
        for node in container.composable_nodes:
            yield node.key, [each.name for each in node.parameters]
    for process in config.nodes:
        yield process.full_name, [each.name for each in process.parameters]


def _names_in(message: bytes | None) -> list[str]:
    if message is None:
        return []
    try:
        return [str(each["name"]) for each in NODE_PARAMETERS.read(message)["parameters"]]
    except CdrError:
        return []

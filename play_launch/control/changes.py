"""Compares a running system with another configuration, and makes it that one."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import msgspec

from play_launch.config.bundle import unbundled
from play_launch.config.problems import ConfigError
from play_launch.control.protocol import Code, ControlError, flag_argument, seconds_argument
from play_launch.runtime.applying import STEP_LIMIT
from play_launch.supervisor.steps import Result

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.config.model import ReplayConfig
    from play_launch.control.action_record import ActionRecords
    from play_launch.control.connection import Stream
    from play_launch.control.place import Peer
    from play_launch.runtime.applying import Applying
    from play_launch.runtime.system import System
    from play_launch.supervisor.steps import Applied, Plan, StepOutcome


class Changes:
    """What can be changed of one session. It belongs to the thread of the event loop."""

    def __init__(
        self,
        system: System,
        records: ActionRecords,
        *,
        as_started: Callable[[ReplayConfig], ReplayConfig],
        on_begin: Callable[[ReplayConfig, int], None],
        on_end: Callable[[ReplayConfig], None],
    ) -> None:
        """Change a system.

        Args:
            system: What is changed.
            records: Publish who asked for it.
            as_started: Puts into a configuration what the command line of the session said.
            on_begin: Hears of each configuration that is going to be applied, with its number.
            on_end: Hears of what the system is configured as afterwards.
        """
        self._system = system
        self._records = records
        self._as_started = as_started
        self._on_begin = on_begin
        self._on_end = on_end
        self._number = 0
        self._under_way: asyncio.Task[Applied] | None = None
        self._source = ""
        """The file that is being applied, or was the last one."""

    async def diff(self, arguments: dict[str, Any], _peer: Peer, _stream: Stream) -> object:
        """Say what differs, and what is being applied; raises ControlError."""
        target = await self._target(arguments)
        applying = self._source if self._is_busy else None
        return {"plan": _plain(self._applying.plan(target)), "applying": applying}

    async def apply(self, arguments: dict[str, Any], peer: Peer, stream: Stream) -> object:
        """Change what differs; raises ControlError."""
        limit = seconds_argument(arguments, "timeout", STEP_LIMIT)
        rolls_back = flag_argument(arguments, "rollback_on_failure")
        target = await self._target(arguments)
        over: asyncio.Queue[StepOutcome | None] = asyncio.Queue()
        task = self._begin(
            target, peer, limit=limit, rolls_back=rolls_back, on_outcome=over.put_nowait
        )
        task.add_done_callback(lambda _: over.put_nowait(None))
        while (outcome := await over.get()) is not None:
            await stream.send("step", _plain(outcome))
        applied = task.result()
        result = {"applied": _plain(applied)}
        if not applied.succeeded:
            raise ControlError(Code.FAILED, _failures(applied), **result)
        return result

    async def apply_own(self, target: ReplayConfig, peer: Peer) -> None:
        """Change what differs from a configuration that was read here; events say what came of it.

        Raises:
            ControlError: When it cannot begin.
        """
        target = self._as_started(target)
        while self._under_way is not None and self._is_busy:
            await asyncio.wait({self._under_way})
        if self._applying.plan(target).to_do:
            await asyncio.wait({self._begin(target, peer)})

    @property
    def _is_busy(self) -> bool:
        return self._under_way is not None and not self._under_way.done()

    def _begin(
        self,
        target: ReplayConfig,
        peer: Peer,
        *,
        limit: float = STEP_LIMIT,
        rolls_back: bool = False,
        on_outcome: Callable[[StepOutcome], None] = lambda _: None,
    ) -> asyncio.Task[Applied]:
        if self._system.is_stopping:
            raise ControlError(Code.REFUSED, "the session is being stopped")
        if self._is_busy:
            raise ControlError(
                Code.REFUSED, "another configuration is being applied; wait for its end"
            )
        self._source = str(target.source)
        # It is carried out to its end also when whoever asked for it leaves.
        self._under_way = asyncio.create_task(
            self._carry_out(target, peer, limit, rolls_back=rolls_back, on_outcome=on_outcome)
        )
        return self._under_way

    async def _carry_out(
        self,
        target: ReplayConfig,
        peer: Peer,
        limit: float,
        *,
        rolls_back: bool,
        on_outcome: Callable[[StepOutcome], None],
    ) -> Applied:
        found = self._applying.plan(target)
        async with self._records.recorded(
            "apply", _names(found), peer, str(target.source)
        ) as record:
            if found.to_do:
                self._number += 1
                self._on_begin(target, self._number)
            try:
                applied = await self._applying.apply(
                    target, limit=limit, rolls_back=rolls_back, on_outcome=on_outcome
                )
            finally:
                self._on_end(self._applying.config)
            record.failure = _failures(applied)
        return applied

    async def _target(self, arguments: dict[str, Any]) -> ReplayConfig:
        try:
            target = await asyncio.to_thread(unbundled, arguments.get("config"))
        except ConfigError as error:
            raise ControlError(Code.BAD_ARGUMENTS, error.for_people()) from None
        except ValueError as error:
            raise ControlError(Code.BAD_ARGUMENTS, f"config: {error}") from None
        return self._as_started(target)

    @property
    def _applying(self) -> Applying:
        return self._system.applying


def _names(plan: Plan) -> list[str]:
    return [step.name for step in plan.steps if step.name]


def _failures(applied: Applied) -> str:
    """Say what failed, how far it came, and what became of that."""
    failed = [each for each in applied.outcomes if each.result is Result.FAILED]
    if applied.succeeded:
        return ""
    reasons = [f"{each.step.name or each.step.kind}: {each.reason}" for each in failed]
    if not reasons:
        reasons = sorted({each.reason for each in applied.outcomes if each.reason})
    done = sum(each.result is Result.DONE for each in applied.outcomes)
    text = f"{'; '.join(reasons)} ({done} of {len(applied.outcomes)} steps are done"
    if applied.rollback is None:
        return f"{text})"
    is_back = all(each.result is Result.DONE for each in applied.rollback)
    return f"{text}; {'rolled back' if is_back else 'the rollback failed as well'})"


def _plain(value: object) -> Any:
    return msgspec.to_builtins(value)

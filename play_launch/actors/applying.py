"""Carries out a plan on a running system: phase by phase, and each step to its result."""

from __future__ import annotations

import asyncio
import logging
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Final, assert_never

import anyio

from play_launch.actors.first_of import first_of
from play_launch.actors.members import StuckError
from play_launch.actors.ports import StartError
from play_launch.core.node_key import NodeKey
from play_launch.core.settled import absent, container_settled, member_settled, node_settled
from play_launch.plan.outcome import Applied, Result, StepOutcome
from play_launch.plan.plan import plan
from play_launch.plan.progress import after
from play_launch.plan.steps import Action, Kind, Need

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator, Mapping

    from play_launch.actors.members import Members
    from play_launch.actors.ports import Launcher, ParameterService
    from play_launch.actors.publisher import Publisher
    from play_launch.actors.stop_requests import StopRequests
    from play_launch.config.model import (
        ComposableNodeConfig,
        ContainerConfig,
        ParameterConfig,
        ProcessConfig,
        ReplayConfig,
    )
    from play_launch.core.events import RunEvent
    from play_launch.core.view import SystemView
    from play_launch.plan.steps import Plan, Step

_log = logging.getLogger(__name__)

STEP_LIMIT: Final = 60.0
"""Seconds for what one step waits for, unless somebody says otherwise."""

_BECAUSE: Final = "the configuration has changed"


class BusyError(Exception):
    """Another configuration is being applied."""


class StepError(Exception):
    """A step could not be carried out; the text says why."""


def _nobody_listens(outcome: StepOutcome) -> None:
    del outcome


class Applying:
    """Changes a running system; one change at a time."""

    def __init__(
        self,
        config: ReplayConfig,
        members: Members,
        publisher: Publisher,
        stop: StopRequests,
        *,
        launcher: Launcher,
        parameters: ParameterService,
        on_begin: Callable[[], None],
        use_rules: Callable[[ReplayConfig], None],
    ) -> None:
        """Know the system as it was configured at its start; ``on_begin`` hears of each change.

        ``use_rules`` takes a configuration for what has to hold before something new is started.
        """
        self._on_begin = on_begin
        self._use_rules = use_rules
        self.config = config
        """As it is configured now."""
        self._members = members
        self._publisher = publisher
        self._stop = stop
        self._launcher = launcher
        self._parameters = parameters
        self._leaving: dict[str, str] = {}
        """By the names of steps: what was asked to end and had not when its step was over; why."""
        self._changed = asyncio.Event()
        self.idle = asyncio.Event()
        """Set unless something is being applied."""
        self.idle.set()
        publisher.add_sink(self)

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:
        """Take an event: what a step waits for may have happened."""
        del event
        if before is not after and not self.idle.is_set():
            self._changed.set()

    def plan(self, target: ReplayConfig) -> Plan:
        """Compare the system with what it is to become."""
        return plan(self.config, target, self._absent())

    def _absent(self) -> dict[str, str]:
        return {**absent(self._publisher.view), **self._leaving}

    async def apply(
        self,
        target: ReplayConfig,
        *,
        limit: float = STEP_LIMIT,
        rolls_back: bool = False,
        on_outcome: Callable[[StepOutcome], None] = _nobody_listens,
    ) -> Applied:
        """Change what differs from ``target``, and nothing else.

        A step that fails is the last one, beside those that are done at the same time with it.

        Args:
            target: What the system is to become.
            limit: Seconds for each step.
            rolls_back: Whether a failure is followed by the way back to where it began.
            on_outcome: Hears of each step when it is over.

        Raises:
            BusyError: When another configuration is being applied.
        """
        if not self.idle.is_set():
            raise BusyError("another configuration is being applied")
        self.idle.clear()
        self._on_begin()
        try:
            before, absent_before = self.config, self._absent()
            found = self.plan(target)
            outcomes = await self._carry_out(found, target, limit, on_outcome)
            applied = Applied(plan=found, outcomes=outcomes)
            if applied.succeeded or not rolls_back:
                return applied
            _log.warning("the new configuration failed; the one before is applied again")
            lost = {
                name: reason for name, reason in self._absent().items() if name not in absent_before
            }
            back = plan(self.config, before, lost)
            rollback = await self._carry_out(back, before, limit, on_outcome)
            return Applied(plan=found, outcomes=outcomes, rollback=rollback)
        finally:
            self.idle.set()

    async def close(self) -> None:
        """Give back what it takes to talk to nodes."""
        await self._parameters.close()

    async def _carry_out(
        self,
        found: Plan,
        target: ReplayConfig,
        limit: float,
        on_outcome: Callable[[StepOutcome], None],
    ) -> tuple[StepOutcome, ...]:
        outcomes: list[StepOutcome] = []
        problem = await self._prepare(target) if found.to_do else ""
        if not problem:
            self._use_rules(target)
        for phase in found.phases():
            failed = problem or any(each.result is not Result.DONE for each in outcomes)
            if failed:
                skipped = Result.SKIPPED
                outcomes += [
                    StepOutcome(step=step, result=skipped, reason=problem) for step in phase
                ]
                continue
            outcomes += await self._at_once(
                [partial(self._outcome, step, target, limit, on_outcome) for step in phase]
            )
        self.config = after(self.config, target, (each.step for each in outcomes if each.holds))
        return tuple(outcomes)

    async def _prepare(self, target: ReplayConfig) -> str:
        try:
            await self._launcher.prepare(target)
        except StartError as error:
            return str(error)
        return ""

    async def _at_once(
        self, works: list[Callable[[], Awaitable[StepOutcome]]]
    ) -> list[StepOutcome]:
        outcomes: list[StepOutcome] = []

        async def one(work: Callable[[], Awaitable[StepOutcome]]) -> None:
            outcomes.append(await work())

        async with anyio.create_task_group() as tasks:
            for work in works:
                tasks.start_soon(one, work)
        return outcomes

    async def _outcome(
        self,
        step: Step,
        target: ReplayConfig,
        limit: float,
        on_outcome: Callable[[StepOutcome], None],
    ) -> StepOutcome:
        loop = asyncio.get_running_loop()
        began = loop.time()
        result, reason = Result.DONE, ""
        try:
            with anyio.fail_after(limit):
                reason = await self._do(step, target)
        except TimeoutError:
            result, reason = Result.FAILED, f"it takes longer than {limit:g} s"
        except (StepError, StuckError) as error:
            result, reason = Result.FAILED, str(error)
        except Exception as error:  # noqa: BLE001 - the others go on
            _log.exception("%s %s failed", step.action, step.name)
            result, reason = Result.FAILED, f"{type(error).__name__}: {error}"
        outcome = StepOutcome(step=step, result=result, reason=reason, seconds=loop.time() - began)
        on_outcome(outcome)
        return outcome

    async def _do(self, step: Step, target: ReplayConfig) -> str:
        """Carry out one step and wait for what becomes of it; return how, where that matters."""
        match step.kind:
            case Kind.CONTAINER:
                found = {each.full_name: each for each in target.containers}
                await self._container(step, found.get(step.name))
            case Kind.PROCESS:
                processes = {each.full_name: each for each in target.nodes}
                return await self._process(step, processes.get(step.name))
            case Kind.COMPONENT:
                return await self._component(step, target)
            case Kind.SESSION:
                pass  # the launcher took it over as it prepared
            case _:
                assert_never(step.kind)
        return ""

    async def _container(self, step: Step, config: ContainerConfig | None) -> None:
        if config is None:
            with self._ending(step.name):
                await self._members.remove(step.name, _BECAUSE)
            return
        if step.action is Action.ADOPT:
            self._members.containers[step.name].adopt(config)
            return
        await self._begin(step, config)
        await self._until(partial(container_settled, name=step.name))

    async def _process(self, step: Step, config: ProcessConfig | None) -> str:
        if config is None:
            with self._ending(step.name):
                await self._members.remove(step.name, _BECAUSE)
            return ""
        refusal = ""
        if step.action in {Action.ADOPT, Action.SET}:
            member = self._members.processes[step.name]
            refusal = await self._set(step, config.full_name, config.parameters, config.environment)
            if not refusal:
                member.adopt(config)
                return ""
        await self._begin(step, config)
        member = self._members.processes[step.name]
        await self._until(lambda view: member_settled(view, step.name, member.state))
        return refusal and f"restarted: {refusal}"

    async def _begin(self, step: Step, config: ContainerConfig | ProcessConfig) -> None:
        if step.action is Action.ADD:
            self._members.add(config)
        else:
            with self._ending(step.name):
                await self._members.replace(config, _BECAUSE)

    @contextmanager
    def _ending(self, name: str) -> Iterator[None]:
        """Remember what does not end in time: it still will, and is not there then."""
        self._leaving[name] = "it was asked to end"
        yield
        # With a container, so have its nodes.
        for each in [each for each in self._leaving if each == name or each.startswith(f"{name}:")]:
            del self._leaving[each]

    async def _component(self, step: Step, target: ReplayConfig) -> str:
        key = NodeKey.parsed(step.name)
        container = self._members.containers[key.container]
        if step.action is Action.REMOVE:
            with self._ending(step.name):
                if key in container.nodes:
                    container.deliver(partial(container.nodes.withdraw, key))
                await self._until(partial(_withdrawn, key=key))
            return ""
        config, environment = _declared(target, key)
        refusal = ""
        if step.action in {Action.ADOPT, Action.SET}:
            refusal = await self._set(step, key.name, config.parameters, environment)
            container.deliver(partial(container.nodes.declare, config))
            if not refusal:
                return ""
        container.deliver(partial(container.nodes.declare, config, anew=True))
        self._leaving.pop(step.name, None)
        await self._until(partial(node_settled, key=key))
        return refusal and f"reloaded: {refusal}"

    async def _set(
        self,
        step: Step,
        node: str,
        parameters: tuple[ParameterConfig, ...],
        environment: Mapping[str, str],
    ) -> str:
        """Set the parameters that the step names; return why they are not."""
        prefix = "parameters."
        names = {
            change.path.removeprefix(prefix) for change in step.changes if change.need is Need.SET
        }
        chosen = [each for each in parameters if each.name in names]
        if not chosen:
            return ""
        return await self._parameters.set(node, chosen, environment)

    async def _until(self, settled: Callable[[SystemView], str | None]) -> None:
        """Wait for what becomes of something; raises StepError when it fails."""
        while (reason := settled(self._publisher.view)) is None:
            if self._stop.requested.is_set():
                raise StepError("the system is being stopped")
            self._changed.clear()
            await first_of(self._changed.wait(), self._stop.requested.wait())
        if reason:
            raise StepError(reason)


def _withdrawn(view: SystemView, key: NodeKey) -> str | None:
    container = view.containers.get(key.container)
    return "" if container is None or key not in container.nodes else None


def _declared(target: ReplayConfig, key: NodeKey) -> tuple[ComposableNodeConfig, Mapping[str, str]]:
    for container in target.containers:
        if container.full_name == key.container:
            for node in container.composable_nodes:
                if node.key == key:
                    return node, container.environment
    raise StepError("it is not in the new configuration")

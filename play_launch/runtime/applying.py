"""Applies another configuration to a running system: plan, preparation, result."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING, Final

from play_launch.config.node_key import NodeKey
from play_launch.runtime.launcher import StartError
from play_launch.supervisor.conditions import absent_units
from play_launch.supervisor.inputs import ChangeRequested, ParametersSet
from play_launch.supervisor.plan import Applied, Need, PlanKind, Result, StepOutcome, after, plan

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.config.model import ReplayConfig
    from play_launch.ros.parameters import ParameterSetter
    from play_launch.runtime.system import System
    from play_launch.supervisor.plan import Plan, Step

_log = logging.getLogger(__name__)

STEP_LIMIT: Final = 60.0
"""Seconds for what one step waits for, by default."""


class BusyError(Exception):
    """Another configuration is being applied."""


class Applying:
    """Changes a running system; one change at a time."""

    def __init__(self, system: System, parameters: ParameterSetter) -> None:
        self._system = system
        self._parameters = parameters
        self._outcomes: list[StepOutcome] = []
        self._on_outcome: Callable[[StepOutcome], None] = lambda _: None
        self._target = system.config
        self.idle = asyncio.Event()
        """Set unless something is being applied."""
        self.idle.set()

    @property
    def config(self) -> ReplayConfig:
        """The system as it is configured now."""
        return self._system.config

    def plan(self, target: ReplayConfig) -> Plan:
        """Compare the system with what it is to become."""
        return plan(self.config, target, self._absent())

    def _absent(self) -> dict[str, str]:
        return absent_units(self._system.world, self.config)

    async def apply(
        self,
        target: ReplayConfig,
        *,
        limit: float = STEP_LIMIT,
        rolls_back: bool = False,
        on_outcome: Callable[[StepOutcome], None] = lambda _: None,
    ) -> Applied:
        """Change what differs from ``target``, and nothing else.

        A step that fails is the last one, beside those that are done at the same time with it.

        Args:
            target: What the system is to become.
            limit: Seconds for each step.
            rolls_back: Whether a failure is followed by the way back to where it began.
            on_outcome: Gets each step when it is over.

        Raises:
            BusyError: When another configuration is being applied.
        """
        if not self.idle.is_set():
            raise BusyError("another configuration is being applied")
        self.idle.clear()
        self._on_outcome = on_outcome
        try:
            before, absent_before = self.config, self._absent()
            found = self.plan(target)
            outcomes = await self._carry_out(found, target, limit)
            applied = Applied(plan=found, outcomes=outcomes)
            if applied.succeeded or not rolls_back:
                return applied
            _log.warning("the new configuration failed; the one before is applied again")
            lost = {
                name: reason for name, reason in self._absent().items() if name not in absent_before
            }
            back = plan(self.config, before, lost)
            rollback = await self._carry_out(back, before, limit)
            return Applied(plan=found, outcomes=outcomes, rollback=rollback)
        finally:
            self.idle.set()

    async def close(self) -> None:
        """Release what it takes to talk to nodes."""
        await self._parameters.close()

    async def _carry_out(
        self, found: Plan, target: ReplayConfig, limit: float
    ) -> tuple[StepOutcome, ...]:
        problem, self._outcomes = "", []
        try:
            if found.to_do:
                await self._system.launcher.prepare(target)
        except StartError as error:
            problem = str(error)
        else:
            self._target = target
            self._system.outside.expect(target.start_rules.values())
            self._system.post(ChangeRequested(target, found.phases(), limit))
            await self._system.until(lambda: self._system.world.change is None)
        done = {each.step.id for each in self._outcomes}
        outcomes = self._outcomes + [
            StepOutcome(step=step, result=Result.SKIPPED, reason=problem)
            for phase in found.phases()
            for step in phase
            if step.id not in done
        ]
        held = (each.step for each in outcomes if each.holds)
        self._system.config = after(self.config, target, held)
        return tuple(outcomes)

    # Effects.

    def step_ended(self, outcome: StepOutcome) -> None:
        """Note the result of a step."""
        self._outcomes.append(outcome)
        self._on_outcome(outcome)

    async def set_parameters(self, step: Step) -> None:
        """Set the parameters that a step names."""
        prefix = "parameters."
        names = {
            change.path.removeprefix(prefix) for change in step.changes if change.need is Need.SET
        }
        config = self._target.parts[step.name]
        chosen = [each for each in config.parameters if each.name in names]  # type: ignore[union-attr]
        member = node = step.name
        if step.kind is PlanKind.COMPONENT:
            key = NodeKey.parsed(step.name)
            member, node = key.container, key.name
        environments = {each.full_name: each.environment for each in self._target.members}
        try:
            refusal = await self._parameters.set(node, chosen, dict(environments[member]))
        except Exception as error:  # noqa: BLE001 - the node is replaced instead
            _log.exception("the parameters of %s could not be set", step.name)
            refusal = f"{type(error).__name__}: {error}"
        self._system.post(ParametersSet(step, refusal))

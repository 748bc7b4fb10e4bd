"""Managed (lifecycle) nodes of the machine."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.supervisor import inputs as said
from play_launch.supervisor.events import ManagedState
from play_launch.supervisor.inputs import ManagedInput

if TYPE_CHECKING:
    from .machine import Machine


class ManagedNodes:
    """What they answer, each instance for itself."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self.talks: dict[str, int] = {}
        """The instance that each unit is talked to about."""

    def drive(self, effect: said.Drive) -> None:
        machine, unit, instance = self._machine, effect.unit, effect.instance
        if effect.to is ManagedState.ABSENT:
            return
        if effect.to is not ManagedState.ASKED:
            self._transit(effect)
            return
        self.talks[unit] = instance
        self._answer(unit, instance, ManagedInput.IS_UNCONFIGURED)
        if machine.is_unlucky(0.1, f"is moved by hand: {unit}"):
            moved = (ManagedInput.IS_INACTIVE, ManagedInput.IS_ACTIVE, ManagedInput.IS_FINALIZED)
            one = machine.chance.choice(moved, f"move {unit}")
            delay = machine.soon(10.0, f"moved {unit}")
            machine.post_later(delay, said.GoalReported(unit, instance, one, "by hand"))

    def _transit(self, effect: said.Drive) -> None:
        leads_to = {
            ManagedState.CONFIGURING: ManagedInput.IS_INACTIVE,
            ManagedState.ACTIVATING: ManagedInput.IS_ACTIVE,
        }[effect.to]
        self._answer(effect.unit, effect.instance, leads_to)

    def _answer(self, unit: str, instance: int, fact: ManagedInput) -> None:
        machine = self._machine
        delay = machine.soon(1.0, f"transition {unit}")
        if machine.is_unlucky(0.1, f"does not answer in time: {unit}"):
            fact, delay = ManagedInput.OVERDUE, 5.0
        elif machine.is_unlucky(0.1, f"refuses: {unit}"):
            fact = ManagedInput.REFUSED
        one = said.GoalReported(unit, instance, fact, "")
        machine.post_later(delay, one)
        if machine.is_unlucky(0.1, f"answers again: {unit}"):
            machine.post_later(delay + machine.soon(5.0, f"again {unit}"), one)

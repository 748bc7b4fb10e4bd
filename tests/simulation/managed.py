"""Managed (lifecycle) nodes of the machine."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.supervisor import inputs as said
from play_launch.supervisor.events import ManagedState
from play_launch.supervisor.inputs import ManagedInput

if TYPE_CHECKING:
    from play_launch.supervisor.world import Goal

    from .machine import Machine


class ManagedNodes:
    """What they answer, each instance for itself."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self.talks: dict[str, Goal] = {}
        """The goal that each unit is talked to about."""
        self.moved: set[str] = set()
        """Units that others than the supervisor have moved."""
        self._states: dict[tuple[str, int], ManagedInput] = {}
        """Of each instance that has left its first state."""

    def drive(self, effect: said.Drive) -> None:
        machine, unit, instance = self._machine, effect.unit, effect.instance
        if effect.to is ManagedState.ABSENT:
            return
        if effect.to is not ManagedState.ASKED:
            self._transit(effect)
            return
        self.talks[unit] = machine.world.goals[unit]
        is_ = self._states.get((unit, instance), ManagedInput.IS_UNCONFIGURED)
        self._answer(unit, instance, is_)
        # What is only watched is driven by a manager of its own.
        is_driven = self.talks[unit].config.autostart is not None
        is_moved = not is_driven and machine.chance.number(f"manager: {unit}") < 0.7
        if is_moved or machine.is_unlucky(0.1, f"is moved by hand: {unit}"):
            self.moved.add(unit)
            moved = (ManagedInput.IS_INACTIVE, ManagedInput.IS_ACTIVE, ManagedInput.IS_FINALIZED)
            one = machine.chance.choice(moved, f"move {unit}")
            delay = machine.soon(10.0, f"moved {unit}")
            self._states[unit, instance] = one
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
        elif fact is not ManagedInput.IS_UNCONFIGURED:
            self._states[unit, instance] = fact
        one = said.GoalReported(unit, instance, fact, f"it says {fact}")
        machine.post_later(delay, one)
        if machine.is_unlucky(0.1, f"answers again: {unit}"):
            machine.post_later(delay + machine.soon(5.0, f"again {unit}"), one)

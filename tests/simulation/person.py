"""An operator that types at random, another configuration included."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

from play_launch.config.node_key import NodeKey
from play_launch.supervisor import inputs as said
from play_launch.supervisor.conditions import absent_units
from play_launch.supervisor.plan import StepOutcome, after, plan
from tests.postmortem.scenes import requested

from . import systems

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.config.model import ReplayConfig

    from .machine import Machine


class Person:
    """Does one thing at a time, and does not wait for what follows."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self.target: ReplayConfig | None = None
        """What is being applied."""
        self.done: list[StepOutcome] = []
        self._changes = 0

    def meddle(self) -> None:
        """Do one thing that a person or the world outside does."""
        machine, chance = self._machine, self._machine.chance
        if not chance.happens(1.0, "meddling"):
            return
        names, keys = list(machine.world.processes), list(machine.world.nodes)
        deeds: dict[str, Callable[[], None]] = {
            "touch a file": machine.touch_file,
            "touch a topic": machine.touch_topic,
            "touch far away": machine.touch_far,
            "apply": self._change,
        }
        if names:
            name = chance.choice(names, "name")
            anew = said.StartRequested(name, anew=True, reason="for a test")
            ended = said.EndRequested(name, "a person asked for it")
            deeds["start"] = lambda: self._act("start", name, said.StartRequested(name))
            deeds["stop"] = lambda: self._act("stop", name, ended)
            deeds["restart"] = lambda: self._act("restart", name, anew)
        if keys:
            key = chance.choice(keys, "key")
            unit = str(key)
            deeds["load"] = lambda: self._act("load", unit, said.StartRequested(unit))
            deeds["unload"] = lambda: self._act("unload", unit, said.EndRequested(unit))
            deeds["reload"] = lambda: self._act(
                "reload", unit, said.StartRequested(unit, anew=True)
            )
        likely = [deed for kind, deed in deeds.items() for _ in range(int(machine.weight(kind)))]
        if likely:
            chance.choice(likely, "deed")()

    def _act(self, action: str, target: str, one: said.Input) -> None:
        self._note(action, (target,))
        self._machine.post(one)

    def _note(self, action: str, targets: tuple[str, ...]) -> None:
        self._machine.publish([requested(self._machine.stamp_ns, action, targets)])

    def _change(self) -> None:
        machine = self._machine
        if self.target is not None or machine.world.is_stopping or machine.world.is_ending:
            return
        self._changes += 1
        chance = random.Random(f"{machine.chance.seed} {self._changes}")
        self.target = systems.changed(chance, machine.config)
        found = plan(machine.config, self.target, absent_units(machine.world, machine.config))
        self.done = []
        recalled = tuple(step.name for step in found.to_do if step.name)
        self._note("apply", recalled)
        machine.post(said.ChangeRequested(self.target, found.phases(), 30.0))

    def set_parameters(self, effect: said.SetParameters) -> None:
        machine, step = self._machine, effect.step
        refuses = machine.is_unlucky(1.0, f"refuses parameters: {step.name}")
        answer = said.ParametersSet(step, "it is read only" if refuses else "")
        if not machine.is_unlucky(0.1, f"does not answer: {step.name}"):
            machine.post_later(machine.soon(1.0, f"parameters {step.name}"), answer)

    def step_ended(self, effect: StepOutcome) -> None:
        self.done.append(effect)

    def change_ended(self) -> None:
        machine = self._machine
        if self.target is None:
            return
        self._machine.checks.seen.change_ended()
        held = [each.step for each in self.done if each.holds]
        machine.config = after(machine.config, self.target, held)
        self.target = None


def unit_of(name: str) -> str:
    """Name the process that a unit lives in."""
    return NodeKey.parsed(name).container if ":/" in name else name

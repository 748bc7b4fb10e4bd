"""Looks for lives that break an invariant, and shortens what it finds."""

from __future__ import annotations

import traceback
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

from play_launch.supervisor.inputs import ChangeRequested, Log, Probe, Query, Time
from play_launch.supervisor.plan import StepOutcome

from .machine import Machine, lived
from .person import unit_of
from .seen import BrokenError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

MOST_TRIALS: Final = 300
"""Lives that the shortening of one finding may take."""
MOST_LINES: Final = 200


class Finding(Struct, frozen=True):
    """A life that broke an invariant."""

    seed: int
    name: str
    """Of the invariant; of an exception, its type."""
    text: str
    machine: Machine
    units: frozenset[str]
    """What it is about; empty: everything."""

    @property
    def command(self) -> str:
        """What repeats it."""
        return f"python -m tests.simulation --seed {self.seed} --trace"


def tried(seed: int, without: Collection[str] = ()) -> tuple[int, Finding | None]:
    """Live one life; give how many inputs it took, and what it broke."""
    machine = Machine(seed, without)
    try:
        lived(machine)
    except BrokenError as error:
        units = frozenset(error.units)
        return machine.steps, Finding(seed, error.name, str(error), machine, units)
    except Exception as error:  # noqa: BLE001 - an exception of the supervisor is a finding as well
        text = "".join(traceback.format_exception(error))
        return machine.steps, Finding(seed, type(error).__name__, text, machine, frozenset())
    return machine.steps, None


def searched(seeds: Iterable[int]) -> tuple[int, Finding | None]:
    """Live one life after the other, up to the first finding; give the number of inputs as well."""
    inputs = 0
    for seed in seeds:
        steps, found = tried(seed)
        inputs += steps
        if found is not None:
            return inputs, found
    return inputs, None


def shortened(found: Finding) -> Finding:
    """Leave troubles out as long as the same invariant breaks: delta debugging."""
    trials, size, without = 0, len(found.machine.chance.troubles), frozenset[str]()
    while size >= 1 and trials < MOST_TRIALS:
        troubles, has_left_out = found.machine.chance.troubles, False
        for begin in range(0, len(troubles), size):
            tries = without | {*troubles[begin : begin + size]}
            trials += 1
            _, shorter = tried(found.seed, tries)
            if shorter is not None and shorter.name == found.name:
                found, without, has_left_out = shorter, tries, True
                break
            if trials >= MOST_TRIALS:
                break
        if not has_left_out:
            size //= 2
        size = min(size, len(found.machine.chance.troubles))
    return found


def report(found: Finding) -> str:
    """Describe a finding: invariant, seed, command, troubles, and what concerns its units."""
    machine = found.machine
    lines = [
        f"invariant: {found.name}",
        f"seed:      {found.seed}",
        f"command:   {found.command}",
        f"system:    {_system(machine)}",
        f"troubles:  {', '.join(machine.chance.troubles) or 'none'}",
        *_trace(machine, found.units)[-MOST_LINES:],
        found.text,
    ]
    return "\n".join(lines)


def _system(machine: Machine) -> str:
    units = machine.config.units
    members = [f"{name} ({len(nodes)} nodes)" if nodes else name for name, nodes in units.items()]
    rules = [
        f"{unit} waits for {', '.join(map(str, rule.dependencies))}"
        for unit, rule in machine.config.start_rules.items()
    ]
    return "; ".join([", ".join(members), *rules])


def _trace(machine: Machine, units: frozenset[str]) -> list[str]:
    lines = []
    for at, one, effects in machine.trace:
        about = [each for each in effects if _concerns(each, units)]
        if isinstance(one, Time) and all(isinstance(each, Log) for each in about):
            continue  # it was only reported that something waits
        if about or _concerns(one, units):
            lines.append(f"{at:9.3f} {_short(one)}")
            lines += [f"          -> {_short(each)}" for each in about]
    return lines


def _concerns(one: Any, units: frozenset[str]) -> bool:
    if not units:
        return True
    if isinstance(one, Probe | Query):
        return one.container in units
    if isinstance(one, StepOutcome):
        return unit_of(one.step.name) in units
    for name in ("unit", "container", "node"):
        if (unit := getattr(one, name, None)) is not None:
            return unit_of(str(unit)) in units
    return type(one).__name__ != "Time"


def _short(one: Any) -> str:
    if isinstance(one, ChangeRequested):
        steps = [f"{step.action} {step.name}" for phase in one.phases for step in phase]
        return f"ChangeRequested({', '.join(steps)})"
    if isinstance(one, StepOutcome):
        return f"StepOutcome({one.step.action} {one.step.name}: {one.result} {one.reason})"
    defaults = _defaults(type(one))
    values = [
        f"{name}={getattr(one, name)!s}"
        for name in one.__struct_fields__
        if name not in defaults or getattr(one, name) != defaults[name]
    ]
    return f"{type(one).__name__}({', '.join(values)})"


def _defaults(kind: type[Any]) -> dict[str, Any]:
    names, values = kind.__struct_fields__, kind.__struct_defaults__
    return dict(zip(names[len(names) - len(values) :], values, strict=True))

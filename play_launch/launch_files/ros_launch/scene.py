"""What one evaluation knows: the context of launch, what was found, and where things stand."""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from play_launch.launch_files.find import LARGEST
from play_launch.launch_files.records import (
    Argument,
    Description,
    Event,
    LaunchedProcess,
    Loss,
    Losses,
    ParameterFile,
    StartCondition,
    TemporaryFile,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.launch_files.records import Unit
    from play_launch.launch_files.ros_launch.places import Places

Conditions: TypeAlias = tuple[StartCondition, ...]


class Causes:
    """Under which conditions something is visited now, and each unit was visited."""

    def __init__(self) -> None:
        self.now: Conditions = ()
        self._of_units: dict[str, Conditions] = {}

    @contextmanager
    def under(self, conditions: Conditions) -> Iterator[None]:
        """While what follows from these conditions is visited."""
        before, self.now = self.now, conditions
        try:
            yield
        finally:
            self.now = before

    def note(self, unit: str) -> Conditions:
        """Note that a unit is visited now, and return under which conditions."""
        self._of_units[unit] = self.now
        return self.now

    def of_unit(self, unit: str) -> Conditions:
        """Return under which conditions a unit was visited."""
        return self._of_units.get(unit, ())

    def followed_by(self, before: Conditions, event: Conditions) -> Conditions:
        """Return the conditions of what is said under some and follows an event.

        Conditions that the unit of the event has itself are left out, and its start: they happened
        before.
        """
        implied: set[StartCondition] = set()
        todo = [each.unit for each in event if each.unit]
        seen: set[str] = set()
        while todo:
            unit = todo.pop()
            if unit not in seen:
                seen.add(unit)
                own = self.of_unit(unit)
                implied.update(own)
                implied.add(StartCondition(event=Event.STARTED, unit=unit))
                todo += [each.unit for each in own if each.unit]
        kept = [each for each in before if each not in implied and each not in event]
        return (*kept, *event)


class Scene:
    """The state of one evaluation.

    Attributes:
        context: The `launch.LaunchContext`.
        places: Where things stand.
        causes: Under which conditions something is visited.
        description: What was found so far.
        environment: The variables as they were before.
        temporary: The folder in which temporary files are made; it does not stay.
        written: The parameter files that launch_ros wrote of values.
        given: The names of the arguments that were given.
        passed: The names of those that each include passes on, the outermost first.
    """

    def __init__(
        self, context: Any, places: Places, temporary: Path, given: frozenset[str]
    ) -> None:
        self.context = context
        self.given = given
        self.passed: list[set[str]] = []
        self.places = places
        self.causes = Causes()
        self.description = Description()
        self.losses = Losses()
        self.environment = dict(os.environ)
        self.temporary = temporary
        self.written: set[str] = set()
        self._folder = Path.cwd()
        self._numbers = 0
        self._declared: set[str] = set()

    def next_id(self, kind: str) -> str:
        """Return an id for a record: its kind and its number in the order of the launch."""
        self._numbers += 1
        return f"{kind}{self._numbers}"

    def add(self, unit: Unit) -> None:
        self.causes.note(unit.id)
        self.description.units.append(unit)

    def unit(self, name: str) -> Unit:
        return next(each for each in self.description.units if each.id == name)

    def described(self, conditions: Conditions) -> str:
        """Put conditions into words."""
        return " and then ".join(self._described(each) for each in conditions)

    def _described(self, condition: StartCondition) -> str:
        if condition.event is Event.DELAY:
            return f"{condition.seconds:g} s have passed"
        unit = self.unit(condition.unit)
        command = getattr(unit, "command", [])
        name = unit.full_name or getattr(unit, "executable", "") or " ".join(command[:2])
        if condition.event is Event.STATE:
            return f"{name} is {condition.state}"
        return f"{name} has {condition.event}"

    def lost(self, where: Any, what: str, *, is_note: bool = False) -> None:
        """Note what the records do not say; `where` is a unit, or a part of the description."""
        described = getattr(where, "described", None)
        if not isinstance(described, str):
            described = str(self.places.of_part(where)) if where is not None else ""
        self.losses.add(Loss(described or next(iter(self.places.files), ""), what, is_note))

    def warned(self, text: str) -> None:
        """Note what launch_ros warns of while a part of the description is visited."""
        self.losses.note(str(self.places.of_visited().place), text)

    def declared(self, action: Any, default: str | None) -> None:
        """Note a launch argument that may be given."""
        if action.name not in self._declared:
            self._declared.add(action.name)
            origin = self.places.of_part(action)
            choices = tuple(map(str, action.choices or ()))
            # launch puts the choices behind the description.
            text = str(action.description).removesuffix(f" Valid choices are: {action.choices}")
            self.description.arguments.append(Argument(action.name, default, text, choices, origin))

    def changed_folder(self) -> str:
        """Return the working directory where the launch file has changed it, else nothing."""
        try:
            now = Path.cwd()
        except FileNotFoundError:
            return ""
        return "" if now == self._folder else str(now)

    def parameter_file(self, path: str) -> ParameterFile:
        """Return a parameter file as a source; with its text where it does not stay."""
        file = Path(path).absolute()
        if file.is_relative_to(self.temporary):
            return ParameterFile(str(file), file.read_text(encoding="utf-8"))
        return ParameterFile(str(file))

    def take_temporary(self) -> None:
        """Keep the temporary files that units name, other than those of parameters."""
        found = sorted((path for path in self.temporary.rglob("*") if _can_be_kept(path)), key=str)
        kept: dict[str, None] = {}
        for unit in self.description.units:
            texts = [str(each.value.value) for each in unit.parameters]
            if isinstance(unit, LaunchedProcess):
                texts += [*unit.command, *unit.arguments, *unit.ros_arguments, *unit.prefix]
                texts += [unit.cwd, *(value for _, value in unit.environment)]
            for text in texts:
                if str(self.temporary) not in text:
                    continue
                named = [str(path) for path in found if str(path) in text]
                kept |= dict.fromkeys(named)
                for name in sorted(named, key=len, reverse=True):
                    text = text.replace(name, "")  # noqa: PLW2901 - what is left of it
                if str(self.temporary) in text:
                    self.lost(unit, f"it names a temporary file, which does not stay: {text}")
        self.description.temporary = [TemporaryFile(path, Path(path).read_bytes()) for path in kept]


def _can_be_kept(path: Path) -> bool:
    try:
        return path.is_file() and path.stat().st_size <= LARGEST and os.access(path, os.R_OK)
    except OSError:
        return False

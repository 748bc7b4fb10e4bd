"""What has to happen before a part of a description is visited, and where it was said."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple

from play_launch.launch_files.records import Event, StartCondition

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.launch_files.records import Place

Conditions = tuple[StartCondition, ...]


class Cause(NamedTuple):
    """Conditions, one after the other, and the includes that lead to what they start."""

    conditions: Conditions = ()
    includes: tuple[Place, ...] = ()


def follow_an_exit(conditions: Conditions) -> bool:
    """Whether a process ends before all of these hold."""
    return any(each.event is Event.EXITED for each in conditions)


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

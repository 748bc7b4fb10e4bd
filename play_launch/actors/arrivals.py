"""Which units of a system have come up since its start, or failed for good."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.core.dependency import Condition, Dependency
from play_launch.core.managed import Autostart, ManagedState
from play_launch.core.order import Standing

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.actors.members import Members
    from play_launch.actors.publisher import Publisher
    from play_launch.config.model import ManagedConfig
    from play_launch.core.order import Look

_SETTLED = frozenset({ManagedState.ACTIVE, ManagedState.FINALIZED, ManagedState.FAILED})


class Arrivals:
    """Belongs to the thread of the event loop.

    A unit that was up once has arrived: what becomes of it later is another matter.
    """

    def __init__(
        self, members: Members, publisher: Publisher, look: Callable[[Dependency], Look]
    ) -> None:
        """Take the members, which may come and go; ``look`` says how a condition stands."""
        self._members = members
        self._publisher = publisher
        self._look = look
        self._arrived: set[str] = set()

    def coming(self, managed: Callable[[str], ManagedConfig | None]) -> tuple[str, ...]:
        """Name the units that have neither been up nor failed for good, as declared.

        What a person stopped or unloaded is not expected. ``managed`` gives how far a unit is
        brought after its start.
        """
        dismissed = self._publisher.view.dismissed
        found = []
        for member in self._members.all:
            if member.name in dismissed:
                continue
            nodes = self._members.containers.get(member.name)
            units = {member.name: Condition.STARTED}
            units |= {str(key): Condition.LOADED for key in (nodes.nodes if nodes else ())}
            found += [
                unit
                for unit, condition in units.items()
                if unit not in dismissed and not self._has_arrived(unit, condition, managed(unit))
            ]
        return tuple(found)

    def _has_arrived(self, unit: str, condition: Condition, managed: ManagedConfig | None) -> bool:
        if unit in self._arrived:
            return True
        standing = self._look(Dependency(condition=condition, unit=unit)).standing
        has_arrived = standing is not Standing.OPEN
        if standing is Standing.HOLDS and managed is not None and managed.autostart is not None:
            known = self._publisher.view.managed.get(unit)
            enough = _SETTLED
            if managed.autostart is Autostart.CONFIGURE:
                enough |= {ManagedState.INACTIVE}
            has_arrived = known is not None and known.state in enough
        if has_arrived:
            self._arrived.add(unit)
        return has_arrived

"""Which events somebody wants to see."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.config.node_key import NodeKey
from play_launch.control.targets import full_name
from play_launch.supervisor.event_object import EVENT_TYPES, names_of
from play_launch.supervisor.events import OutputLine

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from play_launch.control.targets import Target
    from play_launch.supervisor.events import RunEvent

KINDS: Final = frozenset(EVENT_TYPES.values())
OF_OLD: Final = KINDS - {"output", "process_sample", "group_sample", "system_sample"}
"""What is meant where nobody says: everything of which there is not much."""
CONSOLE_FORMAT: Final = re.compile(r"^\S*\[[A-Z ]+\](?: \[[^\]]*\])? \[([^\]]+)\]: ")
"""That of ROS: severity, time, and the logger as the only group."""


class Selection(Struct, frozen=True):
    """Kinds of events, and what they are about."""

    kinds: frozenset[str] = OF_OLD
    names: frozenset[str] | None = None
    """Full names of containers, nodes and processes; None: of everything."""
    loggers: frozenset[str] = frozenset()
    """Of the nodes among them, whose output comes through their container."""

    def wants(self, event: RunEvent) -> bool:
        """Whether an event is among them; one that is about nobody is where nobody is named."""
        if EVENT_TYPES[type(event)] not in self.kinds:
            return False
        if self.names is None:
            return True
        if not self.names.isdisjoint(names_of(event)):
            return True
        return isinstance(event, OutputLine) and self._is_of_a_node(event.text)

    def _is_of_a_node(self, text: str) -> bool:
        if not self.loggers:
            return False
        found = CONSOLE_FORMAT.match(text)
        if found is None:
            return False
        name = found[1]
        return any(name == each or name.startswith(f"{each}.") for each in self.loggers)


def selection_of(kinds: Iterable[str], targets: Sequence[Target] | None) -> Selection:
    """Make a selection; without kinds, what is usual."""
    chosen = frozenset(kinds) or OF_OLD
    if targets is None:
        return Selection(chosen)
    names = frozenset(full_name(target) for target in targets)
    loggers = frozenset(logger_of(target.name) for target in targets if isinstance(target, NodeKey))
    return Selection(chosen, names, loggers)


def logger_of(node: str) -> str:
    """Give the name of the logger that a node has in ROS, of its full name."""
    return node.lstrip("/").replace("/", ".")

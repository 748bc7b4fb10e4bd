"""One step of the reducer: the world, the time, and the effects that were asked for so far."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.supervisor.inputs import Log, Query, Raised

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.config.node_key import NodeKey
    from play_launch.supervisor.inputs import Effect
    from play_launch.supervisor.world import Node, Process, World


class Reduction:
    """Belongs to one call of `play_launch.supervisor.reducer.reduce`."""

    def __init__(self, world: World, now: float, chance: float) -> None:
        """``chance`` is a random number in [0, 1), for the jitter of delays."""
        self.world = world
        self.now = now
        self.chance = chance
        self.effects: list[Effect] = []
        self._queries: dict[str, list[Node]] = {}

    def process(self, name: str) -> Process:
        """Give a process as it is now."""
        return self.world.processes[name]

    def node(self, key: NodeKey) -> Node:
        """Give a node as it is now."""
        return self.world.nodes[key]

    def log(self, text: str, *, is_shown_otherwise: bool = False) -> None:
        """Have a warning logged."""
        self.effects.append(Log(text, is_shown_otherwise=is_shown_otherwise))

    def confine(self, unit: str, rule: Callable[[], None]) -> None:
        """Evaluate a rule of one unit; an exception in it is the failure of that unit alone."""
        try:
            rule()
        except Exception as error:  # noqa: BLE001 - the others go on
            self.effects.append(Raised(unit, error))

    def query(self, node: Node) -> None:
        """Have the container of a node queried about it, in one message with others."""
        self._queries.setdefault(node.key.container, []).append(node)

    def finish(self) -> list[Effect]:
        """Give all effects."""
        for container, nodes in self._queries.items():
            about = tuple((node.key, node.attempt, node.unique_id) for node in nodes)
            self.effects.append(Query(container, about))
        return self.effects

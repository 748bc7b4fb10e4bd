"""Which parameters nodes have, as far as the session knows without asking them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from play_launch.config.node_key import NodeKey
from play_launch.container.cdr.layout import CdrError
from play_launch.container.cdr.messages import NODE_PARAMETERS
from play_launch.control.protocol import names_argument

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from play_launch.config.model import ReplayConfig
    from play_launch.control.connection import Stream
    from play_launch.control.place import Peer
    from play_launch.control.targets import Target
    from play_launch.runtime.system import System


class ParameterNames:
    """What is configured, and what the recording has been answered."""

    def __init__(
        self,
        system: System,
        chosen: Callable[[Sequence[str]], list[Target]],
        answer_of: Callable[[str], bytes | None],
    ) -> None:
        """Know where to look.

        Args:
            system: Has the configuration.
            chosen: Finds what names mean; raises ControlError.
            answer_of: Gives the latest ``play_launch_msgs/NodeParameters`` of a node.
        """
        self._system = system
        self._chosen = chosen
        self._answer_of = answer_of

    async def give(self, arguments: dict[str, Any], _peer: Peer, _stream: Stream) -> object:
        """List names of parameters by node; raises ControlError."""
        configured = dict(_configured(self._system.config))
        found = []
        for target in self._chosen(names_argument(arguments)):
            if target not in configured:
                continue
            name = target.name if isinstance(target, NodeKey) else target
            names = sorted({*configured[target], *_answered(self._answer_of(name))})
            found.append({"name": name, "parameters": names})
        return found


def _configured(config: ReplayConfig) -> Iterator[tuple[Target, list[str]]]:
    for container in config.containers:
        for node in container.composable_nodes:
            yield node.key, [each.name for each in node.parameters]
    for process in config.nodes:
        yield process.full_name, [each.name for each in process.parameters]


def _answered(message: bytes | None) -> list[str]:
    if message is None:
        return []
    try:
        return [str(each["name"]) for each in NODE_PARAMETERS.read(message)["parameters"]]
    except CdrError:
        return []

"""What is asked of a container about its nodes, for as long as it is there to be asked."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from play_launch.actors.container.load_request import load_request
from play_launch.actors.container.questions import Questions
from play_launch.core.questions import Asked
from play_launch.wire.channel import ControlError
from play_launch.wire.codec import EncodeError
from play_launch.wire.messages import Cancel, Unload

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.actors.container.node_reports import MirroredNode
    from play_launch.core.node_key import NodeKey
    from play_launch.wire.messages import Outgoing

_log = logging.getLogger(__name__)


class Requests:
    """The requests to one container; while it is not there, none is made."""

    def __init__(self, container: str) -> None:
        """Take its full name."""
        self.questions = Questions(container)
        self._container = container
        self._send: Callable[[Outgoing], None] | None = None
        self._to_ask: dict[NodeKey, MirroredNode] = {}

    @property
    def are_heard(self) -> bool:
        """Whether the container is there."""
        return self._send is not None

    def begin(self, send: Callable[[Outgoing], None]) -> None:
        """The container is there; `send` takes what is for it."""
        self._send = send

    def end(self) -> None:
        """The container is gone, and answers nothing any more."""
        self._send = None
        self.questions.clear()
        self._to_ask.clear()

    def load(self, node: MirroredNode, entry: tuple[str, ...]) -> str:
        """Have a node loaded, whose process enters its control group by `entry`.

        Returns:
            Why it cannot be asked for; empty: it is.
        """
        try:
            self._request(load_request(node.config, node.record.attempt, entry))
        except EncodeError as error:
            return str(error)
        return ""

    def cancel(self, node: MirroredNode) -> None:
        """Have a load given up."""
        self._request(Cancel(unique_id=node.record.unique_id))

    def unload(self, node: MirroredNode) -> None:
        """Have a node unloaded."""
        self._request(Unload(unique_id=node.record.unique_id))

    def ask_about(self, node: MirroredNode) -> None:
        """Have the next question be about this node, too."""
        self._to_ask[node.key] = node

    def ask(self) -> None:
        """Put one question about all nodes that one is due for."""
        if not self._to_ask:
            return
        asked = tuple(
            Asked(node.key, node.record.attempt, node.record.unique_id)
            for node in self._to_ask.values()
        )
        self._to_ask.clear()
        self._request(self.questions.put(asked))

    def _request(self, message: Outgoing) -> None:
        if self._send is None:
            return
        try:
            self._send(message)
        except ControlError as error:
            # Whoever reads the channel learns it as well and deals with the container.
            _log.debug("%s: a request was not sent: %s", self._container, error)

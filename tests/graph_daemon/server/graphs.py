"""A graph that is made up."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class FakeGraph:
    """Knows what it is told."""

    def __init__(self, name: str = "daemon", nodes: tuple[str, ...] = ()) -> None:
        self._name = name
        self.known = {name, *nodes}
        self.topics = {"/rosout"}
        self.participants = 1
        self.nameless = 0
        self.calls: list[tuple[str, tuple[object, ...]]] = []
        self.closed = False
        self.during_call: Callable[[], None] = lambda: None

    @property
    def name(self) -> str:
        return self._name

    def nodes(self) -> list[tuple[str, str]]:
        assert not self.closed
        return [(name, "/") for name in sorted(self.known)]

    def met(self) -> tuple[int, int]:
        assert not self.closed
        return self.participants, self.nameless

    def call(self, method: str, *arguments: object) -> Any:
        assert not self.closed
        self.calls.append((method, arguments))
        self.during_call()
        if method == "get_topic_names_and_types":
            return [(topic, ["a/msg/B"]) for topic in sorted(self.topics)]
        if method == "get_service_names_and_types":
            return []
        if method == "get_node_names_and_namespaces":
            return self.nodes()
        raise ValueError(f"{method} is not made up")

    def close(self) -> None:
        self.closed = True

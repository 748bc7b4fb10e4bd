"""A node that looks at the network's interfaces before each call."""

from typing import Any


class _Node:
    def __init__(self) -> None:
        self.looks = 0

    def get_looks(self, _call: int = 0) -> int:
        return self.looks


class NetworkAwareNode:
    """Passes everything on to its node."""

    def __init__(self) -> None:
        self.node = _Node()

    def __getattr__(self, name: str) -> Any:
        self.reset_if_addresses_changed()
        return getattr(self.node, name)

    def reset_if_addresses_changed(self) -> None:
        """Look at the interfaces; here that is only counted."""
        self.node.looks += 1

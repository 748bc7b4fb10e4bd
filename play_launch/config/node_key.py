"""What a composable node is addressed by, from the configuration to the recording."""

from __future__ import annotations

from msgspec import Struct


class NodeKey(Struct, frozen=True, order=True):
    """A declared composable node; other nodes may come, go and change places around it.

    `container` is the full name of its container. `name` is the declared full name or, where the
    configuration gives none, a label such as ``/[demo::Talker]`` that no ROS node can have, and
    that no other node of the container has. `play_launch.config.resolve` makes the keys.
    """

    container: str
    name: str

    def __str__(self) -> str:
        """Write it as ``/container:/name``: a container's name has no colon, so this is unique."""
        return f"{self.container}:{self.name}"

    @classmethod
    def parsed(cls, text: str) -> NodeKey:
        """Read what `str` wrote.

        Raises ValueError when it is no such text.
        """
        # Both are full names or labels: they begin with the only slash that a colon can precede.
        container, separator, name = text.partition(":/")
        if not separator:
            raise ValueError(f"{text!r} is not the key of a node")
        return cls(container, f"/{name}")

"""Every name in the system once: ROS lets two nodes share a name, and both then misbehave."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.config.names import (
    LONGEST_FULL_NAME,
    check_namespace,
    check_node_name,
    join_full_name,
)
from play_launch.config.yaml_scalars import ScalarKind
from play_launch.config.yaml_tree import Mapping, Scalar

if TYPE_CHECKING:
    from play_launch.config.problems import Place
    from play_launch.config.report import Report


class NodeNames:
    """The full names given so far, and labels for nodes whose name is their own affair."""

    def __init__(self, report: Report) -> None:
        self._report = report
        self._places: dict[str, Place] = {}
        self._labels: dict[str, int] = {}

    def declare(self, node: Mapping, path: str) -> str | None:
        """Return the full name that `node` gives, None if it gives none; report a second owner.

        Looks at the tree, so that two equal names are found even where other keys are wrong.
        """
        name_node = node.value("name")
        namespace_node = node.value("namespace")
        name = _text(name_node)
        namespace = "/" if namespace_node is None else _text(namespace_node)
        if name_node is None or not name or not namespace:
            return None
        try:
            full_name = join_full_name(check_namespace(namespace), check_node_name(name))
        except ValueError:
            return None
        if len(full_name) > LONGEST_FULL_NAME:
            message = (
                f"namespace and name have {len(full_name)} characters; at most "
                f"{LONGEST_FULL_NAME}, because the names of the node's services are longer"
            )
            self._report.add(name_node.place, f"{path}.name", message)
        first = self._places.setdefault(full_name, name_node.place)
        if first is not name_node.place:
            message = f"the name {full_name} is given twice, first at {first}"
            self._report.add(name_node.place, f"{path}.name", message)
        return full_name

    def label(self, namespace: str, what: str) -> str:
        """Return a label for an unnamed node, `/[what]`, that no other node has."""
        base = join_full_name(namespace or "/", what)
        count = self._labels.get(base, 0) + 1
        self._labels[base] = count
        suffix = "" if count == 1 else f":{count}"
        return join_full_name(namespace or "/", f"[{what}{suffix}]")


def _text(node: object) -> str | None:
    if isinstance(node, Scalar) and node.kind is ScalarKind.STRING:
        return node.text
    return None

"""A node is addressed by the same key whatever else is declared, and no two by the same one."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hypothesis import assume, given, settings
from hypothesis import strategies as st

from play_launch.config.load import parse_config

if TYPE_CHECKING:
    from play_launch.config.node_key import NodeKey

CONTAINERS = ("/one", "/ns/two", "/three")


@dataclass(frozen=True)
class Declared:
    """A composable node; ``tag`` tells apart those that are declared alike."""

    container: str
    namespace: str | None
    name: str | None
    plugin: str
    tag: int = 0

    @property
    def kind(self) -> tuple[str, str, str]:
        """Of a node without a name: those of one kind are told apart by their order only."""
        return self.container, self.namespace or "/", self.plugin


NODES = st.builds(
    Declared,
    container=st.sampled_from(CONTAINERS),
    namespace=st.sampled_from([None, "/", "/ns"]),
    name=st.none() | st.sampled_from(["a", "b", "two"]),
    plugin=st.sampled_from(["demo::Talker", "demo::Listener"]),
)


def keys(nodes: list[Declared]) -> dict[Declared, NodeKey]:
    """The keys that the nodes get in a configuration that declares them in this order."""
    containers = [
        {
            "namespace": full_name.rpartition("/")[0] or "/",
            "name": full_name.rpartition("/")[2],
            "composable_nodes": [
                {
                    key: value
                    for key, value in {
                        "package": "demo",
                        "plugin": node.plugin,
                        "name": node.name,
                        "namespace": node.namespace,
                    }.items()
                    if value is not None
                }
                for node in nodes
                if node.container == full_name
            ],
        }
        for full_name in CONTAINERS
    ]
    text = json.dumps({"version": 1, "containers": containers}).encode()
    config = parse_config(text, Path("demo.yaml"))
    found: dict[Declared, NodeKey] = {}
    for container in config.containers:
        declared = [node for node in nodes if node.container == container.full_name]
        for node, resolved in zip(declared, container.composable_nodes, strict=True):
            assert resolved.key.container == container.full_name
            found[node] = resolved.key
    return found


def full_name(node: Declared) -> str:
    return f"{(node.namespace or '/').rstrip('/')}/{node.name}"


def acceptable(drawn: list[Declared]) -> list[Declared]:
    """Number those that are alike; a name may be given once, and a container bears it, too."""
    seen: Counter[Declared] = Counter()
    names = set(CONTAINERS)
    nodes: list[Declared] = []
    for node in drawn:
        if node.name is not None:
            if full_name(node) in names:
                continue
            names.add(full_name(node))
        nodes.append(Declared(node.container, node.namespace, node.name, node.plugin, seen[node]))
        seen[node] += 1
    return nodes


@settings(deadline=None, max_examples=100)
@given(st.lists(NODES, min_size=1, max_size=12).map(acceptable), st.data())
def test_keys_are_unique_and_do_not_depend_on_other_nodes(
    nodes: list[Declared], data: st.DataObject
) -> None:
    assume(nodes)
    before = keys(nodes)
    texts = [str(key) for key in before.values()]
    assert len(set(texts)) == len(set(before.values())) == len(nodes)

    kept = data.draw(st.sampled_from(nodes))
    others = [
        node for node in nodes if node.name is not None or kept.name or node.kind != kept.kind
    ]
    others = [node for node in others if node is not kept]
    changed = data.draw(st.permutations(others))
    changed = changed[: data.draw(st.integers(0, len(changed)))]
    alike = [node for node in nodes if kept.name is None and node.name is None]
    alike = [node for node in alike if node.kind == kept.kind] or [kept]
    for node in alike:
        changed.insert(data.draw(st.integers(0, len(changed))), node)
    in_order = iter(alike)
    # Those that only their order tells apart keep it.
    changed = [next(in_order) if node in alike else node for node in changed]
    after = keys(changed)
    assert {node: after[node] for node in alike} == {node: before[node] for node in alike}


def test_a_program_that_is_called_like_a_counted_one_has_a_label_of_its_own() -> None:
    commands = [["talker"], ["talker:2"], ["talker"], ["talker:2"], ["talker:2:2"]]
    text = json.dumps({"version": 1, "nodes": [{"command": each} for each in commands]}).encode()
    names = [node.full_name for node in parse_config(text, Path("demo.yaml")).nodes]
    assert len(set(names)) == len(names)
    assert names[0] == "/[talker]"
    assert names[2] == "/[talker:2]"


def test_a_process_is_not_renamed_by_a_composable_node() -> None:
    process = {"command": ["demo::Talker"]}
    node = {"package": "demo", "plugin": "demo::Talker"}
    system = {"containers": [{"name": "c", "composable_nodes": [node, node]}], "nodes": [process]}
    text = json.dumps({"version": 1, **system}).encode()
    (resolved,) = parse_config(text, Path("demo.yaml")).nodes
    assert resolved.full_name == "/[demo::Talker]"

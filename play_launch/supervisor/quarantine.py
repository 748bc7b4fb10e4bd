"""Quarantine: which nodes may be loaded into a container that did not survive an earlier load.

A container loads many nodes at the same time, so when it dies, each node that was being loaded may
be the cause. What may be done with it depends on how many deaths in a row it was there for:

* After the first one its library is loaded in a scratch process. If it cannot be loaded there, the
  node is not loaded; its library is tried again when the container restarts, for it may have been
  replaced. If it can, the node is loaded as usual.
* After the second one the library is not the cause, but the constructor may be. Such nodes are
  loaded after all others and one at a time, so that the next death has one possible cause only.
* A node that was the only one being loaded at its second death, and any node at its third, is not
  loaded again in this session.

A load that the container survives clears the node. The first death counts against the restart
limits of the container. Those that follow while such a node is being loaded do not: they are how
the cause is found, and their number is bounded.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import node_rules
from play_launch.supervisor.frames import blamed_line
from play_launch.supervisor.inputs import Probe
from play_launch.supervisor.transitions import LOADING
from play_launch.supervisor.world import Stage, is_wanted

if TYPE_CHECKING:
    from collections.abc import Collection

    from play_launch.config.node_key import NodeKey
    from play_launch.supervisor.inputs import Probed
    from play_launch.supervisor.reducer import Reduction
    from play_launch.supervisor.world import Node, Process, World

MOST_DEATHS: Final = 3
"""Deaths of its container after which a node is refused, whatever else was being loaded."""
_DEATHS_ALONE: Final = 2
"""Deaths after which a node is refused that was the only one being loaded, and from which on it is
loaded alone."""
_LOADABLE: Final = frozenset({Stage.TRUSTED, Stage.CLEARED})
ALONE_LIMIT: Final = 60.0
"""Seconds after which a load under way no longer keeps others from being loaded alone."""


def excuses_death(world: World, container: str) -> bool:
    """Count a death that does not use up a restart: a node in quarantine was being loaded."""
    nodes = world.nodes_of(container)
    tried = [node for node in nodes if node.stage is Stage.CLEARED and node.state in LOADING]
    is_excused = any(node.excused < MOST_DEATHS - 1 for node in tried)
    for node in tried:
        world.put(node, excused=node.excused + 1)
    return is_excused


def begin(step: Reduction, container: Process, loads: Collection[NodeKey], reason: str) -> None:
    """Put nodes into quarantine that were being loaded when their container died."""
    probe, refused = [], []
    for node in step.world.nodes_of(container.name):
        deaths = node.deaths + (node.key in loads)
        if node.key not in loads and node.stage is not Stage.CONDEMNED:
            continue
        if node.key in loads and (
            deaths >= MOST_DEATHS or (len(loads) == 1 and deaths >= _DEATHS_ALONE)
        ):
            refused.append(step.world.put(node, stage=Stage.REFUSED, deaths=deaths))
        else:
            probe.append(node.key)
            text = "its library is loaded in a scratch process first"
            reports = node.reports + 1
            step.world.put(node, stage=Stage.PROBING, deaths=deaths, reason=text, reports=reports)
    if loads:
        first = next(iter(loads)).name
        names = f"{first} and {len(loads) - 1} more" if len(loads) > 1 else first
        step.log(f"{container.name} ended while it was loading {names}")
    for node in refused:
        why = f"it took the container down {node.deaths} times while it was loaded: {reason}"
        node_rules.refuse(step, node, why)
    if probe:
        step.effects.append(Probe(container.name, tuple(probe)))


def probed(step: Reduction, said: Probed) -> None:
    node, finding = step.world.nodes.get(said.node), said.finding
    if node is None or node.stage is not Stage.PROBING:
        return
    if finding is None or finding.loads:
        step.world.put(node, stage=Stage.CLEARED)
        return
    node = step.world.put(node, stage=Stage.CONDEMNED)
    at = f" at {blamed_line(finding.backtrace)}" if finding.backtrace else ""
    name = node.key.container
    where = f"in a scratch process, tried because {name} ended while it loaded the node"
    node_rules.refuse(step, node, f"{finding.error}{at} ({where})", finding)


def may_load(world: World, node: Node, now: float) -> bool:
    """Whether a node is loaded now, beside the loads that are under way; suspects come last."""
    if node.stage not in _LOADABLE:
        return False
    all_ = tuple(world.nodes_of(node.key.container))
    since = now - ALONE_LIMIT
    others = [each for each in all_ if each.state in LOADING and each.sent_at >= since]
    if any(_is_alone(each) for each in others):
        return False
    if not _is_alone(node):
        return True
    container = world.processes[node.key.container]
    due = [
        each
        for each in all_
        if each.stage in _LOADABLE
        and node_rules.is_due(each, container)
        and each.wait is None
        and is_wanted(world, each)
    ]
    return not others and all(_is_alone(each) for each in due)


def _is_alone(node: Node) -> bool:
    return node.deaths >= _DEATHS_ALONE

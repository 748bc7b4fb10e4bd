"""Composable nodes of the machine: their containers answer late, twice, or not at all."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from play_launch.config.model import ContainerType
from play_launch.supervisor import inputs as said
from play_launch.supervisor.transitions import NodeFact

if TYPE_CHECKING:
    from play_launch.config.node_key import NodeKey

    from .machine import Machine
    from .processes import Proc


@dataclass
class Loaded:
    """A node as its container has it."""

    key: NodeKey
    attempt: int
    unique_id: int
    is_loaded: bool = False


class Nodes:
    """What containers do with requests."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._killers: dict[NodeKey, bool] = {}

    def of(self, key: NodeKey) -> list[Loaded]:
        """Find all instances that exist now."""
        procs = self._machine.live(key.container)
        return [each for proc in procs for each in proc.nodes.values() if each.key == key]

    def _is_killer(self, key: NodeKey) -> bool:
        """Whether it mostly kills its container: one of thirty."""
        machine = self._machine
        if key not in self._killers:
            likelihood = machine.weight("killer") ** 2 / 30 if machine.is_faulty else 0.0
            self._killers[key] = machine.chance.number(f"killer: {key}") < likelihood
        return self._killers[key]

    def _is_stock(self, proc: Proc) -> bool:
        process = self._machine.world.processes.get(proc.unit)
        config = process.container if process is not None else None
        return config is None or config.container_type is ContainerType.STOCK

    def report(self, proc: Proc, node: Loaded, fact: NodeFact, **values: Any) -> None:
        machine, key = self._machine, node.key
        one = said.NodeReported(
            unit=proc.unit,
            start=proc.start,
            said=fact,
            attempt=node.attempt,
            unique_id=node.unique_id,
            **values,
        )
        # The end of a node that was reported as loaded is not asked for.
        may_be_lost = fact is not NodeFact.CRASHED
        if may_be_lost and machine.is_unlucky(0.1, f"{fact} is lost: {key}"):
            return
        machine.post(one)
        if machine.is_unlucky(0.2, f"{fact} is reported again: {key}"):
            machine.post_later(machine.soon(5.0, f"again {key}"), one)

    def load(self, key: NodeKey, attempt: int) -> None:
        machine, procs = self._machine, self._machine.live(key.container)
        if not procs or machine.is_unlucky(0.1, f"the request is lost: {key}"):
            return
        proc = procs[-1]
        node = Loaded(key, attempt, next(proc.ids))
        if machine.is_unlucky(0.1, f"is rejected: {key}"):
            delay = machine.soon(1.0, f"rejection {key}")
            machine.later(delay, lambda: self._reject(proc, node))
            return
        proc.nodes[node.unique_id] = node
        delay = machine.soon(0.1, f"acceptance {key}")
        machine.later(delay, lambda: self._accept(proc, node))
        if proc.hangs or machine.is_unlucky(0.1, f"constructor hangs: {key}"):
            return
        delay += machine.soon(1.0, f"construction {key}")
        # A killer is one in quiet times, too, but where nothing looks for it: that would not end.
        may_kill = machine.faults > 0.0 or not self._is_stock(proc)
        kills = may_kill and self._is_killer(key)
        kills = kills and machine.chance.happens(0.8, f"is a killer: {key}")
        if kills or machine.is_unlucky(0.2, f"kills its container: {key}"):
            machine.later(delay, lambda: machine.processes.end(proc, signal=11))
            return
        machine.later(delay, lambda: self._construct(proc, node))

    def _reject(self, proc: Proc, node: Loaded) -> None:
        if proc.is_alive:
            self.report(proc, node, NodeFact.REJECTED, reason="no")

    def _accept(self, proc: Proc, node: Loaded) -> None:
        if proc.is_alive and node.unique_id in proc.nodes:
            self.report(proc, node, NodeFact.ACCEPTED)

    def _construct(self, proc: Proc, node: Loaded) -> None:
        machine, key = self._machine, node.key
        if not proc.is_alive or node.unique_id not in proc.nodes:
            return
        if machine.is_unlucky(0.2, f"fails to load: {key}"):
            del proc.nodes[node.unique_id]
            self.report(proc, node, NodeFact.LOAD_FAILED, reason="no device")
            return
        if machine.is_unlucky(0.2, f"crashes in its constructor: {key}"):
            self._crash(proc, node)
            return
        node.is_loaded = True
        self.report(proc, node, NodeFact.LOADED, pid=proc.pid)
        if machine.is_unlucky(0.5, f"crashes: {key}"):
            machine.later(machine.soon(30.0, f"crash {key}"), lambda: self._crash(proc, node))

    def _crash(self, proc: Proc, node: Loaded) -> None:
        machine = self._machine
        if not proc.is_alive or node.unique_id not in proc.nodes:
            return
        if self._is_stock(proc):
            machine.processes.end(proc, signal=11)
            return
        del proc.nodes[node.unique_id]
        fact = NodeFact.CRASHED if node.is_loaded else NodeFact.LOAD_FAILED
        if machine.chance.number(f"dies as {node.key}") < 0.5:
            fact = NodeFact.CRASHED
        self.report(proc, node, fact, reason="signal 11", signal=11)

    def unload(self, container: str, unique_id: int) -> None:
        machine, procs = self._machine, self._machine.live(container)
        if not procs:
            return
        proc = procs[-1]
        node = proc.nodes.pop(unique_id, None)
        delay = machine.soon(1.0, f"unload {container}")
        if node is None:
            one = said.NodeReported(
                unit=container,
                start=proc.start,
                said=NodeFact.UNLOAD_REJECTED,
                unique_id=unique_id,
            )
            machine.post_later(delay, one)
            return
        machine.later(delay, lambda: self._unloaded(proc, node))

    def _unloaded(self, proc: Proc, node: Loaded) -> None:
        if proc.is_alive:
            self.report(proc, node, NodeFact.UNLOADED)

    def query(self, effect: said.Query) -> None:
        machine, procs = self._machine, self._machine.live(effect.container)
        if not procs or machine.is_unlucky(0.1, f"the query is lost: {effect.container}"):
            return
        proc = procs[-1]
        delay = machine.soon(1.0, f"answer {effect.container}")
        machine.later(delay, lambda: self._answer(proc, effect))

    def _answer(self, proc: Proc, effect: said.Query) -> None:
        if not proc.is_alive:
            return
        for key, attempt, unique_id in effect.about:
            found = [each for each in proc.nodes.values() if each.attempt == attempt]
            node = found[0] if found else Loaded(key, attempt, unique_id)
            fact = NodeFact.STATUS_UNKNOWN
            if found and proc.hangs:
                fact = NodeFact.STATUS_QUEUED
            elif found:
                fact = NodeFact.STATUS_LOADED if node.is_loaded else NodeFact.STATUS_CONSTRUCTING
            reason = "" if found else "the container does not know it"
            report = partial(self.report, proc, node, fact, reason=reason)
            if self._is_stock(proc):  # services and events overtake one another
                self._machine.later(self._machine.soon(2.0, f"way back {key}"), report)
            else:
                report()

    def probe(self, keys: tuple[NodeKey, ...]) -> None:
        machine = self._machine
        for key in keys:
            finding = None
            if machine.is_unlucky(0.3, f"its library cannot be loaded: {key}"):
                finding = said.ProbeResult(loads=False, error="no symbol")
            machine.post_later(machine.soon(5.0, f"probe {key}"), said.Probed(key, finding))

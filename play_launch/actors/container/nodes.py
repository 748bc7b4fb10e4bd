"""The composable nodes of one container, as the container stated them.

Synchronous: words come in, requests and events go out. Which follows from what is decided by
:mod:`play_launch.core.lifecycle`; here it is carried out.
"""

from __future__ import annotations

import logging
import random
from functools import partial
from typing import TYPE_CHECKING, Final, assert_never

from msgspec.structs import replace

from play_launch.actors.container.node_facts import NOTHING, Facts
from play_launch.actors.container.node_reports import MirroredNode, NodeReports
from play_launch.actors.container.node_words import words_of
from play_launch.actors.container.requests import Requests
from play_launch.actors.container.suspect_nodes import SuspectNodes
from play_launch.actors.ports import StartError
from play_launch.actors.restarter import CrashFollower
from play_launch.core.crash import Ignore, Shutdown, StopContainer
from play_launch.core.events import REPORTED_LOGGER, ComponentEvent, NodeState
from play_launch.core.lifecycle import is_silent, step
from play_launch.core.node_report import NodeReport, report_of
from play_launch.core.node_table import NodeAction, NodeInput
from play_launch.core.outlook import NodeFacts
from play_launch.core.restart import GiveUp, Restart

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from play_launch.actors.container.attempts import AttemptNumbers
    from play_launch.actors.container.library_probes import LibraryProbes
    from play_launch.actors.order import StartOrder
    from play_launch.actors.ports import Escalation, NodeGroups
    from play_launch.actors.publisher import Publisher
    from play_launch.config.model import ComposableNodeConfig, ContainerConfig
    from play_launch.core.lifecycle import Patience
    from play_launch.core.node_key import NodeKey
    from play_launch.core.order import Verdict
    from play_launch.core.probe import Finding
    from play_launch.wire.messages import Accepted, NodeStatus, Outgoing, Rejected, Status

_log = logging.getLogger(__name__)
_reported = logging.getLogger(REPORTED_LOGGER)

_ALONE_LIMIT: Final = 60.0
"""Seconds for which a load can keep others waiting that have to be alone."""
_UNDER_WAY: Final = frozenset({NodeState.REQUESTED, NodeState.LOADING})
_ENDED: Final = frozenset({NodeState.UNLOADED, NodeState.CRASHED, NodeState.LOAD_FAILED})
_REFUSABLE: Final = frozenset({NodeState.PENDING, NodeState.LOST})
"""States of a node that its container does not have yet."""
_GONE: Final = frozenset({NodeState.UNLOADED, NodeState.CRASHED})
"""States of a node that nobody wants, in which its container has nothing of it."""


class ContainerNodes:
    """Mirrors the nodes; all times are seconds of the event loop's clock."""

    def __init__(
        self,
        config: ContainerConfig,
        *,
        publisher: Publisher,
        escalation: Escalation,
        attempts: AttemptNumbers,
        patience: Patience,
        clock: Callable[[], float],
        jitter: Callable[[], float] = random.random,
        silence: float,
        deliver: Callable[[Callable[[], None]], None],
        order: StartOrder,
        groups: NodeGroups,
        probes: LibraryProbes | None = None,
    ) -> None:
        """Know the declared nodes; ``attempts`` and ``probes`` are shared by all containers.

        ``deliver`` has something done to the container's member, from a task.
        Without ``probes`` every node is loaded whenever the container is ready.
        """
        self._container = config.full_name
        self._reports = NodeReports(config, publisher, clock)
        self._escalation = escalation
        self._attempts = attempts
        self.patience = patience
        self._clock = clock
        self._silence = silence
        self._jitter = jitter
        self._deliver = deliver
        self._order = order
        self._groups = groups
        self._stopping = False
        self._lost_loading: list[NodeKey] = []
        self._requests = Requests(config.full_name)
        self._nodes = {node.key: self._mirror(node) for node in config.composable_nodes}
        self.suspects = SuspectNodes(config, probes, self, deliver)
        """Those that may have taken the container down; its `run` has to run."""

    def __contains__(self, key: NodeKey) -> bool:
        """Whether that node is declared here."""
        return key in self._nodes

    def _mirror(self, config: ComposableNodeConfig) -> MirroredNode:
        return MirroredNode(config, CrashFollower(config.on_crash, config.restart, self._jitter))

    @property
    def _is_ready(self) -> bool:
        """Whether the container takes loads."""
        return self._requests.are_heard and not self._stopping

    def declare(self, config: ComposableNodeConfig, *, anew: bool = False) -> None:
        """Take in a node, which is loaded as soon as the container is ready.

        One that is known is only replaced ``anew``; else what has changed holds for its next load.
        """
        self.suspects.declare(config)
        if (known := self._nodes.get(config.key)) is not None:
            known.config = config
            known.follower.limit(config.on_crash, config.restart)
            if known.is_withdrawn or anew:
                known.is_withdrawn = False
                self.reload(config.key)
            return
        node = self._nodes[config.key] = self._mirror(config)
        self._reports.state(node, NOTHING)
        if self._is_ready:
            self._begin(node)

    def withdraw(self, key: NodeKey) -> None:
        """Unload a node and forget it, which is published when it has left."""
        self._nodes[key].is_withdrawn = True
        self._order.forget(str(key))
        self.unload(key)
        self._deliver(partial(self._drop, key))

    def _drop(self, key: NodeKey) -> None:
        node = self._nodes.get(key)
        if node is not None and node.is_withdrawn and node.record.state in _GONE:
            del self._nodes[key]
            self.suspects.forget(key)
            self._reports.withdrawn(node)

    def announce(self) -> None:
        """Report that the nodes are declared."""
        for node in self._nodes.values():
            self._reports.state(node, NOTHING)

    def container_ready(self, send: Callable[[Outgoing], None]) -> None:
        """Ask for all nodes at once, in the order of their declaration."""
        self._requests.begin(send)
        self._stopping = False
        for node in tuple(self._nodes.values()):
            self._begin(node)
        self.load_cleared()

    def _begin(self, node: MirroredNode) -> None:
        """Load a node for the first time, or again with its container."""
        if self._order.holds(str(node.key)):
            self._order.want(str(node.key), partial(self._hear_verdict, node))
        elif not self.suspects.holds(node.key):
            self._apply(node, NodeInput.CONTAINER_READY)

    def _hear_verdict(self, node: MirroredNode, verdict: Verdict) -> None:
        self._deliver(partial(self._let_through, node, verdict))

    def _let_through(self, node: MirroredNode, verdict: Verdict) -> None:
        """Load a node that waited for what it depends on, or let it fail."""
        if verdict.fails:
            self.refuse(node.key, verdict.reason)
        elif self._is_ready and not self.suspects.holds(node.key):
            self._apply(node, NodeInput.CONTAINER_READY)

    def container_stops(self) -> None:
        """The container was asked to end; nothing is loaded again any more."""
        self._stopping = True
        self.suspects.stop()
        for node in self._nodes.values():
            node.reload_at = None
            if node.record.replaces:
                self._apply(node, NodeInput.WANTED)

    def container_lost(self, reason: str) -> None:
        """The container process is gone, and with it all nodes."""
        self._lost_loading = self._under_way()
        self._requests.end()
        for node in self._nodes.values():
            node.reload_at = None
            node.died_constructing = ""
            self._apply(node, NodeInput.CONTAINER_LOST, Facts(reason=reason))

    def container_comes_back(self, blame: str) -> None:
        """The lost container is going to be started again.

        ``blame`` says how it ended where a load may be the cause, else it is empty.
        """
        self.suspects.container_died(self._lost_loading if blame else (), blame)

    def __iter__(self) -> Iterator[NodeKey]:
        return iter(self._nodes)

    def facts(self, key: NodeKey, reason: str) -> NodeFacts:
        """Say what those who depend on a node want to know; the reason is that of its state."""
        node = self._nodes[key]
        comes_back = node.reload_at is not None or node.record.replaces
        return NodeFacts(node.record.state, node.record.wanted, comes_back, reason)

    def report_wait(self, key: NodeKey, reason: str) -> None:
        """Report why a node is not loaded yet."""
        self._reports.state(self._nodes[key], Facts(reason=reason))

    def refuse(self, key: NodeKey, reason: str, finding: Finding | None = None) -> None:
        """Let a node fail that the container does not get; not one that it got meanwhile."""
        node = self._nodes[key]
        if node.record.state not in _REFUSABLE:
            return
        self._reports.refusal(node, reason, finding)
        self._apply(node, NodeInput.REFUSED, Facts(reason=reason))

    def load_cleared(self) -> None:
        """Load the nodes whose library was found to be good, if it is their turn."""
        if not self._is_ready:
            return
        since = self._clock() - _ALONE_LIMIT
        for key in self.suspects.due(self._under_way(since)):
            self._apply(self._nodes[key], NodeInput.CONTAINER_READY)

    def _under_way(self, since: float = 0.0) -> list[NodeKey]:
        nodes = (each for each in self._nodes.values() if each.record.state in _UNDER_WAY)
        return [node.key for node in nodes if node.record.sent_at >= since]

    def load(self, key: NodeKey) -> None:
        """Have a node loaded that is not: now, or as soon as its container is ready."""
        self._want(key, NodeInput.LOAD_REQUESTED)

    def reload(self, key: NodeKey) -> None:
        """Have a node replaced by a new one, or loaded."""
        self._want(key, NodeInput.RELOAD_REQUESTED)

    def unload(self, key: NodeKey) -> None:
        """Have a node unloaded; it does not come back with its container either."""
        self._nodes[key].reload_at = None
        self._apply(self._nodes[key], NodeInput.UNLOAD_REQUESTED)
        self._requests.ask()

    def _want(self, key: NodeKey, said: NodeInput) -> None:
        if self._nodes[key].is_withdrawn:  # it is about to be forgotten
            return
        self._nodes[key].reload_at = None
        self._nodes[key].follower.forget()
        self._apply(self._nodes[key], said if self._is_ready else NodeInput.WANTED)
        self._requests.ask()

    def hear(self, message: Accepted | Rejected | ComponentEvent | Status) -> None:
        """Take what the container said."""
        if isinstance(message, ComponentEvent):
            self._reports.event(message)
        for word in words_of(message, self._nodes, self._requests.questions, self._container):
            self._apply(*word)
        self._requests.ask()
        self.load_cleared()

    def hear_silence(self, listed: Iterable[NodeStatus]) -> None:
        """Report once each loaded node whose executor is blocked in a callback for long."""
        silent = {each.attempt: each.silence_ns / 1e9 for each in listed}
        for node in self._nodes.values():
            self._reports.silence(node, silent.get(node.record.attempt, 0.0), self._silence)

    def slow_reload(self, limit: float) -> str:
        """Name a node whose reload takes ``limit`` seconds and thrice its usual time; or empty."""
        now = self._clock()
        for node in self._nodes.values():
            if node.record.state in _UNDER_WAY and node.is_slow_reload(now, limit):
                return node.name
        return ""

    def next_deadline(self) -> float | None:
        """When `on_time` has to be called next; None when nothing is due."""
        times = [
            at
            for node in self._nodes.values()
            for at in (node.record.ask_at, node.reload_at)
            if at is not None
        ]
        return min(times, default=None)

    def on_time(self) -> None:
        """Do what is due."""
        now = self._clock()
        for node in self._nodes.values():
            if node.reload_at is not None and now >= node.reload_at:
                self._reload(node)
            if is_silent(node.record, now):
                self._apply(node, NodeInput.SILENT)
        self._requests.ask()
        self.load_cleared()

    def _apply(self, node: MirroredNode, said: NodeInput, facts: Facts = NOTHING) -> None:
        before = node.record
        result = step(
            before,
            said,
            now=self._clock(),
            patience=self.patience,
            next_attempt=self._attempts.upcoming,
            attempt=facts.attempt,
            unique_id=facts.unique_id,
        )
        if result.ignored:
            _log.info("%s in %s: %s", node.name, self._container, result.ignored)
            return
        node.record = record = result.record
        if facts.signal and node.loaded_at is None:
            node.died_constructing = facts.reason
        if facts.pid or record.attempt != before.attempt:
            node.pid, node.start_time = facts.pid, facts.start_time
        if record.attempt != before.attempt:
            node.loaded_at = None
            self._attempts.use()
        if record.state is NodeState.LOADED and record.state is not before.state:
            node.loaded_at = self._clock()
            node.took = node.loaded_at - record.sent_at
            node.died_constructing, node.is_renewed = "", False
            node.calls_itself = facts.full_node_name
            self._reports.resources(node)
            self._groups.check(node.key.name, node.pid)
        has_changed = record.state is not before.state
        report = report_of(before.state, said, record.state)
        if report is NodeReport.SLOW:
            facts = self._reports.with_wait(facts)
        if report is NodeReport.UNASKED and not self._stopping and not facts.reason:
            facts = replace(facts, reason="not at the supervisor's request")
        over = before.state in _UNDER_WAY and record.state not in _UNDER_WAY
        if over and said is not NodeInput.CONTAINER_LOST:
            self.suspects.survived(node.key)
        if has_changed and record.state in _ENDED:
            why = self._groups.leave(node.key, before.attempt)
            facts = replace(facts, reason=why or facts.reason)
        renews = has_changed and record.state is NodeState.LOAD_FAILED and self._renews(node, facts)
        if renews:
            facts = replace(facts, reason=f"{facts.reason}; its container is started anew")
        if has_changed and said is NodeInput.CRASHED:
            node.crashes += 1
        if NodeAction.SEND_LOAD in result.actions and record.is_reload:
            node.reloads += 1
        # A new request is published by its action, which knows why, and so is what has a sequel.
        has_sequel = NodeAction.FOLLOW_UP in result.actions and not renews
        if (has_changed or report is NodeReport.SLOW) and not (
            has_sequel or record.state is NodeState.REQUESTED
        ):
            self._reports.state(node, facts)
        if report is not None:
            self._reports.log(report, node, facts, is_stopping=self._stopping)
        if report is NodeReport.SLOW and record.is_reload:
            self._escalation.reload_hangs(f"{node.name} is not loaded again: {facts.reason}")
        for action in () if renews else result.actions:
            self._execute(node, action, facts)
        if node.is_withdrawn and node.record.state in _GONE:
            # Not at once: somebody may be going through the nodes.
            self._deliver(partial(self._drop, node.key))

    def _renews(self, node: MirroredNode, facts: Facts) -> bool:
        """Return whether the container is started anew because of a load that failed.

        What a constructor that died had opened, such as a port, stays open in the container. One
        that dies again is not helped by that, and the neighbours are left alone.
        """
        if facts.signal or not node.died_constructing or node.is_renewed:
            return False
        died = f"its constructor died in this container before ({node.died_constructing})"
        reason = f"{node.name} cannot be loaded, and {died}: what it had opened stays open"
        node.is_renewed = self._escalation.renew(f"{reason}: {facts.reason}")
        return node.is_renewed

    def _execute(self, node: MirroredNode, action: NodeAction, facts: Facts) -> None:
        match action:
            case NodeAction.SEND_LOAD:
                self._send_load(node, "")
            case NodeAction.RESEND_LOAD:
                text = "%s: %s does not know the load, sent anew"
                _log.warning(text, node.name, self._container)
                self._send_load(node, "the container did not know the load; sent anew")
            case NodeAction.SEND_QUERY:
                self._requests.ask_about(node)
            case NodeAction.SEND_CANCEL:
                self._requests.cancel(node)
            case NodeAction.SEND_UNLOAD:
                self._requests.unload(node)
            case NodeAction.FOLLOW_UP:
                self._follow_up(node, facts)
            case _:
                assert_never(action)

    def _send_load(self, node: MirroredNode, reason: str) -> None:
        attempt = node.record.attempt
        try:
            entry = self._groups.enter(node.config, attempt)
        except StartError as error:
            self._apply(node, NodeInput.REJECTED, Facts(attempt=attempt, reason=str(error)))
            return
        self._reports.state(node, Facts(reason=reason))
        if why := self._requests.load(node, entry):
            self._apply(node, NodeInput.REJECTED, Facts(attempt=attempt, reason=why))

    def _follow_up(self, node: MirroredNode, facts: Facts) -> None:
        """Decide what follows from a crash or a failed reload, report it, do it."""
        if self._stopping:
            self._reports.state(node, facts)
            return
        now = self._clock()
        lived = 0.0 if node.loaded_at is None else now - node.loaded_at
        node.loaded_at = None
        verdict = node.follower.follow_up(now=now, lived=lived)
        match verdict:
            case Restart(delay):
                when = f"in {delay:.2f} s" if delay else "at once"
                self._report_sequel(node, facts, f"it is loaded again {when}")
                node.reload_at = now + delay
                if not delay:
                    self._reload(node)
            case GiveUp(reason):
                self._give_up(node, facts, reason)
            case Ignore():
                self._report_sequel(node, facts, "it stays away")
            case StopContainer():
                self._give_up(node, facts, "its container is stopped")
                self._escalation.stop_container(f"{node.name} crashed: {facts.reason}")
            case Shutdown():
                self._report_sequel(node, facts, "everything is stopped")
                self._escalation.shut_down(f"{node.name} crashed: {facts.reason}")
            case _:
                assert_never(verdict)

    def _report_sequel(self, node: MirroredNode, facts: Facts, sequel: str) -> None:
        self._reports.state(node, replace(facts, reason=f"{facts.reason}; {sequel}"))

    def _give_up(self, node: MirroredNode, facts: Facts, why: str) -> None:
        self._reports.state(node, facts)
        self._apply(node, NodeInput.GIVEN_UP, Facts(reason=f"{facts.reason}; {why}"))

    def _reload(self, node: MirroredNode) -> None:
        node.reload_at = None
        self._apply(node, NodeInput.RELOAD_DUE)

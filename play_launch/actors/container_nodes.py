"""The composable nodes of one container, as the container stated them.

Synchronous: words come in, requests and events go out. Which follows from what is decided by
:mod:`play_launch.core.lifecycle`; here it is carried out.
"""

from __future__ import annotations

import logging
import random
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, assert_never

from play_launch.actors.load_request import load_request
from play_launch.actors.node_facts import NOTHING, Facts, facts_of_status
from play_launch.actors.restarter import Restarter
from play_launch.core.events import (
    ComponentEvent,
    ComponentEventKind,
    NodeState,
    NodeStateChanged,
)
from play_launch.core.lifecycle import NodeAction, NodeInput, NodeRecord, is_silent, step
from play_launch.core.questions import Asked, ids_to_ask, read_answer
from play_launch.core.restart import GiveUp
from play_launch.native.codec import EncodeError
from play_launch.native.control import ControlError
from play_launch.native.messages import (
    Accepted,
    Cancel,
    Outgoing,
    Query,
    Rejected,
    Status,
    Unload,
)
from play_launch.process.exit import Exit

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.actors.publisher import Publisher
    from play_launch.config.model import ComposableNodeConfig, ContainerConfig
    from play_launch.core.lifecycle import Patience

_log = logging.getLogger(__name__)

_OPEN_QUESTIONS: Final = 16
"""Questions whose answers are still expected; older ones are given up."""

_TIMED: Final = frozenset(
    {NodeState.REQUESTED, NodeState.LOADING, NodeState.LOADED, NodeState.LOAD_FAILED}
)
"""States that are told with the time since the load was sent."""

_SAID: Final = {
    ComponentEventKind.LOADED: NodeInput.LOADED,
    ComponentEventKind.UNLOADED: NodeInput.UNLOADED,
    ComponentEventKind.LOAD_FAILED: NodeInput.LOAD_FAILED,
    ComponentEventKind.CRASHED: NodeInput.CRASHED,
    ComponentEventKind.LOADING: NodeInput.LOADING,
}


@dataclass(slots=True)
class _Node:
    index: int
    config: ComposableNodeConfig
    restarter: Restarter
    record: NodeRecord = field(default_factory=NodeRecord)
    pid: int = 0
    loaded_at: float | None = None
    reload_at: float | None = None


class AttemptNumbers:
    """Numbers for load attempts, unique in the supervisor's life and never 0."""

    def __init__(self) -> None:
        self.upcoming = 1

    def use(self) -> None:
        """The upcoming number is taken."""
        self.upcoming += 1


class ContainerNodes:
    """Mirrors the nodes; all times are seconds of the event loop's clock."""

    def __init__(
        self,
        config: ContainerConfig,
        *,
        publisher: Publisher,
        attempts: AttemptNumbers,
        patience: Patience,
        clock: Callable[[], float],
        jitter: Callable[[], float] = random.random,
    ) -> None:
        """Know the declared nodes; ``attempts`` is shared by all containers."""
        self._container = config.full_name
        self._publisher = publisher
        self._attempts = attempts
        self._patience = patience
        self._clock = clock
        self._send: Callable[[Outgoing], None] | None = None
        self._query_id = 0
        self._questions: dict[int, tuple[Asked, ...]] = {}
        self._to_ask: dict[int, _Node] = {}
        self._nodes = [
            _Node(index, node, Restarter(config.restart, jitter))
            for index, node in enumerate(config.composable_nodes)
        ]

    def announce(self) -> None:
        """Tell that the nodes are declared."""
        for node in self._nodes:
            self._publish_state(node, NOTHING)

    def container_ready(self, send: Callable[[Outgoing], None]) -> None:
        """Ask for all nodes at once, in the order of their declaration."""
        self._send = send
        for node in self._nodes:
            self._apply(node, NodeInput.CONTAINER_READY)

    def container_lost(self, reason: str) -> None:
        """The container process is gone, and with it all nodes."""
        self._send = None
        self._questions.clear()
        self._to_ask.clear()
        for node in self._nodes:
            node.reload_at = None
            self._apply(node, NodeInput.CONTAINER_LOST, Facts(reason=reason))

    def unload(self, index: int) -> None:
        """Have a node unloaded; it does not come back with its container either."""
        self._apply(self._nodes[index], NodeInput.UNLOAD_REQUESTED)
        self._ask()

    def hear(self, message: Accepted | Rejected | ComponentEvent | Status) -> None:
        """Take what the container said."""
        match message:
            case Accepted():
                facts = Facts(attempt=message.attempt, unique_id=message.unique_id)
                self._about_attempt(NodeInput.ACCEPTED, facts)
            case Rejected():
                self._hear_rejected(message)
            case ComponentEvent():
                self._hear_event(message)
            case Status():
                self._hear_status(message)
            case _:
                assert_never(message)
        self._ask()

    def next_deadline(self) -> float | None:
        """When `on_time` has to be called next; None when nothing is due."""
        times = [
            at
            for node in self._nodes
            for at in (node.record.ask_at, node.reload_at)
            if at is not None
        ]
        return min(times, default=None)

    def on_time(self) -> None:
        """Do what is due."""
        now = self._clock()
        for node in self._nodes:
            if node.reload_at is not None and now >= node.reload_at:
                node.reload_at = None
                self._apply(node, NodeInput.RELOAD_DUE)
            if is_silent(node.record, now):
                self._apply(node, NodeInput.SILENT)
        self._ask()

    def _hear_rejected(self, message: Rejected) -> None:
        facts = Facts(attempt=message.attempt, unique_id=message.unique_id, reason=message.reason)
        if message.attempt:
            self._about_attempt(NodeInput.REJECTED, facts)
            return
        for node in self._nodes:
            if message.unique_id and node.record.unique_id == message.unique_id:
                self._apply(node, NodeInput.UNLOAD_REJECTED, facts)
                return
        _log.warning("%s rejected a request: %s", self._container, message.reason)

    def _hear_event(self, event: ComponentEvent) -> None:
        self._publisher.publish(event)
        reason = event.error_message
        if event.kind is ComponentEventKind.CRASHED:
            ending = str(Exit(code=event.exit_code, signal=event.signal))
            reason = f"{ending}: {reason}" if reason else ending
        facts = Facts(
            attempt=event.attempt,
            unique_id=event.unique_id,
            reason=reason,
            pid=event.pid,
            start_time=event.start_time,
            full_node_name=event.full_node_name,
        )
        if event.attempt:
            self._about_attempt(_SAID[event.kind], facts)

    def _hear_status(self, status: Status) -> None:
        asked = self._questions.pop(status.query_id, None)
        if asked is None:
            _log.debug("%s answered question %d again", self._container, status.query_id)
            return
        if status.dropped_frames:
            _log.warning(
                "%s has lost %d frames so far: its outgoing queue was full",
                self._container,
                status.dropped_frames,
            )
        for answer in read_answer(asked, status.nodes):
            facts = facts_of_status(answer.asked, answer.listed)
            self._apply(self._nodes[answer.asked.position], answer.said, facts)

    def _about_attempt(self, said: NodeInput, facts: Facts) -> None:
        for node in self._nodes:
            if node.record.attempt == facts.attempt:
                self._apply(node, said, facts)
                return
        _log.info("%s: %s of old attempt %d is ignored", self._container, said, facts.attempt)

    def _apply(self, node: _Node, said: NodeInput, facts: Facts = NOTHING) -> None:
        before = node.record
        result = step(
            before,
            said,
            now=self._clock(),
            patience=self._patience,
            next_attempt=self._attempts.upcoming,
            attempt=facts.attempt,
            unique_id=facts.unique_id,
        )
        if result.ignored:
            _log.info(
                "%s in %s: %s", node.config.declared_full_name, self._container, result.ignored
            )
            return
        node.record = record = result.record
        node.pid = facts.pid or (node.pid if record.attempt == before.attempt else 0)
        if record.attempt != before.attempt:
            self._attempts.use()
        if record.state is not before.state and record.state is NodeState.LOADED:
            node.loaded_at = self._clock()
        # A new request is published by its action, which knows why.
        if record.state is not NodeState.REQUESTED and (
            record.state is not before.state or NodeAction.REPORT_SLOW in result.actions
        ):
            self._publish_state(node, facts)
        for action in result.actions:
            self._execute(node, action, facts)

    def _execute(self, node: _Node, action: NodeAction, facts: Facts) -> None:
        name = node.config.declared_full_name
        match action:
            case NodeAction.SEND_LOAD:
                self._send_load(node, "")
            case NodeAction.RESEND_LOAD:
                _log.warning("%s: %s does not know the load, sent anew", name, self._container)
                self._send_load(node, "the container did not know the load; sent anew")
            case NodeAction.SEND_QUERY:
                self._to_ask[node.index] = node
            case NodeAction.SEND_CANCEL:
                self._request(Cancel(unique_id=node.record.unique_id))
            case NodeAction.SEND_UNLOAD:
                self._request(Unload(unique_id=node.record.unique_id))
            case NodeAction.PLAN_RELOAD:
                self._plan_reload(node, facts)
            case NodeAction.REPORT_CONFIRMED:
                _log.warning("%s is loaded: no event told it, %s was asked", name, self._container)
                self._publish_confirmation(node, facts)
            case NodeAction.REPORT_SLOW:
                _log.warning("%s: %s", name, facts.reason)
            case NodeAction.REPORT_FAILED:
                _log.error("%s could not be loaded: %s", name, facts.reason)
            case NodeAction.REPORT_FORGOTTEN:
                _log.error("%s: %s does not know it any more", name, self._container)
            case NodeAction.REPORT_CRASHED:
                _log.error("%s crashed: %s", name, facts.reason)
            case NodeAction.REPORT_LOADED | NodeAction.REPORT_UNLOADED | NodeAction.REPORT_LOST:
                _log.debug("%s is %s", name, node.record.state)
            case _:
                assert_never(action)

    def _send_load(self, node: _Node, reason: str) -> None:
        self._publish_state(node, Facts(reason=reason))
        self._request(load_request(node.config, node.record.attempt), node)

    def _request(self, message: Outgoing, node: _Node | None = None) -> None:
        if self._send is None:
            return
        try:
            self._send(message)
        except EncodeError as error:
            if node is None:
                raise
            facts = Facts(attempt=node.record.attempt, reason=str(error))
            self._apply(node, NodeInput.REJECTED, facts)
        except ControlError as error:
            # Whoever reads the channel learns it as well and deals with the container.
            _log.debug("%s: a request was not sent: %s", self._container, error)

    def _ask(self) -> None:
        """Put one question about all nodes that one is due for."""
        if not self._to_ask:
            return
        asked = tuple(
            Asked(node.index, node.record.attempt, node.record.unique_id)
            for node in self._to_ask.values()
        )
        self._to_ask.clear()
        if self._questions:
            _log.warning(
                "%s has not answered %d question(s) about its nodes yet",
                self._container,
                len(self._questions),
            )
        while len(self._questions) >= _OPEN_QUESTIONS:
            del self._questions[next(iter(self._questions))]
        self._query_id += 1
        self._questions[self._query_id] = asked
        self._request(Query(query_id=self._query_id, unique_ids=ids_to_ask(asked)))

    def _plan_reload(self, node: _Node, facts: Facts) -> None:
        now = self._clock()
        lived = 0.0 if node.loaded_at is None else now - node.loaded_at
        node.loaded_at = None
        verdict = node.restarter.decide(now=now, lived=lived)
        if isinstance(verdict, GiveUp):
            _log.error("%s is given up: %s", node.config.declared_full_name, verdict.reason)
            reason = f"{facts.reason}; given up: {verdict.reason}"
            self._publish_state(node, Facts(reason=reason))
        else:
            node.reload_at = now + verdict.delay

    def _publish_state(self, node: _Node, facts: Facts) -> None:
        record = node.record
        elapsed = self._clock() - record.sent_at if record.state in _TIMED else 0.0
        self._publisher.publish(
            NodeStateChanged(
                stamp_ns=self._publisher.stamp_ns(),
                container=self._container,
                node=node.config.declared_full_name,
                index=node.index,
                state=record.state,
                elapsed_ns=round(elapsed * 1e9),
                reason=facts.reason,
                pid=node.pid,
                cpu_time_ns=facts.cpu_time_ns,
                unique_id=record.unique_id,
                attempt=record.attempt,
            )
        )

    def _publish_confirmation(self, node: _Node, facts: Facts) -> None:
        self._publisher.publish(
            ComponentEvent(
                stamp_ns=self._publisher.stamp_ns(),
                kind=ComponentEventKind.LOADED,
                container=self._container,
                unique_id=node.record.unique_id,
                attempt=node.record.attempt,
                full_node_name=facts.full_node_name,
                package_name=node.config.package,
                plugin_name=node.config.plugin,
                pid=facts.pid,
                start_time=facts.start_time,
                confirmed_by="status",
            )
        )

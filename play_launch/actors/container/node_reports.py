"""One composable node as its container's member knows it, and what is reported about it."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any, Final, assert_never

from msgspec import Struct, field
from msgspec.structs import replace

from play_launch.actors.container.node_facts import NOTHING, Facts
from play_launch.actors.resource_report import report_shortfalls
from play_launch.config.model import ContainerType
from play_launch.core.events import (
    REPORTED_LOGGER,
    ComponentEvent,
    ComponentEventKind,
    NodeState,
    NodeStateChanged,
    SubjectKind,
)
from play_launch.core.lifecycle import NodeRecord
from play_launch.core.node_report import NodeReport
from play_launch.process.identity import ProcessIdentity
from play_launch.process.thread_wait import thread_wait

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.actors.publisher import Publisher
    from play_launch.actors.restarter import CrashFollower
    from play_launch.config.model import ComposableNodeConfig, ContainerConfig
    from play_launch.core.node_key import NodeKey
    from play_launch.core.probe import Finding

_log = logging.getLogger(__name__)
_reported = logging.getLogger(REPORTED_LOGGER)

_TIMED: Final = frozenset(
    {NodeState.REQUESTED, NodeState.LOADING, NodeState.LOADED, NodeState.LOAD_FAILED}
)
"""States that are reported with the time since the load was sent."""


class MirroredNode(Struct):
    """What is known about a node; times are seconds of the event loop's clock."""

    config: ComposableNodeConfig
    follower: CrashFollower
    record: NodeRecord = field(default_factory=NodeRecord)
    pid: int = 0
    start_time: int = 0
    """Of the process with this pid, in clock ticks after boot; 0 where unknown."""
    loaded_at: float | None = None
    took: float = 0.0
    """Seconds of the latest load that came to its end."""
    reload_at: float | None = None
    crashes: int = 0
    reloads: int = 0
    died_constructing: str = ""
    """How its constructor died in this container process; empty: it did not."""
    is_renewed: bool = False
    """Whether its container was started anew for it, and it has not been loaded since."""
    is_withdrawn: bool = False
    """Whether it is forgotten as soon as it has left."""
    calls_itself: str = ""
    """Full name that it was loaded with; a component may ignore the one that it is given."""
    reported_silent: bool = False
    """Whether its present stay in callbacks was reported."""

    @property
    def key(self) -> NodeKey:
        """What it is addressed by."""
        return self.config.key

    @property
    def name(self) -> str:
        """Declared full name."""
        return self.config.declared_full_name

    def is_slow_reload(self, now: float, limit: float) -> bool:
        """Whether it is loaded after a crash, for ``limit`` seconds and thrice its usual time."""
        return self.record.is_reload and now - self.record.sent_at > limit + 3 * self.took


class NodeReports:
    """Publishes what happens to the nodes of one container."""

    def __init__(
        self, config: ContainerConfig, publisher: Publisher, clock: Callable[[], float]
    ) -> None:
        """Take the container that they are in."""
        self._container = config.full_name
        self._type = config.container_type
        self._publisher = publisher
        self._clock = clock

    def event(self, event: ComponentEvent) -> None:
        """Publish what the container reported."""
        self._publisher.publish(event)

    def state(self, node: MirroredNode, facts: Facts) -> None:
        """Publish the node's state."""
        record = node.record
        elapsed = self._clock() - record.sent_at if record.state in _TIMED else 0.0
        self._publisher.publish(
            NodeStateChanged(
                stamp_ns=self._publisher.stamp_ns(),
                key=node.key,
                state=record.state,
                elapsed_ns=round(elapsed * 1e9),
                reason=facts.reason or self._other_name(node),
                pid=node.pid,
                start_time=node.start_time,
                cpu_time_ns=facts.cpu_time_ns,
                unique_id=record.unique_id,
                attempt=record.attempt,
                crashes=node.crashes,
                reloads=node.reloads,
            )
        )

    @staticmethod
    def _other_name(node: MirroredNode) -> str:
        is_other = node.config.name and node.calls_itself not in {"", node.name}
        is_loaded = node.record.state is NodeState.LOADED
        return f"it calls itself {node.calls_itself}" if is_loaded and is_other else ""

    def resources(self, node: MirroredNode) -> None:
        """Report which of its resources the kernel refused; it is loaded."""
        report_shortfalls(node.name, node.config.resources, node.pid, self._publisher)

    def with_wait(self, facts: Facts) -> Facts:
        """Add what the constructor waits for, where that can be seen."""
        if self._type is ContainerType.STOCK or not facts.is_constructing or not facts.pid:
            return facts
        # A node with a process of its own is constructed in the first thread.
        thread = "" if self._type.is_isolated else f"load-{facts.unique_id}"
        waits = thread_wait(ProcessIdentity(facts.pid, facts.start_time), thread)
        return replace(facts, reason=f"{facts.reason}; it {waits}") if waits else facts

    def silence(self, node: MirroredNode, seconds: float, limit: float) -> None:
        """Report once that its executor has been blocked for ``limit`` seconds, and its return."""
        is_loaded = node.record.state is NodeState.LOADED
        if not is_loaded or seconds < limit:
            if node.reported_silent and is_loaded:
                self.state(node, NOTHING)
            node.reported_silent = False
        elif not node.reported_silent:
            node.reported_silent = True
            reason = f"its executor has been blocked in a callback for {seconds:.0f} s"
            _log.warning("%s: %s", node.name, reason)
            self.state(node, Facts(reason=reason))

    def withdrawn(self, node: MirroredNode) -> None:
        """Publish that it is not declared any more."""
        self._publisher.withdraw(SubjectKind.NODE, str(node.key))

    def log(
        self, report: NodeReport, node: MirroredNode, facts: Facts, *, is_stopping: bool
    ) -> None:
        """Log what a transition means to a reader."""
        name, why = node.name, facts.reason
        match report:
            case NodeReport.CONFIRMED:
                _log.warning("%s is loaded: no event came, %s was asked", name, self._container)
                self._confirmation(node, facts)
            case NodeReport.SLOW:
                _log.warning("%s: %s", name, why)
            case NodeReport.FAILED:
                _reported.error("%s could not be loaded: %s", name, why)
            case NodeReport.FORGOTTEN:
                _reported.error("%s: %s does not know it any more", name, self._container)
            case NodeReport.CRASHED:
                # Not as an error: the state that follows is reported as one, with the sequel.
                _log.info("%s crashed: %s", name, why)
            case NodeReport.FAULTED:
                _log.error("%s crashed as it was unloaded: %s", name, why)
            case NodeReport.GAVE_UP:
                _reported.error("%s is not loaded again: %s", name, why)
            case NodeReport.UNASKED if not is_stopping:
                _reported.warning("%s is unloaded: %s", name, why)
            case NodeReport.UNASKED | NodeReport.LOADED | NodeReport.UNLOADED | NodeReport.LOST:
                _log.debug("%s is %s", name, node.record.state)
            case _:
                assert_never(report)

    def refusal(self, node: MirroredNode, reason: str, finding: Finding | None) -> None:
        """Publish that its latest load is not repeated, with what a scratch process found."""
        self._event_of(
            node,
            ComponentEventKind.LOAD_FAILED,
            full_node_name=node.name,
            error_message=reason,
            exit_code=finding.exit_code if finding and not finding.signal else 0,
            signal=finding.signal if finding else 0,
            backtrace=finding.backtrace if finding else (),
            modules=finding.modules if finding else (),
            confirmed_by="supervisor" if finding is None else "probe",
        )

    def _confirmation(self, node: MirroredNode, facts: Facts) -> None:
        """Publish that it is loaded, as the container's answer says."""
        self._event_of(
            node,
            ComponentEventKind.LOADED,
            full_node_name=facts.full_node_name,
            pid=facts.pid,
            start_time=facts.start_time,
            confirmed_by="status",
        )

    def _event_of(self, node: MirroredNode, kind: ComponentEventKind, **values: Any) -> None:
        """Publish an event about its latest load that its container did not send."""
        self._publisher.publish(
            ComponentEvent(
                stamp_ns=self._publisher.stamp_ns(),
                kind=kind,
                container=self._container,
                unique_id=node.record.unique_id,
                attempt=node.record.attempt,
                package_name=node.config.package,
                plugin_name=node.config.plugin,
                **values,
            )
        )

"""Queries to a container about its nodes, and inputs about nodes from its messages."""

from __future__ import annotations

import logging
from functools import partial
from typing import TYPE_CHECKING, Final, assert_never

from msgspec.structs import replace

from play_launch.config.model import ContainerType, Isolation
from play_launch.container.command import remap_rules
from play_launch.container.messages import (
    Accepted,
    Load,
    NodeStatusState,
    Query,
    Rejected,
    Status,
    cause_of,
)
from play_launch.process.exit import Exit
from play_launch.process.identity import ProcessIdentity
from play_launch.process.preflight import explained
from play_launch.process.processor_wait import thread_wait
from play_launch.supervisor.events import ComponentEvent, ComponentEventKind
from play_launch.supervisor.frames import blamed_line
from play_launch.supervisor.inputs import NodeReported
from play_launch.supervisor.outcome import Cause
from play_launch.supervisor.transitions import NodeFact

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from play_launch.config.model import ComposableNodeConfig, ContainerConfig
    from play_launch.config.node_key import NodeKey
    from play_launch.container.messages import Hello, NodeStatus
    from play_launch.supervisor.world import Node

    Asked = tuple[NodeKey, int, int]
    """A node that a query is about: key, attempt, and unique_id, which is 0 while unknown."""

_log = logging.getLogger(__name__)

_MOST_OPEN: Final = 16
"""Queries whose answers are expected; older ones are dropped."""
_SAID: Final = {
    NodeStatusState.CONSTRUCTING: NodeFact.STATUS_CONSTRUCTING,
    NodeStatusState.LOADED: NodeFact.STATUS_LOADED,
    NodeStatusState.UNLOADING: NodeFact.STATUS_UNLOADING,
    NodeStatusState.QUEUED: NodeFact.STATUS_QUEUED,
}


class Queries:
    """Queries to one container that have no answer yet."""

    def __init__(self, container: str) -> None:
        """``container`` is its full name."""
        self._container = container
        self._query_id = 0
        self._open: dict[int, Sequence[Asked]] = {}

    def clear(self) -> None:
        """Forget all queries: the container exited."""
        self._open.clear()

    def put(self, asked: Sequence[Asked]) -> Query:
        """Make one query about all of these nodes."""
        if self._open:
            text = "%s has not answered %d question(s) about its nodes yet"
            _log.warning(text, self._container, len(self._open))
        while len(self._open) >= _MOST_OPEN:
            del self._open[next(iter(self._open))]
        self._query_id += 1
        self._open[self._query_id] = asked
        ids = tuple(unique_id for _, _, unique_id in asked)
        # Without ids it is about all nodes.
        return Query(query_id=self._query_id, unique_ids=ids if all(ids) else ())

    def read(self, status: Status) -> Iterator[tuple[int, int, NodeStatus | None]]:
        """Give attempt, unique_id and status of each queried node; None where it is unknown.

        A node whose unique_id is listed under another attempt is left out: that answers nothing.
        """
        by_attempt = {node.attempt: node for node in status.nodes}
        ids = {node.unique_id for node in status.nodes if node.unique_id}
        for _, attempt, unique_id in self._open.pop(status.query_id, ()):
            node = by_attempt.get(attempt)
            if node is not None or unique_id not in ids:
                yield attempt, unique_id, node


_FACT_OF_EVENT: Final = {
    ComponentEventKind.LOADED: NodeFact.LOADED,
    ComponentEventKind.UNLOADED: NodeFact.UNLOADED,
    ComponentEventKind.LOAD_FAILED: NodeFact.LOAD_FAILED,
    ComponentEventKind.CRASHED: NodeFact.CRASHED,
    ComponentEventKind.LOADING: NodeFact.LOADING,
}
_FAILURES: Final = frozenset({ComponentEventKind.LOAD_FAILED, ComponentEventKind.CRASHED})


def inputs_of(
    message: Accepted | Rejected | ComponentEvent | Status,
    config: ContainerConfig,
    start: int,
    queries: Queries,
    nodes: Mapping[int, Node],
) -> Iterator[NodeReported]:
    """Read a message; ``nodes`` are those of the container by their latest attempt."""
    name = config.full_name
    report = partial(NodeReported, unit=name, start=start)
    match message:
        case Accepted():
            attempt, unique_id = message.attempt, message.unique_id
            yield report(said=NodeFact.ACCEPTED, attempt=attempt, unique_id=unique_id)
        case Rejected():
            is_known = any(node.unique_id == message.unique_id for node in nodes.values())
            if not message.attempt and not (message.unique_id and is_known):
                _log.warning("%s rejected a request: %s", name, message.reason)
                return
            yield report(
                said=NodeFact.REJECTED if message.attempt else NodeFact.UNLOAD_REJECTED,
                attempt=message.attempt,
                unique_id=message.unique_id,
                reason=message.reason,
            )
        case ComponentEvent():
            if message.attempt in nodes:
                yield _of_event(message, report)
            elif message.attempt:
                text = "%s: %s of old attempt %d is ignored"
                _log.info(text, name, message.kind.name.lower(), message.attempt)
        case Status():
            for attempt, unique_id, listed in queries.read(message):
                said = report(
                    said=NodeFact.STATUS_UNKNOWN,
                    attempt=attempt,
                    unique_id=unique_id,
                    reason="the container does not know it",
                )
                yield said if listed is None else _of_answer(said, listed, config)
        case _:
            assert_never(message)


def _of_event(event: ComponentEvent, report: Callable[..., NodeReported]) -> NodeReported:
    """Read an event of a container; the reason of a crash names its location."""
    reason = event.error_message
    if event.kind is ComponentEventKind.CRASHED:
        ending = explained(Exit(code=event.exit_code, signal=event.signal))
        at = f" at {blamed_line(event.backtrace)}" if event.backtrace else ""
        if ending.signal and reason.startswith(f"{ending.signal_name} "):
            reason += at + (f": {ending.hint}" if ending.hint else "")
        else:
            reason = (f"{ending}: {reason}" if reason else str(ending)) + at
    return report(
        said=_FACT_OF_EVENT[event.kind],
        attempt=event.attempt,
        unique_id=event.unique_id,
        reason=reason,
        pid=event.pid,
        start_time=event.start_time,
        signal=event.signal,
        full_node_name=event.full_node_name,
        cause=cause_of(event) if event.kind in _FAILURES else Cause.NONE,
    )


def _of_answer(said: NodeReported, listed: NodeStatus, config: ContainerConfig) -> NodeReported:
    """Read what the container reported of one of the nodes that a query was about."""
    elapsed, cpu = listed.elapsed_ns / 1e9, listed.cpu_time_ns / 1e9
    reason = ""
    if listed.note:
        reason = f"{listed.note} ({elapsed:.1f} s so far)"
    elif listed.state == 0:
        runs = f"its constructor runs for {elapsed:.1f} s in pid {listed.pid}"
        reason = f"{runs}, {cpu:.1f} s of it on CPU{_wait(listed, config)}"
    return replace(
        said,
        said=_SAID[listed.state],
        unique_id=listed.unique_id,
        reason=reason,
        pid=listed.pid,
        start_time=listed.start_time,
        cpu_time_ns=listed.cpu_time_ns,
        full_node_name=listed.full_node_name,
    )


def _wait(listed: NodeStatus, config: ContainerConfig) -> str:
    """Describe what a constructor waits for, where that can be seen."""
    if config.container_type is ContainerType.STOCK or not listed.pid:
        return ""
    # A node with a process of its own is constructed in the first thread.
    thread = "" if config.container_type.is_isolated else f"load-{listed.unique_id}"
    waits = thread_wait(ProcessIdentity(listed.pid, listed.start_time), thread)
    return f"; it {waits}" if waits else ""


def description(hello: Hello) -> str:
    """Describe the container in one line: mode, middleware, domain, notes."""
    mode = f"{hello.mode} by {hello.mechanism}" if hello.mechanism else hello.mode
    summary = f"{mode}, {hello.rmw_implementation}, domain {hello.domain_id}"
    return "; ".join([summary, *hello.notes])


def isolation_shortfall(config: ContainerConfig, hello: Hello) -> str:
    """Describe a weaker isolation than the best that was requested; else empty.

    The text is the same for all containers with the same reasons.
    """
    wanted = config.isolation
    at_best = Isolation.SHARED_MEMORY if wanted is Isolation.AUTO else wanted
    if not hello.mechanism or hello.mechanism == at_best:
        return ""
    reasons = "; ".join(hello.notes) or "no reason was reported"
    return f"nodes are isolated by {hello.mechanism}, not by {at_best}: {reasons}"


_SEVERITIES: Final = {"debug": 10, "info": 20, "warn": 30, "error": 40, "fatal": 50}
"""``rcl_interfaces/Log``."""


def load_request(config: ComposableNodeConfig, attempt: int, entry: tuple[str, ...] = ()) -> Load:
    """Make the request; names that were not given stay empty, so the component keeps its own.

    `entry` is how its process enters its control group.
    """
    return Load(
        attempt=attempt,
        package_name=config.package,
        plugin_name=config.plugin,
        node_name=config.name,
        node_namespace=config.namespace,
        log_level=_SEVERITIES[config.log_level.lower()] if config.log_level else 0,
        remap_rules=remap_rules(config.remappings),
        parameters=config.parameters,
        extra_arguments=config.extra_arguments,
        resources=(*entry, *config.resources.settings()),
        lock_memory=config.resources.lock_memory,
    )

"""One load of a stock container."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from play_launch.container.codec import EncodeError
from play_launch.container.messages import NodeStatus, NodeStatusState
from play_launch.ros.parameters import to_parameter_message

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from play_launch.container.messages import Hello, Load


def cpu_time_ns(pid: int) -> int:
    """Return the CPU time of a process so far, in nanoseconds; 0 where that is not known."""
    # Only a system with stock containers needs it.
    import psutil  # noqa: PLC0415

    try:
        used = psutil.Process(pid).cpu_times() if pid else None
    except (psutil.Error, OSError):
        used = None
    return round((used.user + used.system) * 1e9) if used else 0


@dataclass(slots=True, eq=False)
class StockLoad:
    """One attempt to load a node; ``request`` is that of the service."""

    message: Load
    request: object
    state: NodeStatusState | None = NodeStatusState.QUEUED
    """None: it failed or was lost, or its node is gone."""
    is_answered: bool = False
    """Whether ListNodes is to confirm an answer."""
    unique_id: int = 0
    full_name: str = ""
    """By the container's own account."""
    before: frozenset[int] = frozenset()
    """Nodes that were there when it was sent."""
    sent_at: float = 0.0
    cpu_time_ns: int = 0
    """The container's, when it was sent."""
    container_answers: bool = False
    """Whether it answered ListNodes while this load was silent."""
    turn_over: asyncio.Event = field(default_factory=asyncio.Event)
    """Set when the next load may be sent."""

    @property
    def declared_name(self) -> str:
        """The full name by its declaration; empty where the component chooses."""
        name = self.message.node_name
        return f"{self.message.node_namespace.rstrip('/')}/{name}" if name else ""

    @property
    def label(self) -> str:
        """What to call it in a log."""
        component = f"{self.message.package_name}/{self.message.plugin_name}"
        return self.full_name or self.declared_name or component

    @property
    def is_there(self) -> bool:
        """Whether it has a node with a unique_id."""
        return self.state in {NodeStatusState.LOADED, NodeStatusState.UNLOADING}

    @property
    def is_silent(self) -> bool:
        """Whether LoadNode was sent and is not answered."""
        return self.state is NodeStatusState.CONSTRUCTING and not self.is_answered

    def is_called(self, name: str) -> bool:
        """Whether a node of that name may be it."""
        if declared := self.declared_name:
            return name == declared
        return name.startswith(f"{self.message.node_namespace.rstrip('/')}/")

    def find(self, listed: Mapping[int, str], others: Collection[int]) -> list[int]:
        """Return the new nodes of its name; of a load without a name, the only new one."""
        found = [
            unique_id
            for unique_id, name in listed.items()
            if unique_id not in self.before
            and unique_id not in others
            and (name == self.full_name if self.full_name else self.is_called(name))
        ]
        is_certain = self.full_name or self.declared_name or len(found) == 1
        return sorted(found) if is_certain else []

    def status(self, container: Hello, now: float) -> NodeStatus:
        """Answer a query."""
        elapsed, used, note = 0.0, 0, ""
        if self.sent_at:
            elapsed = now - self.sent_at
            used = max(0, cpu_time_ns(container.pid) - self.cpu_time_ns)
        if self.is_silent:
            does = "lists other nodes only" if self.container_answers else "answers nothing"
            load = f" (pid {container.pid}, {used / 1e9:.1f} s on CPU since)"
            sender = f"the container{load if container.pid else ''}"
            note = f"LoadNode was sent and is not answered; {sender} {does} meanwhile"
        elif self.state is NodeStatusState.CONSTRUCTING:
            note = "LoadNode was answered; the container's list is to confirm it"
        return NodeStatus(
            unique_id=self.unique_id if self.is_there else 0,
            attempt=self.message.attempt,
            state=NodeStatusState.QUEUED if self.state is None else self.state,
            full_node_name=self.full_name,
            pid=container.pid,
            start_time=container.start_time,
            elapsed_ns=round(elapsed * 1e9),
            cpu_time_ns=used,
            note=note,
        )


def load_node_request(load: Load) -> Any:
    """Make a ``composition_interfaces/LoadNode`` request.

    Raises:
        EncodeError: When a value does not fit.
    """
    # Takes long; imported before by `StockContainers.of`.
    from composition_interfaces.srv import LoadNode  # noqa: PLC0415

    request = LoadNode.Request(check_fields=True)
    try:
        request.package_name = load.package_name
        request.plugin_name = load.plugin_name
        request.node_name = load.node_name
        request.node_namespace = load.node_namespace
        request.log_level = load.log_level
        request.remap_rules = list(load.remap_rules)
        request.parameters = [to_parameter_message(each) for each in load.parameters]
        request.extra_arguments = [to_parameter_message(each) for each in load.extra_arguments]
    except (AssertionError, TypeError, ValueError) as error:
        raise EncodeError(load, error) from error
    return request

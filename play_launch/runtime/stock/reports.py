"""What is reported about a stock container and its nodes, in the words of our own containers."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from play_launch.runtime.stock.composition_words import Stage
from play_launch.supervisor.events import ComponentEvent, ComponentEventKind
from play_launch.wire.messages import NodeStatus, NodeStatusState

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.runtime.stock.composition_words import Load as LoadRecord
    from play_launch.wire.messages import Load


@dataclass(frozen=True, slots=True, kw_only=True)
class ContainerIdentity:
    """The container itself; the pid is 0 where it was started by somebody else."""

    name: str
    pid: int = 0
    start_time: int = 0

    def cpu_time_ns(self) -> int:
        """CPU time that it has used so far, in nanoseconds; 0 where that is not known."""
        if not self.pid:
            return 0
        # Only a system with stock containers needs it.
        import psutil  # noqa: PLC0415

        try:
            used = psutil.Process(self.pid).cpu_times()
        except (psutil.Error, OSError):
            return 0
        return round((used.user + used.system) * 1e9)


@dataclass(slots=True)
class Request:
    """A load as it was asked of us, and since when the container has it."""

    load: Load
    message: object
    """The request for the service."""
    served_since: float | None = None
    """When it left the queue for the container, in seconds of the event loop's clock."""
    cpu_time_ns: int = 0
    """The container's, when it was sent."""
    container_answers: bool = False
    """Whether it answered another question since."""


class StockReports:
    """Makes events and answers; ``clock`` is the event loop's."""

    def __init__(self, container: ContainerIdentity, clock: Callable[[], float]) -> None:
        """Speak about this container."""
        self.container = container
        self._clock = clock

    def event(
        self,
        kind: ComponentEventKind,
        load: Load,
        *,
        unique_id: int = 0,
        full_name: str = "",
        message: str = "",
        confirmed_by: str = "",
    ) -> ComponentEvent:
        """Make an event about a node."""
        return ComponentEvent(
            stamp_ns=time.time_ns(),
            kind=kind,
            container=self.container.name,
            unique_id=unique_id,
            attempt=load.attempt,
            full_node_name=full_name,
            package_name=load.package_name,
            plugin_name=load.plugin_name,
            error_message=message,
            pid=self.container.pid,
            start_time=self.container.start_time,
            confirmed_by=confirmed_by,
        )

    def status(self, record: LoadRecord, request: Request) -> NodeStatus:
        """Say how far a load has come."""
        now, cpu = self._clock(), self.container.cpu_time_ns()
        elapsed = 0.0 if request.served_since is None else now - request.served_since
        used = max(0, cpu - request.cpu_time_ns) if request.served_since is not None else 0
        state, note = NodeStatusState.QUEUED, ""
        match record.stage:
            case Stage.SENT | Stage.SAID_LOADED | Stage.SAID_FAILED:
                state = NodeStatusState.CONSTRUCTING
                note = self._still_loading(record, request, elapsed, used)
            case Stage.LOADED:
                state = NodeStatusState.LOADED
            case Stage.UNLOADING:
                state = NodeStatusState.UNLOADING
            case Stage.QUEUED | Stage.NEXT:
                pass
        is_known = state in {NodeStatusState.LOADED, NodeStatusState.UNLOADING}
        return NodeStatus(
            unique_id=record.unique_id if is_known else 0,
            attempt=record.attempt,
            state=state,
            full_node_name=record.full_name,
            pid=self.container.pid,
            start_time=self.container.start_time,
            elapsed_ns=round(elapsed * 1e9),
            cpu_time_ns=used,
            note=note,
        )

    def _still_loading(
        self, record: LoadRecord, request: Request, elapsed: float, used: int
    ) -> str:
        if record.is_presumed:
            return "it seems to be there; the container's list is to confirm it"
        asked = f"LoadNode was sent {elapsed:.1f} s ago"
        if record.stage is not Stage.SENT:
            return f"{asked} and answered; the container's list is to confirm it"
        pid = self.container.pid
        load = f" (pid {pid}, {used / 1e9:.1f} s on CPU since)" if pid else ""
        if request.container_answers:
            return (
                f"{asked} and is not answered; the container{load} answers other questions and "
                "does not list it. It is not sent again, because it may still be constructed"
            )
        return f"{asked} and is not answered; the container{load} answers nothing meanwhile"

"""Actions on members and nodes of a running system: begun as inputs, and judged by their state."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from itertools import count
from typing import TYPE_CHECKING, Final

import anyio

from play_launch.config.model import Autostart
from play_launch.config.node_key import NodeKey
from play_launch.config.text import listed
from play_launch.control.messages import ActionResult, Results, SignalRequest
from play_launch.control.protocol import (
    COMMAND_LIMIT,
    Code,
    OperationError,
)
from play_launch.control.units import full_name, guests_of, meant, members_of, nodes_of
from play_launch.process.identity import NoSuchProcessError, ProcessHandle, ProcessIdentity
from play_launch.recording.resolved_form import redacted_arguments
from play_launch.supervisor.events import (
    ActionEvent,
    ActionPhase,
    ContainerState,
    ExpectationChanged,
    ManagedNodeChanged,
    ManagedState,
    NodeState,
    StateEvent,
    Withdrawn,
)
from play_launch.supervisor.view import has_ended_well

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable, Iterator, Mapping, Sequence

    from play_launch.control.feed import Feed, Numbered
    from play_launch.control.messages import ActionRequest, Caller, WaitRequest
    from play_launch.control.units import Target
    from play_launch.runtime.publisher import Publisher
    from play_launch.runtime.system import System
    from play_launch.supervisor.events import NodeStateChanged
    from play_launch.supervisor.expectations import Expectations
    from play_launch.supervisor.view import ContainerView

    Outcomes = dict[Target, str]


DONE: Final = ""
"""Outcome of an action on one unit; any other text is the reason why it failed."""
_REMOVED: Final = "it was taken out of the system"
"""By a configuration that was applied meanwhile."""
_STOPPING: Final = "the session is being stopped"
_REASON: Final = "a person asked for it"
_LISTED: Final = 10
_INACTIVE: Final = frozenset({ContainerState.STOPPED, ContainerState.GAVE_UP})
_LEFT: Final = frozenset(
    {
        NodeState.PENDING,
        NodeState.UNLOADED,
        NodeState.CRASHED,
        NodeState.GAVE_UP,
        NodeState.LOAD_FAILED,
        NodeState.LOST,
    }
)
_STATES: Final = StateEvent | ManagedNodeChanged | Withdrawn | ExpectationChanged
_NOT_LOADED: Final = frozenset({NodeState.LOAD_FAILED, NodeState.GAVE_UP, NodeState.UNLOADED})


class ActionLog:
    """Publishes the actions of a session, numbered."""

    def __init__(self, publisher: Publisher) -> None:
        self._publisher = publisher
        self._numbers = count(1)

    @contextlib.asynccontextmanager
    async def recorded(
        self, action: str, targets: Sequence[str], caller: Caller, details: str = ""
    ) -> AsyncIterator[None]:
        """Publish the request, and its result when the block ends; an exception is a failure.

        ``targets`` are full names of members and keys of nodes.
        """
        number, failure = next(self._numbers), ""

        def publish(phase: ActionPhase, reason: str) -> None:
            event = ActionEvent(
                stamp_ns=self._publisher.stamp_ns(),
                number=number,
                action=action,
                phase=phase,
                targets=tuple(targets),
                uid=caller.uid,
                pid=caller.pid,
                command=_one_line(caller.command),
                reason=reason,
            )
            self._publisher.publish(event)

        publish(ActionPhase.REQUESTED, details)
        try:
            yield
        except asyncio.CancelledError:
            failure = "the client disconnected first, or the session ended"
            raise
        except Exception as error:
            failure = str(error)
            raise
        finally:
            publish(ActionPhase.FAILED if failure else ActionPhase.DONE, failure)


class Actions:
    """Carries out actions, and waits for states. Belongs to the thread of the event loop."""

    def __init__(
        self,
        system: System,
        publisher: Publisher,
        feed: Feed,
        log: ActionLog,
        expectations: Expectations,
    ) -> None:
        self._system = system
        self._expectations = expectations
        self._publisher = publisher
        self._feed = feed
        self._log = log

    async def act(self, action: str, request: ActionRequest, caller: Caller) -> Results:
        targets = self._targets(action, request.names)
        self._refuse_if_stopping()
        number = _signal(request.signal) if isinstance(request, SignalRequest) else None
        if action in {"load", "reload"}:
            self._refuse_if_container_is_stopped(targets)
        names = [str(target) for target in targets]
        outcomes: Outcomes = {}
        details = number.name if number else ""
        async with self._log.recorded(action, names, caller, details):
            if number is not None:
                outcomes = {target: self._send_signal(target, number) for target in targets}
            else:
                carried_out = self._carry_out(action, targets, outcomes)
                await _within(request.timeout, carried_out, targets, outcomes)
            return _results_or_failure(targets, outcomes)

    async def wait(self, request: WaitRequest, _caller: Caller) -> Results:
        """Wait until all units are up at the same moment; raises OperationError when one fails."""
        named = self._targets("wait", request.names) if request.names else []
        self._refuse_if_stopping()
        targets = named or self._expected()
        outcomes: Outcomes = {}

        async def until_up() -> None:
            with self._state_changes() as changed:
                while True:
                    # Until then, members are stopped that will be replaced or removed.
                    await self._system.until_applied()
                    changed.clear()
                    targets[:] = named or self._expected()
                    outcomes.clear()
                    for target in targets:
                        outcome = self._is_up(target, activated=request.condition == "active")
                        if outcome != DONE and self._system.is_stopping:
                            outcome = _STOPPING
                        if outcome is not None:
                            outcomes[target] = outcome
                    is_awaited = request.condition == "expected" and self._expectations.unmet
                    is_done = len(outcomes) == len(targets) and not is_awaited
                    if is_done or any(outcomes.values()):
                        return
                    await changed.wait()

        await _within(request.timeout, until_up(), targets, outcomes, self._expectations)
        return _results_or_failure(targets, outcomes)

    def _expected(self) -> list[Target]:
        view = self._publisher.view
        expected = view.expected
        processes = [each for each in self._system.processes if each not in view.dismissed]
        return [*members_of(expected, processes), *nodes_of(expected)]

    def _targets(self, action: str, names: Sequence[str]) -> list[Target]:
        view = self._publisher.view
        members = members_of(view, self._system.processes)
        return meant(action, names, members, nodes_of(view), guests_of(view))

    def _refuse_if_stopping(self) -> None:
        if self._system.is_stopping:
            raise OperationError(Code.REFUSED, _STOPPING)

    def _refuse_if_container_is_stopped(self, targets: Sequence[Target]) -> None:
        for node in targets:
            assert isinstance(node, NodeKey)
            if self._system.state_of(node.container) in _INACTIVE:
                raise OperationError(
                    Code.REFUSED,
                    f"{node.name} cannot be loaded: {node.container} does not run; "
                    f"start {node.container} first",
                    name=node.name,
                )

    @contextlib.contextmanager
    def _state_changes(self) -> Iterator[asyncio.Event]:
        """Set an event whenever a state changes, while the block runs."""
        changed = asyncio.Event()

        def see(each: Numbered) -> None:
            if isinstance(each.event, _STATES):
                changed.set()

        with self._feed.followed_by(see):
            yield changed

    async def _carry_out(self, action: str, targets: Sequence[Target], outcomes: Outcomes) -> None:
        """Begin it for all units, and wait for the outcome of each; cancelled at the timeout."""
        gave_up = {each for each in targets if self._state(each) is ContainerState.GAVE_UP}
        with self._state_changes() as changed:
            for target in targets:
                try:
                    self._begin(action, target)
                except KeyError:  # a configuration without it was applied since it was chosen
                    outcomes[target] = _REMOVED
            if action == "stop":
                async with anyio.create_task_group() as tasks:
                    for target in targets:
                        tasks.start_soon(self._until_stopped, target, target in gave_up, outcomes)
            while True:
                for target in targets:
                    outcome = self._outcome(action, target)
                    if target not in outcomes and outcome is not None:
                        outcomes[target] = outcome
                if len(outcomes) == len(targets):
                    return
                await changed.wait()
                changed.clear()

    def _begin(self, action: str, target: Target) -> None:
        match action:
            case "start" | "load":
                self._system.start(target)
            case "stop" | "unload":
                self._system.stop(target, _REASON)
            case _:
                self._system.restart(target, _REASON)

    async def _until_stopped(self, target: Target, gave_up: bool, outcomes: Outcomes) -> None:
        """Wait until nothing is left of a member.

        That is not an event, and a change of the configuration may replace the member at once.
        """
        member, outcome = full_name(target), _REMOVED
        if self._state(member) is not None:
            state = await self._system.until_at_rest(member)
            reason = "" if gave_up else self._reason(member)
            if state is None:
                outcome = "it was started again meanwhile"
            else:
                outcome = DONE if state is ContainerState.STOPPED else reason
        outcomes[target] = outcome

    # Outcomes, from states alone: None while an action is under way.

    def _outcome(self, action: str, target: Target) -> str | None:
        if isinstance(target, str):
            return self._of_member(target)
        if action == "unload":
            found = self._node(target)
            return _REMOVED if found is None else DONE if found[1].state in _LEFT else None
        return self._of_node(target, _NOT_LOADED | {NodeState.CRASHED})

    def _is_up(self, target: Target, *, activated: bool) -> str | None:
        if isinstance(target, NodeKey):
            # A crashed node may be reloaded; if not, its state is GAVE_UP.
            outcome = self._of_node(target, _NOT_LOADED)
        else:
            process = self._publisher.view.processes.get(target)
            is_done = process is not None and has_ended_well(process)
            is_stopped = self._state(target) is ContainerState.STOPPED
            outcome = DONE if is_done and is_stopped else self._of_member(target)
        managed = self._system.config.managed.get(str(target))
        if not activated or outcome != DONE or managed is None:
            return outcome
        if managed.autostart is not Autostart.ACTIVATE:
            return outcome
        known = self._publisher.view.managed.get(str(target))
        if known is not None and known.state in {ManagedState.FAILED, ManagedState.FINALIZED}:
            return known.reason or f"it is {known.state}"
        return DONE if known is not None and known.state is ManagedState.ACTIVE else None

    def _of_member(self, member: str) -> str | None:
        state = self._state(member)
        if state is None:
            return _REMOVED
        if state in _INACTIVE:
            return self._reason(member) or f"it has {_ended(state)}"
        return DONE if state is ContainerState.RUNNING else None

    def _of_node(self, key: NodeKey, failed: frozenset[NodeState]) -> str | None:
        found = self._node(key)
        if found is None:
            return _REMOVED
        container, node = found
        if node.state is NodeState.LOADED:
            return DONE
        if container.state in _INACTIVE:
            return f"its container has {_ended(container.state)}"
        # Until its container is ready, its state is that of its last load.
        if container.state is ContainerState.RUNNING and node.state in failed:
            return node.reason or f"it is {node.state}"
        return None

    def _state(self, target: Target) -> ContainerState | None:
        """State of a member; None for a node, and for a member that was removed."""
        try:
            return self._system.state_of(target) if isinstance(target, str) else None
        except KeyError:
            return None

    def _node(self, key: NodeKey) -> tuple[ContainerView, NodeStateChanged] | None:
        container = self._publisher.view.containers.get(key.container)
        if container is None or key not in container.nodes:
            return None
        return container, container.nodes[key]

    def _reason(self, member: str) -> str:
        view = self._publisher.view
        if (container := view.containers.get(member)) is not None:
            return container.reason
        process = view.processes.get(member)
        return process.message if process else ""

    def _send_signal(self, target: Target, number: signal.Signals) -> str:
        view = self._publisher.view
        if isinstance(target, NodeKey):
            found = self._node(target)
            if found is None:
                return _REMOVED
            container, node = found
            is_own = container.process.pid and node.pid != container.process.pid
            pid, start_time = (node.pid, node.start_time) if is_own else (0, 0)
        else:
            if self._state(target) is None:
                return _REMOVED
            member = view.containers.get(target)
            process = member.process if member else view.processes.get(target)
            pid, start_time = (process.pid, process.start_time) if process else (0, 0)
        if not pid:
            return "it is not running as a separate process"
        if not start_time:
            return f"process {pid} is managed elsewhere (attached container)"
        try:
            with ProcessHandle.open(ProcessIdentity(pid, start_time)) as handle:
                is_sent = handle.send_signal(number)
        except NoSuchProcessError as error:
            return str(error)
        except OSError as error:
            return error.strerror or str(error)
        return DONE if is_sent else "it has just exited"


async def _within(
    limit: float,
    work: Awaitable[None],
    targets: Sequence[Target],
    outcomes: Outcomes,
    expectations: Expectations | None = None,
) -> None:
    """Await something for so many seconds; the OperationError names the units not done by then."""
    try:
        async with asyncio.timeout(limit):
            await work
    except TimeoutError:
        left = [full_name(target) for target in targets if target not in outcomes]
        if not left and expectations is not None:
            left = [
                f"{each.topic}: {each.reason or 'not known yet'}" for each in expectations.unmet
            ]
        raise OperationError(
            Code.TIMEOUT,
            f"not done within {limit:.3g} s: {listed(left, _LISTED)}",
            results=_results(targets, outcomes).results,
        ) from None


def _results_or_failure(targets: Sequence[Target], outcomes: Outcomes) -> Results:
    failed = [f"{full_name(each)}: {reason}" for each, reason in outcomes.items() if reason]
    found = _results(targets, outcomes)
    if failed:
        raise OperationError(Code.FAILED, "; ".join(failed), results=found.results)
    return found


def _results(targets: Sequence[Target], outcomes: Mapping[Target, str]) -> Results:
    return Results(
        tuple(
            ActionResult(
                name=full_name(target),
                container=target.container if isinstance(target, NodeKey) else None,
                done=outcomes[target] == DONE,
                reason=outcomes[target],
            )
            for target in targets
            if target in outcomes
        )
    )


def _ended(state: ContainerState) -> str:
    return "given up" if state is ContainerState.GAVE_UP else "stopped"


def _signal(found: str | int) -> signal.Signals:
    """Read ``SIGUSR1``, ``usr1`` or a number; raises OperationError."""
    try:
        if isinstance(found, int) or found.isdecimal():
            return signal.Signals(int(found))
        name = found.upper()
        return signal.Signals[name if name.startswith("SIG") else f"SIG{name}"]
    except (KeyError, ValueError):
        text = f"unknown signal {found!r:.80}; use a name such as SIGUSR1, or a number"
        raise OperationError(Code.BAD_ARGUMENTS, text) from None


def _one_line(command: Sequence[str]) -> str:
    """Write a command line as one line of text that can be recorded."""
    text = " ".join(" ".join(redacted_arguments(command)).split())
    return text[:COMMAND_LIMIT].encode("utf-8", "replace").decode()

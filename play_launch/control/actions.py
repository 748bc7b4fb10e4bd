"""Has members and nodes of a running system started, stopped, loaded; and says when that is done.

An action is an input of the member or node that it is about, like all else that happens to it. What
became of it is read from the state.
"""

from __future__ import annotations

import asyncio
import signal
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import anyio

from play_launch.config.node_key import NodeKey
from play_launch.config.policies import Autostart
from play_launch.control.outcome import (
    FOR_MEMBERS,
    FOR_NODES,
    Action,
    Verdict,
    managed_is_active,
    member_is_up,
    node_is_loaded,
    of_member,
    of_node,
    of_stop,
)
from play_launch.control.protocol import Code, ControlError, names_argument, seconds_argument
from play_launch.control.targets import chosen, full_name, members_of, nodes_of
from play_launch.control.waiting import changes_of_state, until_all_are, until_judged
from play_launch.process.identity import NoSuchProcessError, ProcessHandle, ProcessIdentity
from play_launch.supervisor.events import ContainerState

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Mapping, Sequence

    from play_launch.control.action_record import ActionRecords
    from play_launch.control.connection import Stream
    from play_launch.control.feed import Feed
    from play_launch.control.place import Peer
    from play_launch.control.targets import Target
    from play_launch.runtime.publisher import Publisher
    from play_launch.runtime.system import System
    from play_launch.supervisor.events import NodeState

USUAL_LIMIT: Final = 60.0
"""Seconds that an action may take where nobody says otherwise."""
_MOST_NAMED: Final = 10
_IN_STATE: Final = frozenset({ContainerState.STOPPED, ContainerState.GAVE_UP})

_TAKEN_OUT: Final = Verdict(is_done=False, reason="it was taken out of the system")
"""By a configuration that was applied meanwhile."""
_BEING_STOPPED: Final = Verdict(is_done=False, reason="the session is being stopped")


class Actions:
    """What can be done to one session. It belongs to the thread of the event loop."""

    def __init__(
        self, system: System, publisher: Publisher, feed: Feed, records: ActionRecords
    ) -> None:
        """Act on a system; its states come from publisher and feed."""
        self._system = system
        self._publisher = publisher
        self._feed = feed
        self._records = records

    async def act(
        self, action: Action, arguments: dict[str, Any], peer: Peer, _stream: Stream
    ) -> object:
        """Carry an action out; raises ControlError."""
        limit = seconds_argument(arguments, "timeout", USUAL_LIMIT)
        targets = self._targets(action, names_argument(arguments))
        self._refuse_if_stopping()
        number = signal_argument(arguments) if action is Action.SIGNAL else None
        self._refuse_if_senseless(action, targets)
        besides = "" if number is None else number.name
        names = [str(target) for target in targets]
        verdicts: dict[Target, Verdict] = {}
        async with self._records.recorded(action.value, names, peer, besides) as recorded:
            if number is not None:
                verdicts = {target: self._signal(target, number) for target in targets}
            else:
                await within(limit, self._carry_out(action, targets, verdicts), targets, verdicts)
            recorded.failure = failure_of(verdicts)
        return results_or_failure(targets, verdicts)

    async def wait(self, arguments: dict[str, Any], _peer: Peer, _stream: Stream) -> object:
        """Wait until members run and nodes are loaded, or active as well; raises ControlError."""
        match arguments.get("for", "loaded"):
            case "loaded":
                judge = self._is_up
            case "active":
                judge = self._is_active
            case other:
                raise ControlError(
                    Code.BAD_ARGUMENTS, f"for is loaded or active, not {other!r:.80}"
                )
        limit = seconds_argument(arguments, "timeout", USUAL_LIMIT)
        names = names_argument(arguments)
        named = self._targets(None, names) if names else []
        targets = named or self._expected()
        self._refuse_if_stopping()
        verdicts: dict[Target, Verdict] = {}

        def judged(target: Target) -> Verdict | None:
            verdict = judge(target)
            is_up = verdict is not None and verdict.is_done
            return _BEING_STOPPED if self._system.is_stopping and not is_up else verdict

        with changes_of_state(self._feed) as changed:
            waiting = until_all_are(
                lambda: named or self._expected(),
                judged,
                targets=targets,
                verdicts=verdicts,
                changed=changed,
                until_applied=self._system.until_applied,
            )
            await within(limit, waiting, targets, verdicts)
        return results_or_failure(targets, verdicts)

    def _expected(self) -> list[Target]:
        view = self._publisher.view
        expected = view.expected
        processes = [each for each in self._system.processes if each not in view.dismissed]
        return [*members_of(expected, processes), *nodes_of(expected)]

    def _refuse_if_stopping(self) -> None:
        if self._system.is_stopping:
            raise ControlError(Code.REFUSED, _BEING_STOPPED.reason)

    def _targets(self, action: Action | None, names: Sequence[str]) -> list[Target]:
        if not names:
            raise ControlError(Code.BAD_ARGUMENTS, f"{action} needs names or patterns")
        members = members_of(self._publisher.view, self._system.processes)
        nodes = nodes_of(self._publisher.view)
        if action in FOR_MEMBERS:
            hint = "is a composable node; use load, unload or reload"
            return chosen(names, members, nodes, hint)
        if action in FOR_NODES:
            hint = "is no composable node; use start, stop or restart"
            return chosen(names, nodes, members, hint)
        return chosen(names, [*members, *nodes])

    def _refuse_if_senseless(self, action: Action, targets: Sequence[Target]) -> None:
        if action not in {Action.LOAD, Action.RELOAD}:
            return
        for node in targets:
            assert isinstance(node, NodeKey)
            if self._system.state_of(node.container) in _IN_STATE:
                raise ControlError(
                    Code.REFUSED,
                    f"{node.container} does not run, so {node.name} cannot be loaded; "
                    f"start {node.container} first",
                    name=node.name,
                )

    async def _carry_out(
        self, action: Action, targets: Sequence[Target], verdicts: dict[Target, Verdict]
    ) -> None:
        """Begin it for all, and note what becomes of each; cancelled when it takes too long."""
        had_given_up: set[Target] = {
            target
            for target in targets
            if isinstance(target, str)
            and self._is_member(target)
            and self._system.state_of(target) is ContainerState.GAVE_UP
        }
        with changes_of_state(self._feed) as changed:
            for target in targets:
                try:
                    self._begin(action, target)
                except KeyError:  # since it was chosen, a configuration was applied without it
                    verdicts[target] = _TAKEN_OUT
            if action is Action.STOP:
                async with anyio.create_task_group() as ends:
                    for target in targets:
                        ends.start_soon(self._see_end_of, target, had_given_up, verdicts)
            judge = partial(self._judge, action)
            await until_judged(targets, judge, verdicts, changed)

    def _begin(self, action: Action, target: Target) -> None:
        reason = "a person asked for it"
        match action, target:
            case Action.START, str():
                self._system.start(target)
            case Action.STOP, str():
                self._system.stop(target, reason)
            case Action.RESTART, str():
                self._system.restart(target, reason)
            case Action.LOAD, NodeKey():
                self._system.load(target)
            case Action.UNLOAD, NodeKey():
                self._system.unload(target)
            case Action.RELOAD, NodeKey():
                self._system.reload(target)
            case _:
                raise AssertionError(action, target)

    def _judge(self, action: Action, target: Target) -> Verdict | None:
        if isinstance(target, NodeKey):
            return self._of_node(target, partial(of_node, action))
        if not self._is_member(target):
            return _TAKEN_OUT
        return of_member(self._system.state_of(target), reason=self._reason(target))

    async def _see_end_of(
        self, target: Target, had_given_up: set[Target], verdicts: dict[Target, Verdict]
    ) -> None:
        """Judge a stop when nothing of it is left.

        That is no event, and a configuration may put another one into its place at once.
        """
        member, verdict = full_name(target), _TAKEN_OUT
        if self._is_member(member):
            state = await self._system.until_at_rest(member)
            reason = "" if target in had_given_up else self._reason(member)
            verdict = of_stop(state, reason=reason)
        verdicts[target] = verdict

    def _is_up(self, target: Target) -> Verdict | None:
        if isinstance(target, NodeKey):
            return self._of_node(target, node_is_loaded)
        if not self._is_member(target):
            return _TAKEN_OUT
        process = self._publisher.view.processes.get(target)
        return member_is_up(
            self._system.state_of(target),
            ended_well=process is not None and process.ended_well,
            reason=self._reason(target),
        )

    def _is_active(self, target: Target) -> Verdict | None:
        """Judge whether it is up and, if it is to be brought there, active."""
        verdict, managed = self._is_up(target), self._system.config.managed.get(str(target))
        if verdict is None or not verdict.is_done or managed is None:
            return verdict
        if managed.autostart is not Autostart.ACTIVATE:
            return verdict
        known = self._publisher.view.managed.get(str(target))
        return managed_is_active(known.state, known.reason) if known else None

    def _of_node(
        self, key: NodeKey, judge: Callable[[NodeState, ContainerState, str], Verdict | None]
    ) -> Verdict | None:
        container = self._publisher.view.containers.get(key.container)
        node = None if container is None else container.nodes.get(key)
        if container is None or node is None:
            return _TAKEN_OUT
        return judge(node.state, container.state, node.reason)

    def _is_member(self, name: str) -> bool:
        return name in {*members_of(self._publisher.view, self._system.processes)}

    def _reason(self, member: str) -> str:
        view = self._publisher.view
        if (container := view.containers.get(member)) is not None:
            return container.reason
        process = view.processes.get(member)
        return process.message if process else ""

    def _signal(self, target: Target, number: signal.Signals) -> Verdict:
        found = self._process_of(target)
        if found is None:
            return _TAKEN_OUT
        pid, start_time = found
        if not pid:
            return Verdict(is_done=False, reason="it has no process of its own that runs")
        if not start_time:
            return Verdict(is_done=False, reason=f"its process {pid} is not ours")
        try:
            with ProcessHandle.open(ProcessIdentity(pid, start_time)) as handle:
                is_sent = handle.send_signal(number)
        except (NoSuchProcessError, OSError) as error:
            return Verdict(is_done=False, reason=str(error))
        return Verdict(is_sent, "" if is_sent else "it has just ended")

    def _process_of(self, target: Target) -> tuple[int, int] | None:
        """Give pid and start time, 0 where it has none; None: it is not there any more."""
        view = self._publisher.view
        if not isinstance(target, NodeKey) and not self._is_member(target):
            return None
        if isinstance(target, NodeKey):
            container = view.containers.get(target.container)
            node = None if container is None else container.nodes.get(target)
            if container is None or node is None:
                return None
            is_own = container.process.pid and node.pid != container.process.pid
            return (node.pid, node.start_time) if is_own else (0, 0)
        member = view.containers.get(target)
        process = view.processes.get(target) if member is None else member.process
        return (process.pid, process.start_time) if process else (0, 0)


async def within(
    limit: float,
    work: Coroutine[Any, Any, None],
    targets: Sequence[Target],
    verdicts: Mapping[Target, Verdict],
) -> None:
    """Do something in so many seconds; ControlError names what is not done by then."""
    try:
        async with asyncio.timeout(limit):
            await work
    except TimeoutError:
        left = [full_name(target) for target in targets if target not in verdicts]
        named = ", ".join(left[:_MOST_NAMED])
        more = f" and {len(left) - _MOST_NAMED} more" if len(left) > _MOST_NAMED else ""
        raise ControlError(
            Code.TIMEOUT,
            f"not done within {limit:.3g} s: {named}{more}",
            results=results(targets, verdicts),
        ) from None


def failure_of(verdicts: Mapping[Target, Verdict]) -> str:
    """Say what failed, and why; empty: nothing."""
    return "; ".join(
        f"{full_name(target)}: {verdict.reason}"
        for target, verdict in verdicts.items()
        if not verdict.is_done
    )


def results_or_failure(
    targets: Sequence[Target], verdicts: Mapping[Target, Verdict]
) -> dict[str, object]:
    """Give the result of an operation; ControlError when something failed."""
    if failure := failure_of(verdicts):
        raise ControlError(Code.FAILED, failure, results=results(targets, verdicts))
    return {"results": results(targets, verdicts)}


def results(
    targets: Sequence[Target], verdicts: Mapping[Target, Verdict]
) -> list[dict[str, object]]:
    """What became of each, in the order of the targets, for an answer."""
    return [
        {
            "name": full_name(target),
            "container": target.container if isinstance(target, NodeKey) else None,
            "done": verdicts[target].is_done,
            "reason": verdicts[target].reason,
        }
        for target in targets
        if target in verdicts
    ]


def signal_argument(arguments: dict[str, Any]) -> signal.Signals:
    """Read ``signal``: ``SIGUSR1``, ``usr1`` or a number; raises ControlError."""
    found = arguments.get("signal")
    try:
        if isinstance(found, int) and not isinstance(found, bool):
            return signal.Signals(found)
        if isinstance(found, str) and found.isdecimal():
            return signal.Signals(int(found))
        if isinstance(found, str):
            name = found.upper()
            return signal.Signals[name if name.startswith("SIG") else f"SIG{name}"]
    except (KeyError, ValueError):
        pass
    raise ControlError(
        Code.BAD_ARGUMENTS, f"{found!r:.80} is no signal; write a name such as SIGUSR1, or a number"
    )

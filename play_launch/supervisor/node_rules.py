"""Rules of composable nodes: when a fact holds, and what follows from it."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING, Final, assert_never

from msgspec.structs import replace

from play_launch.config.model import OnCrash
from play_launch.supervisor import process_rules, quarantine
from play_launch.supervisor.conditions import may_start
from play_launch.supervisor.events import NodeState
from play_launch.supervisor.inputs import Load, Unload
from play_launch.supervisor.outcome import Cause, Outcome, RestartHistory, Sequel, decide
from play_launch.supervisor.transitions import (
    AWAITED,
    IDLE,
    LOADING,
    Fact,
    NodeAction,
    NodeFact,
    next_state,
)
from play_launch.supervisor.world import Phase, Stage, is_wanted

if TYPE_CHECKING:
    from play_launch.config.node_key import NodeKey
    from play_launch.supervisor.inputs import HealthReported, NodeReported, ProbeResult
    from play_launch.supervisor.reducer import Reduction
    from play_launch.supervisor.world import Node, Process

TRUSTED: Final = {"stage": Stage.TRUSTED, "deaths": 0}
"""Values of a node that is not in quarantine."""
_REFUSABLE: Final = frozenset({NodeState.PENDING, NodeState.LOST, NodeState.LOAD_FAILED})


def reported(step: Reduction, said: NodeReported) -> None:
    """Apply a report to the node whose latest load it is about."""
    for node in step.world.nodes_of(said.unit):
        is_same = node.unique_id == said.unique_id
        if said.said is NodeFact.UNLOAD_REJECTED:
            is_meant = said.unique_id and is_same
        else:
            may_be = is_same or not said.unique_id or not node.unique_id
            is_meant = said.attempt and node.attempt == said.attempt and may_be
        if is_meant:
            _apply(step, node, said.said, said)
            return


def _apply(
    step: Reduction,
    before: Node,
    fact: NodeFact,
    said: NodeReported | None = None,
    *,
    reason: str = "",
    outcome: Outcome = Outcome(),  # noqa: B008 - immutable
) -> None:
    """Apply a fact to a node by the table; ``said`` is the report that it comes from, if any."""
    world, now = step.world, step.now
    state, actions = next_state(before, fact)
    node = replace(before, state=state)
    has_changed = state is not before.state
    if said is not None:
        node = _with_report(node, said, has_changed=has_changed)
    elif has_changed:
        node = replace(node, reason=reason, outcome=outcome, is_confirmed=False)
    if has_changed and state is NodeState.LOADED:
        other = node.full_node_name
        is_other = node.config.name and other not in {"", node.name}
        node = replace(
            node,
            loaded_at=now,
            took=now - node.sent_at,
            died_constructing="",
            has_renewed=False,
            is_confirmed=fact is NodeFact.STATUS_LOADED,
            # A component may ignore the name that it is given.
            reason=node.reason or (f"it calls itself {other}" if is_other else ""),
        )
    if said is not None and said.signal and before.loaded_at is None:
        node = replace(node, died_constructing=node.reason)
    if has_changed and fact is NodeFact.CRASHED:
        node = _crashed(step, before, node, said)
    is_slow = fact is NodeFact.STATUS_CONSTRUCTING and before.state in AWAITED
    if is_slow:
        node = replace(node, reports=node.reports + 1)
    if fact is NodeFact.UNLOADED and has_changed and not (node.reason or _is_asked(step, before)):
        node = replace(node, reason="not at the supervisor's request")
    limit = world.limits.report_interval if is_slow else step.container_of(node).loading_timeout
    world.put(node, query_at=now + limit if state in AWAITED else None)
    if before.state in LOADING and state not in LOADING and fact is not NodeFact.CONTAINER_LOST:
        # The container has survived it.
        world.put(step.node(node.key), **TRUSTED)
    if has_changed and state is NodeState.LOAD_FAILED and _renews(step, node, said):
        return
    for action in actions:
        node = step.node(node.key)
        match action:
            case NodeAction.LOAD:
                _load(step, replace(node, resent=False, reason=""))
            case NodeAction.LOAD_AGAIN:
                step.log(f"{node.name}: {node.key.container} does not know the load, sent anew")
                reason = "the container did not know the load; sent anew"
                _load(step, replace(node, resent=True, reason=reason))
            case NodeAction.QUERY:
                step.query(node)
            case NodeAction.CANCEL | NodeAction.UNLOAD:
                is_loading = action is NodeAction.CANCEL
                step.effects.append(Unload(node.key.container, node.unique_id, is_loading))
            case NodeAction.RESTART:
                _follow_crash(step, node)
            case _:
                assert_never(action)
    if is_slow:
        _check_for_lost_lock(step, step.node(node.key))


def _crashed(step: Reduction, before: Node, node: Node, said: NodeReported | None) -> Node:
    """Count a crash; a node that was killed at the end of a stop has not crashed."""
    if _is_asked(step, before) and said is not None and said.signal == signal.SIGKILL:
        node = replace(node, outcome=Outcome(Cause.STOP_TIMEOUT))
    is_crash = node.outcome.cause is not Cause.STOP_TIMEOUT
    return replace(node, crashes=node.crashes + is_crash, crashed_pid=node.pid)


def _with_report(node: Node, said: NodeReported, *, has_changed: bool) -> Node:
    values: dict[str, object] = {}
    if said.unique_id and not node.unique_id:
        values["unique_id"] = said.unique_id
    if said.pid:
        values |= {"pid": said.pid, "start_time": said.start_time}
    # A late answer does not replace the reason of a failure.
    is_slow = said.said is NodeFact.STATUS_CONSTRUCTING and node.state in AWAITED
    if has_changed or is_slow:
        values |= {
            "reason": said.reason,
            "outcome": Outcome(said.cause),
            "cpu_time_ns": said.cpu_time_ns,
            "full_node_name": said.full_node_name or node.full_node_name,
            "is_confirmed": False,
        }
    return replace(node, **values)


def _is_asked(step: Reduction, before: Node) -> bool:
    """Whether the end of a node was requested, alone or with its container."""
    container = step.process(before.key.container)
    is_stopping = container.stopped or container.phase is Phase.STOPPING
    return is_stopping or before.state is NodeState.UNLOADING


def _renews(step: Reduction, node: Node, said: NodeReported | None) -> bool:
    """Restart the container because of a failed load; whether it does.

    What a constructor that died had opened, such as a port, stays open in the container. One that
    dies again is not helped by that, and its neighbours are left alone.
    """
    container, config = step.process(node.key.container), step.container_of(node)
    shares = container.hello is not None and container.hello.mechanism == "shared_memory"
    helps = shares and not config.attach and config.restart.max_restarts > 0
    has_died = bool(node.died_constructing) and not node.has_renewed
    if (said and said.signal) or not has_died or not helps or not container.runs:
        return False
    died = f"its constructor died in this container before ({node.died_constructing})"
    reason = f"{node.name} cannot be loaded, and {died}: what it had opened stays open"
    reason = f"{reason}: {node.reason}"
    step.log(f"{container.name} is started anew: {reason}", is_shown_otherwise=True)
    outcome = node.outcome.followed_by(Sequel.CONTAINER_RESTART)
    why = f"{node.reason}; its container is started anew"
    step.world.put(node, has_renewed=True, reason=why, outcome=outcome)
    step.world.put(container, is_requested=True, request_reason=reason)
    return True


def _load(step: Reduction, node: Node) -> None:
    step.world.loads_made += 1
    container, attempt = step.process(node.key.container), step.world.loads_made
    step.world.put(
        node,
        attempt=attempt,
        loaded_into=container.attempt,
        **dict.fromkeys(("unique_id", "pid", "start_time"), 0),
        **dict.fromkeys(("loaded_at", "next_at", "wait", "blocked_since")),
        sent_at=step.now,
        query_at=step.now + step.container_of(node).loading_timeout,
        gives_up="",
        reloads=node.reloads + (node.is_reload and not node.resent),
    )
    step.effects.append(Load(node.key, attempt))


def _follow_crash(step: Reduction, node: Node) -> None:
    """Decide what follows from a crash or a failed reload: at once after a healthy life."""
    container, world, now = step.process(node.key.container), step.world, step.now
    is_first_load = node.state is NodeState.LOAD_FAILED and not node.is_reload
    if is_first_load or not container.runs or not is_wanted(world, node):
        return
    lived = 0.0 if node.loaded_at is None else now - node.loaded_at
    reason, outcome = node.reason, node.outcome
    node = replace(node, loaded_at=None)
    match node.config.on_crash:
        case OnCrash.RELOAD:
            limits, chance = replace(node.config.restart, first_at_once=True), step.chance
            history, verdict = decide(node.restarts, limits, now=now, lived=lived, jitter=chance)
            if isinstance(verdict, str):
                _give_up(step, replace(node, restarts=history), Sequel.GAVE_UP, verdict)
                return
            when = f"in {verdict:.2f} s" if verdict else "at once"
            world.put(
                node,
                restarts=history,
                reason=f"{reason}; it is loaded again {when}",
                next_at=now + verdict,
                outcome=outcome.followed_by(Sequel.RELOAD, verdict),
            )
        case OnCrash.IGNORE:
            world.put(node, reason=f"{reason}; it stays away")
        case OnCrash.STOP_CONTAINER:
            _give_up(step, node, Sequel.CONTAINER_STOP, "its container is stopped")
            why = f"{node.name} crashed: {reason}"
            process_rules.apply(step, container.name, Fact.STOP, why)
        case OnCrash.SHUTDOWN:
            after = outcome.followed_by(Sequel.SHUTDOWN)
            world.put(node, reason=f"{reason}; everything is stopped", outcome=after)
            process_rules.request_stop(step, f"{node.name} crashed: {reason}")


def _give_up(step: Reduction, node: Node, sequel: Sequel, why: str) -> None:
    """Have a node given up with the next turn, when its crash has been published."""
    outcome = node.outcome.followed_by(sequel)
    step.world.put(node, next_at=step.now, gives_up=f"{node.reason}; {why}", outcome=outcome)


def due(step: Reduction, key: NodeKey) -> None:
    """A node is loaded again, given up, or its container is queried, if it is time."""
    node = step.node(key)
    if node.next_at is not None and step.now >= node.next_at:
        now = step.world.put(node, next_at=None, gives_up="")
        if node.gives_up:
            _apply(step, now, NodeFact.GIVEN_UP, reason=node.gives_up, outcome=node.outcome)
        elif step.process(key.container).runs:
            _apply(step, replace(now, is_reload=True), NodeFact.LOAD)
    node = step.node(key)
    if node.query_at is not None and step.now >= node.query_at:
        _apply(step, node, NodeFact.SILENT)


# The container of nodes.


def container_requested(step: Reduction, container: Process) -> None:
    """Give all nodes a new chance: the container is started by an operator, or a change."""
    for node in step.world.nodes_of(container.name):
        is_requested = node.is_requested or node.state is NodeState.GAVE_UP
        history = RestartHistory(total=node.restarts.total)
        step.world.put(node, is_requested=is_requested, restarts=history, excused=0, **TRUSTED)


def container_stops(step: Reduction, container: Process) -> None:
    """Forget reloads that are due, and scratch processes, which end without a result."""
    for node in step.world.nodes_of(container.name):
        if node.next_at is not None and not node.gives_up:
            node = step.world.put(node, next_at=None)  # noqa: PLW2901
        if node.stage is Stage.PROBING:
            step.world.put(node, stage=Stage.CLEARED)


def container_lost(step: Reduction, container: Process, reason: str) -> None:
    outcome = Outcome(Cause.CONTAINER_EXITED, Sequel.NONE, 0, container.name)
    for before in step.world.nodes_of(container.name):
        values = {"gives_up": "", "died_constructing": "", "blocked_since": None}
        node = step.world.put(before, next_at=None, **values)
        why = f"its container: {reason}"
        _apply(step, node, NodeFact.CONTAINER_LOST, reason=why, outcome=outcome)


def refuse(step: Reduction, node: Node, reason: str, finding: ProbeResult | None = None) -> None:
    """Let a node fail that its container does not get; not one that it got meanwhile."""
    if node.state not in _REFUSABLE:
        return
    container = step.process(node.key.container)
    into = container.attempt if container.runs else node.loaded_into
    values = {"finding": finding, "wait": None, "loaded_into": into, "reason": reason}
    outcome, refusals = Outcome(Cause.REFUSED), node.refusals + 1
    node = step.world.put(node, refusals=refusals, outcome=outcome, **values)
    _apply(step, node, NodeFact.REFUSED, reason=reason, outcome=outcome)


def health(step: Reduction, said: HealthReported) -> None:
    """Judge what a container counted of its own troubles."""
    container, world = step.process(said.unit), step.world
    container = world.put(
        container,
        lost_locks=container.lost_locks or said.unquiesced > 0,
        is_leaking=container.is_leaking or said.leaked > 0,
    )
    if said.dead_locks:
        more = len(said.dead_locks) - 1
        waits = said.dead_locks[0] + (f" (and {more} more)" if more else "")
        holders = (each for each in world.nodes_of(said.unit) if said.lock_holder)
        culprits = [str(each.key) for each in holders if each.crashed_pid == said.lock_holder]
        is_hang = waits.startswith("/")  # the name of a node, not "thread"
        why = "the middleware hangs" if is_hang else "a node died with a lock"
        reason, culprit = f"{why}: {waits}", next(iter(culprits), "")
        process_rules.poisoned(step, container, reason, culprit)
    else:
        for node in world.nodes_of(said.unit):
            _check_for_lost_lock(step, node)
    for node in world.nodes_of(said.unit):
        _silence(step, node, said.silences.get(node.attempt, 0.0))


def _check_for_lost_lock(step: Reduction, node: Node) -> None:
    """Kill a container with a lock that a dead node left, if a load takes too long otherwise."""
    container, lasts = step.process(node.key.container), step.now - node.sent_at
    may_have = container.runs and container.lost_locks
    if not may_have or node.state not in LOADING or node.took is None:
        return
    limit = max(step.container_of(node).loading_timeout, 3 * node.took)
    if container.is_leaking:
        limit = min(limit, step.world.limits.reload_after_leak + 3 * node.took)
    if lasts >= limit:
        why = f"a dead node may have left a lock: {node.name} is not loaded again"
        process_rules.poisoned(step, container, f"{why}: {node.reason}".rstrip(": "))


def _silence(step: Reduction, node: Node, seconds: float) -> None:
    """Report once that an executor has been blocked for long, and that it is not any more."""
    is_loaded, since = node.state is NodeState.LOADED, node.blocked_since
    is_blocked = is_loaded and seconds >= step.world.limits.silence
    if is_blocked == (since is not None):
        return
    if not is_loaded:
        step.world.put(node, blocked_since=None)
        return
    if since is None:
        reason = f"its executor has been blocked in a callback for {seconds:.0f} s"
        values = {"blocked_since": step.now - seconds, "outcome": Outcome(Cause.BLOCKED)}
        step.log(f"{node.name}: {reason}")
    else:
        reason = f"its executor was blocked in a callback for {step.now - since:.0f} s, and goes on"
        values = {"blocked_since": None, "outcome": Outcome(Cause.RETURNED)}
    step.world.put(node, reason=reason, reports=node.reports + 1, **values)


# What is wanted against what is.


def is_due(node: Node, container: Process) -> bool:
    """Whether it was not loaded, nor refused, since its container was started."""
    can_load = node.state in IDLE and node.state is not NodeState.GAVE_UP
    return can_load and node.loaded_into != container.attempt


def settle(step: Reduction, key: NodeKey) -> None:
    """Begin what is wanted of a node and has not begun."""
    node, world = step.node(key), step.world
    if not is_wanted(world, node):
        _leave(step, node)
        return
    container = step.process(key.container)
    if node.wait is not None and not container.runs:
        node = world.put(node, wait=None)
    if node.is_requested:
        if node.state in IDLE:
            if container.runs:
                values: dict[str, object] = {"is_requested": False, "is_reload": False}
                values["released_at"] = step.now
                if node.stage is Stage.REFUSED:  # it stays requested if its container ends first
                    values["stage"] = Stage.CLEARED
                history = RestartHistory(total=node.restarts.total)
                _apply(step, replace(node, restarts=history, **values), NodeFact.LOAD)
        elif node.state is not NodeState.UNLOADING:
            _apply(step, node, NodeFact.LEAVE)
    elif container.runs and is_due(node, container):
        failure = may_start(step, node)
        if failure:
            refuse(step, step.node(key), failure)
        elif failure == "":
            if quarantine.may_load(world, step.node(key), step.now):
                _apply(step, replace(step.node(key), is_reload=False), NodeFact.LOAD)
            else:
                world.waiting.add(key)  # for the end of another's load


def _leave(step: Reduction, node: Node) -> None:
    if node.wait is not None or node.next_at is not None:
        node = step.world.put(node, wait=None, next_at=None, gives_up="")
    if node.state not in {NodeState.UNLOADING, NodeState.UNLOADED}:
        _apply(step, node, NodeFact.LEAVE)
        node = step.node(node.key)
    if node.is_removed and node.state in IDLE:
        step.world.forget(node)

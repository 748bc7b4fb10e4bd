"""Rules of containers and ordinary processes: when a fact holds, and what follows from it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.config.model import ContainerConfig, OnExit
from play_launch.supervisor import inputs, node_rules, quarantine
from play_launch.supervisor.conditions import may_start
from play_launch.supervisor.inputs import End, Kill, Spawn, Stop
from play_launch.supervisor.outcome import (
    CONTEXT_EXIT_CODE,
    PERMANENT_EXIT_CODES,
    Cause,
    Outcome,
    RestartHistory,
    Sequel,
    decide,
    outcome_of,
)
from play_launch.supervisor.transitions import EXITS, LOADING, PROCESS_TABLE, Fact
from play_launch.supervisor.world import INACTIVE, Node, Phase, Process, is_ours, is_wanted

if TYPE_CHECKING:
    from play_launch.supervisor.reducer import Reduction
    from play_launch.supervisor.world import World

_STUCK: Final = "does not die, not even of SIGKILL"
_NEVER_RAN: Final = frozenset({126, 127})
_OUTCOMES: Final = {
    Fact.STOP: Outcome(Cause.STOPPED),
    Fact.STUCK: Outcome(Cause.STOP_TIMEOUT, Sequel.GAVE_UP),
    Fact.FAILED: Outcome(sequel=Sequel.GAVE_UP),
}
_ENDED: Final = frozenset({*INACTIVE, Phase.BACKOFF})
_ACTIVE: Final = frozenset({Phase.SPAWNING, Phase.STARTING, Phase.RUNNING, Phase.KILLING})


def apply(
    step: Reduction,
    name: str,
    fact: Fact,
    reason: str = "",
    due: float | None = None,
    *,
    outcome: Outcome | None = None,
) -> None:
    """Apply a fact to a process by the table; ``due`` is the deadline of the new phase."""
    before = step.process(name)
    phase = PROCESS_TABLE[before.phase][fact] or before.phase
    if phase is not before.phase:
        outcome = outcome or _OUTCOMES.get(fact, Outcome())
        after = step.world.put(before, phase=phase, reason=reason, due=due, outcome=outcome)
        ends = fact in EXITS or phase is Phase.GAVE_UP
        if ends and before.phase is not Phase.STOPPING and before.config.on_exit is OnExit.SHUTDOWN:
            request_stop(step, f"{name} has ended")
        if phase is Phase.SPAWNING:
            _spawn(step, after)
        elif phase is Phase.KILLING:
            step.world.put(after, killed_because=reason, due=step.now + step.world.limits.kill)
            step.effects.append(Kill(name, after.attempt))
        elif phase in _ENDED and after.container is not None:
            node_rules.container_lost(step, after, reason)
        if before.phase is Phase.SPAWNING and fact in {Fact.STOP, Fact.FAILED}:
            # One that has just got a pid is stopped then.
            step.effects.append(Kill(name, after.attempt))
    # What still runs of one that failed is stopped in order, as is one that starts too late.
    is_late = fact is Fact.STARTED and phase is not Phase.STARTING
    if (fact is Fact.STOP and phase is Phase.STOPPING) or fact is Fact.FAILED or is_late:
        _stop(step, step.process(name), reason)


_OF_ATTEMPT: Final = {
    **dict.fromkeys(("pid", "start_time"), 0),
    **dict.fromkeys(("exit", "hello", "wait")),
    **dict.fromkeys(
        ("is_stuck", "stopped", "is_started", "is_fatal", "lost_locks", "is_leaking"), False
    ),
    "killed_because": "",
    "blames_loads": True,
}
"""Values of a process that begin anew with each start."""


def _spawn(step: Reduction, process: Process) -> None:
    step.world.starts_made += 1
    start = step.world.starts_made
    released_at = step.now if process.released_at is None else process.released_at
    values = {"attempt": start, "is_present": True, "began_at": step.now}
    step.world.put(process, released_at=released_at, **values, **_OF_ATTEMPT)
    step.effects.append(Spawn(process.name, start))


def _stop(step: Reduction, process: Process, reason: str) -> None:
    if process.container is not None:
        node_rules.container_stops(step, process)
    has_process = process.is_present and process.is_started
    if process.stopped or not has_process or process.exit is not None:
        return
    step.world.put(process, stopped=True, due=None)
    asks = process.hello is not None
    step.effects.append(Stop(process.name, process.attempt, asks, reason))


# Inputs.


def started(step: Reduction, said: inputs.Started) -> None:
    values = {"pid": said.pid, "start_time": said.start_time, "argv": said.argv}
    process = step.world.put(step.process(said.unit), is_started=True, **values)
    due = None
    config = process.container
    # An attached container may come at any time, and a debugger may take any time.
    if config is not None and not config.attach and not config.prefix:
        due = step.now + step.world.limits.hello
    apply(step, said.unit, Fact.STARTED, process.request_reason, due)
    if config is None and step.process(said.unit).phase is Phase.STARTING:
        apply(step, said.unit, Fact.READY)


def not_started(step: Reduction, said: inputs.NotStarted) -> None:
    process = step.world.put(step.process(said.unit), is_present=False)
    if process.phase not in {Phase.SPAWNING, Phase.STOPPING}:
        return  # what follows was decided before
    _exit(step, process, said.reason, would_repeat=said.is_permanent)


def greeted(step: Reduction, said: inputs.Greeted) -> None:
    process = step.process(said.unit)
    if process.phase is Phase.STARTING:
        step.world.put(process, hello=said.hello, began_at=step.now)
    apply(step, said.unit, Fact.READY)


def faulty(step: Reduction, said: inputs.Faulty) -> None:
    process = step.process(said.unit)
    if said.is_fatal and PROCESS_TABLE[process.phase][Fact.FAULTY]:
        step.world.put(process, is_fatal=True)
    apply(step, said.unit, Fact.FAULTY, said.reason, outcome=Outcome(said.cause))


def poisoned(step: Reduction, process: Process, reason: str, culprit: str = "") -> None:
    """Have a container restarted because of a node that died, so not one that is being loaded."""
    if process.phase is Phase.RUNNING:
        step.world.put(process, blames_loads=False)
    left_lock = Outcome(Cause.NODE_LEFT_LOCK, Sequel.NONE, 0, culprit)
    apply(step, process.name, Fact.FAULTY, reason, outcome=left_lock)


def exited(step: Reduction, said: inputs.Exited) -> None:
    process = step.process(said.unit)
    if process.exit is not None:
        return  # it was reported before
    is_stopping = process.phase is Phase.STOPPING or process.stopped
    is_killed = bool(process.killed_because)
    is_process = process.container is None
    ending = outcome_of(said.exit, is_requested=is_stopping, may_end=is_process)
    outcome = process.outcome if is_killed else ending
    values = {"exit": said.exit, "exit_cause": outcome.cause, "outcome": outcome}
    process = step.world.put(process, is_stuck=False, due=None, **values)
    if process.phase in INACTIVE or process.phase in {Phase.QUEUED, Phase.BACKOFF}:
        return  # what follows was decided before
    text, code = said.exit.text, said.exit.code
    because = f"{process.killed_because}; " if is_killed else ""
    if is_process and process.config.on_exit is not OnExit.RESTART:
        _exit(step, process, "", is_done=True)
    elif process.hello is not None and code == CONTEXT_EXIT_CODE:
        _exit(step, process, "a node shut its ROS context down", is_done=True)
    elif process.hello is None and code in (_NEVER_RAN if is_process else PERMANENT_EXIT_CODES):
        why = f"{because}{text}: {PERMANENT_EXIT_CODES[code]}"
        _exit(step, process, why, would_repeat=True)
    else:
        has_lived = is_process or process.hello is not None
        lived = step.now - process.began_at if has_lived else 0.0
        _exit(step, process, f"{because}{text}", lived=lived)


def cleaned_up(step: Reduction, said: inputs.CleanedUp) -> None:
    step.world.put(step.process(said.unit), is_present=False)


def unkillable(step: Reduction, said: inputs.Unkillable | Process) -> None:
    """Give a process up that lives on after its kill, or after the last signal of its stop."""
    process = said if isinstance(said, Process) else step.process(said.unit)
    if process.exit is None:
        step.world.put(process, is_stuck=True)
        apply(step, process.name, Fact.STUCK, _STUCK)


def failed(step: Reduction, said: inputs.Failed) -> None:
    if said.unit in step.world.processes:
        step.world.put(step.process(said.unit), wait=None)
        apply(step, said.unit, Fact.FAILED, said.reason)


def due(step: Reduction, name: str) -> None:
    """End the phase of a process whose deadline has passed."""
    process = step.process(name)
    if process.due is None or step.now < process.due:
        return
    process = step.world.put(process, due=None)
    if process.phase is Phase.STARTING:
        reason = f"it did not say hello within {step.world.limits.hello:g} s"
        apply(step, name, Fact.FAULTY, reason, outcome=Outcome(Cause.CHANNEL_FAILED))
    elif process.phase is Phase.KILLING:
        unkillable(step, process)
    elif process.phase is Phase.BACKOFF:
        apply(step, name, Fact.START)


def _exit(
    step: Reduction,
    process: Process,
    reason: str,
    *,
    would_repeat: bool = False,
    is_done: bool = False,
    lived: float = 0.0,
) -> None:
    """Decide what follows from an exit, or from a start that failed."""
    name, outcome = process.name, process.outcome
    was_stopped = process.phase is Phase.STOPPING
    ends_all = process.config.on_exit is OnExit.SHUTDOWN and not was_stopped
    # After a restart, its program may just be built anew.
    is_final = would_repeat and not process.restarts.streak
    is_final = is_final or (process.config.on_exit is not OnExit.RESTART and not is_done)
    done = outcome.followed_by(Sequel.SHUTDOWN) if ends_all else outcome
    gave_up = done if ends_all else outcome.followed_by(Sequel.GAVE_UP)
    if process.is_requested and is_wanted(step.world, process):
        apply(step, name, Fact.DONE, reason, outcome=outcome)  # it is started anew
    elif process.is_fatal or was_stopped or is_final:
        gave_up = outcome if was_stopped else gave_up
        apply(step, name, Fact.GIVE_UP, reason, outcome=gave_up)
    elif is_done:
        if reason:
            text = f"{name}: stopped, and is not started again: {reason}"
            step.log(text, is_shown_otherwise=True)
        apply(step, name, Fact.DONE, reason, outcome=done)
    else:
        _restart(step, process, reason, lived)


def _restart(step: Reduction, process: Process, reason: str, lived: float) -> None:
    world = step.world
    counts = not (
        is_ours(process) and process.blames_loads and quarantine.excuses_death(world, process.name)
    )
    limits, now = process.config.restart, step.now
    history, verdict = decide(
        process.restarts, limits, now=now, lived=lived, jitter=step.chance, counts=counts
    )
    process = world.put(process, restarts=history)
    if isinstance(verdict, str):
        outcome, text = process.outcome.followed_by(Sequel.GAVE_UP), f"{reason}; {verdict}"
        apply(step, process.name, Fact.GIVE_UP, text, outcome=outcome)
        return
    is_attached = process.container is not None and process.container.attach
    what = "looked for again" if is_attached else "starts again"
    text = f"{reason}; {what} in {verdict:.2f} s"
    nodes = world.nodes_of(process.name)
    under_way = [node.key for node in nodes if node.state in LOADING]
    outcome = process.outcome.followed_by(Sequel.RESTART, verdict)
    due = now + verdict
    apply(step, process.name, Fact.RESTART, text, due, outcome=outcome)
    if is_ours(process):
        blamed = under_way if process.blames_loads else ()
        quarantine.begin(step, process, blamed, reason)


def request_stop(step: Reduction, reason: str) -> None:
    """Request the stop of the whole system, once; it begins with the input that answers this."""
    if not step.world.is_ending and not step.world.is_stopping:
        step.world.is_ending = True
        step.effects.append(End(reason))


# What is wanted against what is.


def settle(step: Reduction, name: str) -> None:
    """Begin what is wanted of a process and has not begun."""
    process, world = step.process(name), step.world
    if not is_wanted(world, process):
        _settle_unwanted(step, process)
        return
    if process.is_requested:
        if process.phase in {Phase.SPAWNING, Phase.STARTING, Phase.RUNNING}:
            apply(step, name, Fact.STOP, process.request_reason)
        elif process.phase in {*INACTIVE, Phase.QUEUED, Phase.BACKOFF}:
            _begin(step, process)
    process = step.process(name)
    if process.phase is not Phase.QUEUED:
        return
    failure = may_start(step, process)
    if failure:
        refused = Outcome(Cause.REFUSED, Sequel.GAVE_UP)
        apply(step, name, Fact.GIVE_UP, failure, outcome=refused)
    elif failure == "" and not process.is_present and _has_slot(world, process):
        apply(step, name, Fact.TURN)


def _settle_unwanted(step: Reduction, process: Process) -> None:
    world = step.world
    reason = process.request_reason or world.stop_reason or ""
    before = world.stop_order.get(process.name, ()) if not world.is_hurried else ()
    waits = any(name in world.processes and not step.process(name).is_at_rest for name in before)
    if process.phase in {Phase.QUEUED, Phase.BACKOFF}:
        world.put(process, wait=None)
        apply(step, process.name, Fact.STOP, reason)
    elif process.phase in _ACTIVE and not waits:
        apply(step, process.name, Fact.STOP, reason)
    process = step.process(process.name)
    if process.is_removed and process.is_at_rest and not process.is_stuck:
        world.forget(process)


def _begin(step: Reduction, process: Process) -> None:
    if process.next_config is not None:
        if process.phase in {Phase.QUEUED, Phase.BACKOFF}:  # not once more as it was
            step.world.put(process, wait=None)
            apply(step, process.name, Fact.STOP, process.request_reason)
            process = step.process(process.name)
        if not process.is_at_rest or process.is_stuck:
            return
        process = _with_next_config(step, process)
    step.world.put(
        process,
        is_requested=False,
        restarts=RestartHistory(total=process.restarts.total),
        request_reason="",
    )
    node_rules.container_requested(step, process)
    apply(step, process.name, Fact.START)


def _with_next_config(step: Reduction, process: Process) -> Process:
    """Begin anew with the next configuration; nodes that it does not have are forgotten."""
    config, world = process.next_config, step.world
    assert config is not None
    before = {node.key: node for node in world.nodes_of(process.name)}
    for node in before.values():
        world.forget(node)
    for each in config.composable_nodes if isinstance(config, ContainerConfig) else ():
        was = before.get(each.key) or Node(config=each)
        # What was started once waits for no conditions.
        requested, released_at = was.is_requested, was.released_at
        world.put(Node(config=each, is_requested=requested, released_at=released_at))
    return world.put(process, config=config, next_config=None)


def _has_slot(world: World, process: Process) -> bool:
    if not process.takes_slot:
        return True
    phases = {Phase.SPAWNING, Phase.STARTING}
    starting = [each for each in world.processes.values() if each.phase in phases]
    return sum(each.takes_slot for each in starting) < world.starts

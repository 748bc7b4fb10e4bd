"""Rules of containers and ordinary processes: when a fact holds, and what follows from it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, assert_never

from msgspec.structs import replace

from play_launch.config.model import ContainerConfig, OnExit
from play_launch.supervisor import node_rules, quarantine
from play_launch.supervisor.conditions import readiness, report_wait
from play_launch.supervisor.inputs import End, Kill, Spawn, Stop
from play_launch.supervisor.outcome import (
    CONTEXT_EXIT_CODE,
    PERMANENT_EXIT_CODES,
    Cause,
    GiveUp,
    Outcome,
    RestartHistory,
    Sequel,
    decide,
    outcome_of,
)
from play_launch.supervisor.process_life import TABLE, Action, Fact
from play_launch.supervisor.world import (
    INACTIVE,
    Node,
    Phase,
    Process,
    is_ours,
    is_wanted,
)

if TYPE_CHECKING:
    from play_launch.supervisor.inputs import (
        CleanedUp,
        Exited,
        Faulty,
        Greeted,
        NotStarted,
        Started,
        Unkillable,
    )
    from play_launch.supervisor.reducer import Reduction
    from play_launch.supervisor.world import Exit

_STUCK: Final = "does not die, not even of SIGKILL"
_NEVER_RAN: Final = frozenset({126, 127})
_OUTCOMES: Final = {
    Fact.STOP: Outcome(Cause.STOPPED),
    Fact.STUCK: Outcome(Cause.STOP_TIMEOUT, Sequel.GAVE_UP),
    Fact.FAILED: Outcome(sequel=Sequel.GAVE_UP),
    Fact.IMPOSSIBLE: Outcome(Cause.REFUSED, Sequel.GAVE_UP),
}
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
    phase, actions = TABLE[before.phase][fact]
    if phase is not before.phase:
        outcome = outcome or _OUTCOMES.get(fact, Outcome())
        step.world.put(before, phase=phase, reason=reason, due=due, outcome=outcome)
        if phase is Phase.GAVE_UP and before.phase is not Phase.STOPPING:
            _end_all_with(step, before)
    for action in actions:
        process = step.process(name)
        match action:
            case Action.SPAWN:
                _spawn(step, process)
            case Action.CANCEL_SPAWN:
                step.effects.append(Kill(name, process.attempt))
            case Action.KILL:
                _kill(step, process, reason)
            case Action.STOP:
                _stop(step, process, reason)
            case Action.LOSE:
                if process.container is not None:
                    node_rules.container_lost(step, process, reason)
            case _:
                assert_never(action)


def _spawn(step: Reduction, process: Process) -> None:
    start = step.world.next_start()
    step.world.put(
        process,
        attempt=start,
        is_present=True,
        is_stuck=False,
        stopped=False,
        pid=0,
        start_time=0,
        is_started=False,
        exit=None,
        hello=None,
        ready_at=None,
        began_at=step.now,
        killed_because="",
        is_fatal=False,
        blames_loads=True,
        lost_locks=False,
        is_leaking=False,
        wait=None,
        released_at=step.now if process.released_at is None else process.released_at,
    )
    step.effects.append(Spawn(process.name, start))


def _kill(step: Reduction, process: Process, reason: str) -> None:
    due = step.now + step.world.limits.kill
    step.world.put(process, killed_because=reason, due=due)
    step.effects.append(Kill(process.name, process.attempt))


def _stop(step: Reduction, process: Process, reason: str) -> None:
    if process.container is not None:
        node_rules.container_stops(step, process)
    has_process = process.is_present and process.is_started
    if process.stopped or not has_process or process.exit is not None:
        return
    step.world.put(step.process(process.name), stopped=True, due=None)
    asks = process.container is not None and process.ready_at is not None
    step.effects.append(Stop(process.name, process.attempt, asks, reason))


# Inputs.


def started(step: Reduction, said: Started) -> None:
    process = step.process(said.unit)
    values = {"pid": said.pid, "start_time": said.start_time, "argv": said.argv}
    step.world.put(process, is_started=True, **values)
    due = None
    config = process.container
    # An attached container may come at any time, and a debugger may take any time.
    if config is not None and not config.attach and not config.prefix:
        due = step.now + step.world.limits.hello
    apply(step, said.unit, Fact.STARTED, process.request_reason, due)
    if config is None and step.process(said.unit).phase is Phase.STARTING:
        apply(step, said.unit, Fact.READY)


def not_started(step: Reduction, said: NotStarted) -> None:
    process = step.process(said.unit)
    step.world.put(process, is_present=False)
    if process.phase not in {Phase.SPAWNING, Phase.STOPPING}:
        return  # what follows was decided before
    respawns = process.container is not None or process.config.on_exit is OnExit.RESTART
    _exit(step, process.name, said.reason, is_permanent=said.is_permanent or not respawns)


def greeted(step: Reduction, said: Greeted) -> None:
    process = step.process(said.unit)
    if process.phase is Phase.STARTING:
        step.world.put(process, hello=said.hello, ready_at=step.now)
    apply(step, said.unit, Fact.READY)


def faulty(step: Reduction, said: Faulty) -> None:
    if said.is_fatal and TABLE[step.process(said.unit).phase][Fact.FAULTY].actions:
        step.world.put(step.process(said.unit), is_fatal=True)
    apply(step, said.unit, Fact.FAULTY, said.reason, outcome=Outcome(said.cause))


def poisoned(step: Reduction, process: Process, reason: str, culprit: str = "") -> None:
    """Have a container restarted because of a node that died, so not one that is being loaded."""
    if process.phase is Phase.RUNNING:
        step.world.put(process, blames_loads=False)
    left_lock = Outcome(Cause.NODE_LEFT_LOCK, Sequel.NONE, 0, culprit)
    apply(step, process.name, Fact.FAULTY, reason, outcome=left_lock)


def exited(step: Reduction, said: Exited) -> None:
    process = step.process(said.unit)
    if process.exit is not None:
        return  # it was reported before
    is_stopping = process.phase is Phase.STOPPING or process.stopped
    is_killed = bool(process.killed_because)
    outcome = process.outcome if is_killed else outcome_of(said.exit, is_requested=is_stopping)
    step.world.put(process, exit=said.exit, is_stuck=False, due=None, outcome=outcome)
    if process.phase in INACTIVE or process.phase in {Phase.QUEUED, Phase.BACKOFF}:
        return  # what follows was decided before
    if process.container is not None:
        _container_exited(step, step.process(said.unit), said.exit)
    else:
        _process_exited(step, step.process(said.unit), said.exit)


def _container_exited(step: Reduction, process: Process, exit_: Exit) -> None:
    because = f"{process.killed_because}; " if process.killed_because else ""
    if process.ready_at is None:
        again = PERMANENT_EXIT_CODES.get(exit_.code, "")
        reason = f"{exit_.text}: {again}" if again else exit_.text
        _exit(step, process.name, f"{because}{reason}", is_permanent=bool(again))
    elif exit_.code == CONTEXT_EXIT_CODE:
        _exit(step, process.name, "a node shut its ROS context down", is_done=True)
    else:
        lived = step.now - process.ready_at
        _exit(step, process.name, f"{because}{exit_.text}", lived=lived)


def _process_exited(step: Reduction, process: Process, exit_: Exit) -> None:
    lived = step.now - process.began_at
    if process.config.on_exit is not OnExit.RESTART:
        _exit(step, process.name, "", is_done=True, lived=lived)
    elif exit_.code in _NEVER_RAN:
        reason = f"{exit_.text}: {PERMANENT_EXIT_CODES[exit_.code]}"
        _exit(step, process.name, reason, is_permanent=True)
    else:
        _exit(step, process.name, exit_.text, lived=lived)


def cleaned_up(step: Reduction, said: CleanedUp) -> None:
    step.world.put(step.process(said.unit), is_present=False)


def unkillable(step: Reduction, said: Unkillable) -> None:
    process = step.process(said.unit)
    if process.exit is None:
        step.world.put(process, is_stuck=True)
        apply(step, said.unit, Fact.STUCK, _STUCK)


def failed(step: Reduction, unit: str, reason: str) -> None:
    """The supervisor's own code for a process failed: it is given up, and stopped in order."""
    step.world.put(step.process(unit), wait=None)
    apply(step, unit, Fact.FAILED, reason)


def due(step: Reduction, name: str) -> None:
    """End the phase of a process whose deadline has passed."""
    process = step.process(name)
    if process.due is None or step.now < process.due:
        return
    step.world.put(process, due=None)
    match process.phase:
        case Phase.STARTING:
            limit = step.world.limits.hello
            reason = f"it did not say hello within {limit:g} s"
            apply(step, name, Fact.FAULTY, reason, outcome=Outcome(Cause.CHANNEL_FAILED))
        case Phase.KILLING:
            step.world.put(step.process(name), is_stuck=True)
            apply(step, name, Fact.STUCK, _STUCK)
        case Phase.BACKOFF:
            apply(step, name, Fact.RESTART_DUE)
        case _:
            pass


def _exit(
    step: Reduction,
    name: str,
    reason: str,
    *,
    is_permanent: bool = False,
    is_done: bool = False,
    lived: float = 0.0,
) -> None:
    """Decide what follows from an exit, or from a start that failed."""
    process = step.process(name)
    was_stopped = process.phase is Phase.STOPPING
    ends_all = process.config.on_exit is OnExit.SHUTDOWN and not was_stopped
    # Another start would only be in the way of the end.
    is_permanent = is_permanent or (ends_all and not is_done and process.container is not None)
    outcome = process.outcome
    done = outcome.followed_by(Sequel.SHUTDOWN) if ends_all else outcome
    gave_up = done if ends_all else outcome.followed_by(Sequel.GAVE_UP)
    if process.generation > process.attempted and is_wanted(step.world, process):
        apply(step, name, Fact.EXITED_DONE, reason, outcome=outcome)  # it is started anew
    elif process.is_fatal or was_stopped or is_permanent:
        gave_up = outcome if was_stopped else gave_up
        apply(step, name, Fact.EXITED_GIVE_UP, reason, outcome=gave_up)
    elif is_done:
        if reason:
            text = f"{name}: stopped, and is not started again: {reason}"
            step.log(text, is_shown_otherwise=True)
        apply(step, name, Fact.EXITED_DONE, reason, outcome=done)
    else:
        _restart(step, process, reason, lived)
    if not was_stopped:
        _end_all_with(step, process)


def _end_all_with(step: Reduction, process: Process) -> None:
    if process.config.on_exit is OnExit.SHUTDOWN:
        request_stop(step, f"{process.name} has ended")


def _restart(step: Reduction, process: Process, reason: str, lived: float) -> None:
    world = step.world
    counts = not (
        is_ours(process) and process.blames_loads and quarantine.excuses_death(world, process.name)
    )
    history, verdict = decide(
        process.restarts,
        process.config.restart,
        now=step.now,
        lived=lived,
        jitter=step.chance,
        counts=counts,
    )
    world.put(step.process(process.name), restarts=history)
    if isinstance(verdict, GiveUp):
        outcome, text = process.outcome.followed_by(Sequel.GAVE_UP), f"{reason}; {verdict.reason}"
        apply(step, process.name, Fact.EXITED_GIVE_UP, text, outcome=outcome)
        return
    attached = process.container is not None and process.container.attach
    what = "looked for again" if attached else "starts again"
    text = f"{reason}; {what} in {verdict.delay:.2f} s"
    under_way = node_rules.under_way(world, process.name)
    outcome = process.outcome.followed_by(Sequel.RESTART, verdict.delay)
    due = step.now + verdict.delay
    apply(step, process.name, Fact.EXITED_RESTART, text, due, outcome=outcome)
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
    process = step.process(name)
    world = step.world
    if not is_wanted(world, process):
        _settle_unwanted(step, process)
        return
    if process.generation > process.attempted:
        if process.phase in {Phase.SPAWNING, Phase.STARTING, Phase.RUNNING}:
            apply(step, name, Fact.STOP, process.request_reason)
        elif TABLE[process.phase][Fact.START].phase is Phase.QUEUED:
            _begin(step, process)
    process = step.process(name)
    if process.phase is Phase.QUEUED:
        _queue(step, process)


def _settle_unwanted(step: Reduction, process: Process) -> None:
    world = step.world
    reason = process.request_reason or world.stop_reason or ""
    if process.phase in {Phase.QUEUED, Phase.BACKOFF}:
        world.put(process, wait=None)
        apply(step, process.name, Fact.STOP, reason)
    elif process.phase in _ACTIVE and _may_stop(step, process):
        apply(step, process.name, Fact.STOP, reason)
    process = step.process(process.name)
    if process.is_removed and process.is_at_rest and not process.is_stuck:
        world.forget(process)


def _may_stop(step: Reduction, process: Process) -> bool:
    world = step.world
    if not world.is_stopping or world.is_hurried:
        return True
    return all(
        world.processes[other].is_at_rest
        for other in world.stop_order.get(process.name, ())
        if other in world.processes
    )


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
        attempted=process.generation,
        restarts=RestartHistory(total=process.restarts.total),
        request_reason="",
    )
    apply(step, process.name, Fact.START)


def _with_next_config(step: Reduction, process: Process) -> Process:
    """Begin anew with the next configuration; nodes that it does not have are forgotten."""
    config, world = process.next_config, step.world
    assert config is not None
    # What was started once waits for no conditions.
    released = {node.key: node.released_at for node in world.nodes_of(process.name)}
    asked = [each.key for each in world.nodes_of(process.name) if each.generation > each.attempted]
    for node in world.nodes_of(process.name):
        world.forget(node)
    if isinstance(config, ContainerConfig):
        for each in config.composable_nodes:
            is_asked = int(each.key in asked)
            released_at = released.get(each.key)
            world.put(Node(config=each, generation=is_asked, released_at=released_at))
    anew = Process(config=config, generation=process.generation, attempt=process.attempt)
    anew = replace(anew, released_at=process.released_at)
    world.put(replace(anew, phase=process.phase, reason=process.reason))
    return step.process(process.name)


def _queue(step: Reduction, process: Process) -> None:
    world, before = step.world, process.wait
    ready = readiness(world, process, step.now)
    if ready.failure:
        world.put(process, wait=None)
        apply(step, process.name, Fact.IMPOSSIBLE, ready.failure)
        return
    if not ready.may_start:
        assert ready.wait is not None
        world.put(process, wait=report_wait(step, process.name, before, ready.wait))
        return
    if ready.wait is not None:
        if ready.wait.waived:
            step.log(f"{process.name} starts all the same: {ready.wait.waived}")
        world.put(process, wait=None, released_at=step.now)
    elif before is not None:  # its conditions are gone
        world.put(process, wait=None)
    process = step.process(process.name)
    if not process.is_present and _has_slot(step, process):
        apply(step, process.name, Fact.TURN)


def _has_slot(step: Reduction, process: Process) -> bool:
    if not _takes_slot(process):
        return True
    starting = {Phase.SPAWNING, Phase.STARTING}
    others = step.world.processes.values()
    return sum(each.phase in starting and _takes_slot(each) for each in others) < step.world.starts


def _takes_slot(process: Process) -> bool:
    config = process.container
    # Waiting for a container that something else starts takes no slot.
    return config is not None and not config.attach

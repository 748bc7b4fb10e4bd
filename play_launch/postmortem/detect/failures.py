"""Units that failed: crashes, exits, failed loads, kills, slow constructors, restart loops."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.config.text import duration
from play_launch.postmortem.critical_chain import left_behind
from play_launch.postmortem.findings import DeclaredPlace, Finding
from play_launch.postmortem.known_causes import known_cause, uncaught
from play_launch.postmortem.units import Downtime, Fault
from play_launch.supervisor.events import MachineState
from play_launch.supervisor.frames import blamed
from play_launch.supervisor.outcome import Cause, Sequel

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from play_launch.postmortem.timeline import Timeline
    from play_launch.postmortem.units import Failure

_MANY: Final = 8
"""Delays that are listed."""


class _FailureText(NamedTuple):
    rank: int
    says: str


_WORDS: Final = {
    Fault.CRASHED: _FailureText(0, "crashed {when}"),
    Fault.DIED: _FailureText(0, "died {when}"),
    Fault.LOAD_FAILED: _FailureText(0, "failed to load {when}"),
    Fault.KILLED: _FailureText(0, "was killed by play-launch {when}"),
    Fault.NOT_BROUGHT_UP: _FailureText(0, "was not brought up as a managed node {when}"),
    Fault.STOP_TIMEOUT: _FailureText(4, "did not stop when it was asked to and was killed {when}"),
    Fault.SLOW: _FailureText(5, "was slow to construct: it was not ready at {at}"),
}
_IN_CONSTRUCTOR: Final = "crashed in its constructor {when}"
_DID: Final = {
    Sequel.RELOAD: "reloaded",
    Sequel.RESTART: "restarted",
    Sequel.GAVE_UP: "gave up",
    Sequel.CONTAINER_RESTART: "its container was restarted",
    Sequel.CONTAINER_STOP: "its container was stopped",
    Sequel.SHUTDOWN: "everything was stopped",
}
_FAILURES: Final = 5
_WITHIN: Final = 60_000_000_000
"""Nanoseconds for so many."""
_ENDS: Final = frozenset({Fault.CRASHED, Fault.DIED, Fault.KILLED})
_SOON: Final = 1_000_000_000
"""Nanoseconds from the request of a signal to an end that it caused."""


def detect(timeline: Timeline) -> Iterator[Finding]:
    yield from _failed(timeline)
    yield from _blocked(timeline)
    yield from _looping(timeline)
    yield from _machines(timeline)


def _failed(timeline: Timeline) -> Iterator[Finding]:
    behind = left_behind(timeline)
    for each in timeline.failures:
        rank, says = _WORDS[each.fault]
        if each.fault is Fault.LOAD_FAILED and each.is_crash:
            says = _IN_CONSTRUCTOR
        number = blamed(each.frames)
        cause, exception = each.cause, uncaught(each.cause, each.last_lines)
        if exception is not None:
            cause = f"{cause}; uncaught exception {exception.text}"
        place = DeclaredPlace(
            frame=None if number is None else each.frames[number],
            line=exception.line if exception else None,
            plugin=each.plugin,
            package=each.package,
            container=each.container,
        )
        is_oom, is_slow = each.code is Cause.OUT_OF_MEMORY, each.fault is Fault.SLOW
        took = f"; it took {duration(each.away[-1].ns or 0)}" if is_slow and each.away else ""
        yield Finding(
            kind=each.fault.value,
            rank=rank,
            says=says,
            name=each.name,
            key=each.key,
            times_ns=tuple(each.times),
            cause=cause + took + _request(timeline, each),
            known="out_of_memory" if is_oom else known_cause(cause, each.last_lines),
            place=place,
            frames=each.frames,
            modules=each.modules,
            signature=each.signature,
            is_crash=each.is_crash,
            state=each.state,
            since_ns=each.since_ns,
            last_lines=each.last_lines,
            parameters=each.parameters,
            before=each.before,
            hit=(*each.hit, *behind.get(each.key, ())),
            done=tuple(_done(each.sequels)),
            away=() if is_slow else tuple(each.away),
        )


def _request(timeline: Timeline, failure: Failure) -> str:
    """Say which operator sent a signal to a unit that ended then."""
    for at_ns, request in timeline.requests if failure.fault in _ENDS else ():
        is_near = 0 <= failure.log_time - at_ns <= _SOON
        if is_near and request.action == "signal" and failure.key in request.targets:
            by = f"user {request.uid}, pid {request.pid}: {request.command}"
            return f"; an operator sent {request.reason} ({by})"
    return ""


def _done(sequels: Mapping[tuple[Sequel, int], str]) -> Iterator[str]:
    """Word what the supervisor did: ``reloaded immediately, after 30 ms``."""
    for sequel, words in _DID.items():
        found = [(delay, reason) for (each, delay), reason in sequels.items() if each is sequel]
        if not found:
            continue
        reasons = [reason for _, reason in found if reason]
        if reasons:
            yield f"{words}: {reasons[0]}" if sequel is Sequel.GAVE_UP else reasons[0]
        elif sequel in {Sequel.RELOAD, Sequel.RESTART}:
            delays = list(dict.fromkeys(_after(delay) for delay, _ in found))
            more = f" and {len(delays) - _MANY} more" if len(delays) > _MANY else ""
            yield f"{words} {', '.join(delays[:_MANY])}{more}"
        else:
            yield words


def _after(delay_ns: int) -> str:
    return f"after {duration(delay_ns)}" if delay_ns else "immediately"


def _blocked(timeline: Timeline) -> Iterator[Finding]:
    """Report executors that did not leave a callback; it is a failure if one never did."""
    end_ns = timeline.session.reader.end
    for unit in timeline.units:
        if not unit.blocks:
            continue
        worst = max(unit.blocks, key=lambda block: (not block.has_returned, block.lasted(end_ns)))
        took = duration(worst.lasted(end_ns))
        ended = "it returned" if worst.has_returned else "it had not returned"
        yield Finding(
            kind="blocked",
            rank=3,
            is_failure=not worst.has_returned,
            says="was blocked in a callback {when}",
            name=unit.name,
            key=unit.key,
            times_ns=tuple(block.at_ns for block in unit.blocks),
            cause=f"one callback kept its executor from everything else; {ended} after {took}",
            place=DeclaredPlace(container=unit.container),
            last_lines=unit.blocks[0].last_lines,
        )


def _looping(timeline: Timeline) -> Iterator[Finding]:
    times: dict[str, list[int]] = {}
    units = {unit.key: unit for unit in timeline.units}
    for each in timeline.failures:
        if each.fault in _ENDS:
            times.setdefault(each.key, []).extend(each.times)
    for key, every in times.items():
        every.sort()
        loops = (
            begin
            for begin, end in zip(every, every[_FAILURES - 1 :], strict=False)
            if end - begin <= _WITHIN
        )
        first = next(loops, None)
        if first is None:
            continue
        unit = units[key]
        count = sum(first <= at <= first + _WITHIN for at in every)
        lasted = max(at for at in every if at <= first + _WITHIN) - first
        yield Finding(
            kind="restart_loop",
            rank=2,
            says="was restarted in a loop, from {at} on",
            name=unit.name,
            key=key,
            times_ns=(first,),
            cause=f"it failed {count} times within {duration(lasted)}",
            place=DeclaredPlace(container=unit.container),
        )


def _machines(timeline: Timeline) -> Iterator[Finding]:
    """Report machines that were lost, killed supervisors, and machines whose part failed."""
    for name, changes in timeline.machines.items():
        ends = [*changes[1:], None]
        for state, kind, says in (
            (MachineState.UNREACHABLE, "machine_lost", "could not be reached {when}"),
            (MachineState.STARTING, "machine_restarted", "was started again {when}"),
            (MachineState.FAILED, "machine_failed", "could not be used {when}"),
        ):
            found = [
                (each, end)
                for each, end in zip(changes, ends, strict=True)
                # The first start is wanted, and has no reason.
                if each.state is state and (each.reason or state is not MachineState.STARTING)
            ]
            if found:
                yield Finding(
                    kind=kind,
                    rank=2,
                    says=says,
                    name=f"machine {name}",
                    times_ns=tuple(each.stamp_ns for each, _ in found),
                    cause=found[0][0].reason,
                    away=tuple(
                        Downtime(name, end.stamp_ns - each.stamp_ns if end else None)
                        for each, end in found
                    ),
                )

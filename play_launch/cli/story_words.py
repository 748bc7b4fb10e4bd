"""What findings say to a person: plain sentences, the most important first."""

from __future__ import annotations

from textwrap import shorten
from typing import TYPE_CHECKING, Final

from play_launch.cli.output import counted, duration
from play_launch.postmortem.findings import Finding, Kind, Quantity, Trend, is_crash
from play_launch.postmortem.frames import plain_function
from play_launch.postmortem.known_causes import BY_NAME, known_by
from play_launch.postmortem.parameters import is_of_the_node, shortened

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from play_launch.postmortem.findings import Away, Place
    from play_launch.postmortem.parameters import Changed, ParametersOfALife
    from play_launch.postmortem.session import PastSession

_SECOND: Final = 1_000_000_000
_MANY: Final = 8
"""Names that are listed; of more, their number."""
_IN_FULL: Final = 5
"""Findings with all that is known about them; the first ones explain most."""
_IN_SHORT: Final = 2
"""Lines of the others, below their headlines: cause and place."""
_BRIEF: Final = 50_000_000
"""Nanoseconds in a state that are not worth a sentence, if it were fewer."""
_FRAMES: Final = 12
"""Frames of a backtrace that are shown."""
_CHANGES: Final = 3
"""Changes of parameters that are shown, the latest ones."""
_LONGEST_VALUE: Final = 40
"""Characters of a parameter's value."""

_HAPPENED: Final = {
    Kind.CRASHED: "crashed",
    Kind.DIED: "died",
    Kind.LOAD_FAILED: "failed to load",
    Kind.KILLED: "was killed by play-launch",
    Kind.INTERRUPTED: "The recording was interrupted",
    Kind.DISK_FULL: "The recording ends on a full disk",
    Kind.DEAF: "did not stop when it was asked to and was killed",
}
"""What can be said of a moment; for others see `headline`."""
_NUMBERS: Final = {
    Quantity.MEMORY: "memory",
    Quantity.THREADS: "number of threads",
    Quantity.DESCRIPTORS: "number of open files",
    Quantity.FREE_MEMORY: "free memory of the machine",
    Quantity.FREE_DISK: "free space on the disk of the recording",
}
_BYTES: Final = frozenset({Quantity.MEMORY, Quantity.FREE_MEMORY, Quantity.FREE_DISK})


def paragraphs(findings: Sequence[Finding], session: PastSession) -> Iterator[str]:
    """Give the lines of the whole story."""
    started = session.started_ns
    for number, finding in enumerate(findings):
        lines = list(details(finding))
        yield headline(finding, started)
        yield from (f"  {line}" for line in lines[: None if number < _IN_FULL else _IN_SHORT])
        yield ""
    if len(findings) > _IN_FULL:
        yield f"The first {_IN_FULL} are in full here; all are with --json."
    yield _summary(findings, session)


def headline(finding: Finding, started_ns: int) -> str:
    """Subject, event, count, time: ``/talker in /box crashed 3 times, first at 0.636 s``."""
    at = f"{round((finding.at_ns - started_ns) / _SECOND, 3) + 0.0:.3f} s"  # no -0.000
    times = len(finding.times_ns)
    at += " after the start"
    when = f"at {at}" if times == 1 else f"{times} times, first at {at}"
    inside = f" in {finding.place.container}" if finding.place.container else ""
    who = f"{finding.who}{inside} " if finding.who else ""
    match finding.kind:
        case Kind.UNFINISHED:
            return (
                f"The recording is incomplete and ends {at}: play-launch was killed, or still runs."
            )
        case Kind.NOT_LOADED:
            what = "not loaded again" if finding.state == "lost" else "never loaded"
            return f"{who}was {what}: it was {finding.state} since {at}."
        case Kind.SLOW:
            return f"{who}was slow to construct: it was not ready at {at}."
        case Kind.GREW:
            return f"{who}kept growing, from {at} to the end."
        case Kind.STARVED:
            often = ", " if times == 1 else f" {times} times, first "
            return f"{who}starved others of CPU time{often}from {at} on."
        case Kind.LOAD_FAILED if is_crash(finding.kind, finding.signature):
            return f"{who}crashed in its constructor {when}."
        case _:
            return f"{who}{_HAPPENED[finding.kind]} {when}."


def details(finding: Finding) -> Iterator[str]:
    """Give the lines that follow: cause, place, fix, what was before and what came of it."""
    if cause := _cause(finding):
        yield f"Cause: {cause}."
    if place := _place(finding.place):
        yield f"Place: {place}."
    yield from (f"{problem[0].upper()}{problem[1:]}." for problem in finding.problems)
    known = BY_NAME.get(finding.known)
    if known is not None and known.fix:
        yield f"Fix: {known.fix}."
    if finding.since_ns and finding.at_ns - finding.since_ns >= _BRIEF:
        state = "in its constructor" if finding.state == "loading" else finding.state
        yield f"Before, it was {state} for {duration(finding.at_ns - finding.since_ns)}."
    if finding.kind is not Kind.STARVED:
        yield from (f"Before, {trend}." for trend in map(_trend, finding.before) if trend)
    if finding.parameters:
        yield from _parameters(finding.parameters, finding.at_ns)
    if finding.hit and finding.kind is not Kind.STARVED:  # its cause names them
        yield f"Also affected: {_names(finding.hit)}."
    if finding.done:
        yield f"What followed: {_followed(finding.done)}."
    if finding.away:
        yield _away(finding)
    if finding.last_lines:
        yield "Its last lines:"
        yield from (f"  {line}" for line in finding.last_lines)
    if finding.frames:
        yield "Backtrace:"
        yield from _backtrace(finding)


def _cause(finding: Finding) -> str:
    match finding.kind:
        case Kind.STARVED:
            return _starvation(finding)
        case Kind.GREW:
            return " and ".join(filter(None, map(_trend, finding.before)))
        case Kind.DISK_FULL:
            return "".join(filter(None, map(_trend, finding.before)))
    cause = finding.cause
    known = BY_NAME.get(finding.known)
    if known is None:
        return cause
    said = known_by(cause, finding.last_lines)
    quoted = f', after it wrote "{said.text.strip()}"' if said and said.text != cause else ""
    return f"{cause}{quoted}; that is, {known.means}"


def _starvation(finding: Finding) -> str:
    used = next((t for t in finding.before if t.quantity is Quantity.PROCESSOR), None)
    waited = [t for t in finding.before if t.quantity is Quantity.WAITING]
    if used is None:
        return ""
    who = ", ".join(f"{each.who} ({each.after:.0f} times a second)" for each in waited)
    lasted = duration(used.end_ns - used.begin_ns)
    text = f"it used {used.after:.0f} % of a core for {lasted}, and {who} had to wait for one"
    pressure = [t.after for t in finding.before if t.quantity is Quantity.PRESSURE]
    if pressure and pressure[0] > 0:
        text += f"; {pressure[0]:.0f} % of the time something waited for a core"
    return text


def _place(place: Place) -> str:
    parts = []
    if place.frame is not None:
        function = plain_function(place.frame.function)
        library = f"{place.frame.library}+0x{place.frame.offset:x}" if place.frame.library else ""
        where = str(place.line) if place.line is not None else ""
        inside = f"{function} ({library})" if function and library else function or library
        parts.append(", ".join(filter(None, (where, inside or place.frame.text))))
    if place.plugin:
        parts.append(f"{place.plugin} of package {place.package}")
    if place.command:
        parts.append("command " + shorten(" ".join(place.command), 120, placeholder=" ..."))
    if place.config:
        parts.append(f"declared in {place.config}")
    return "; ".join(parts)


def _trend(trend: Trend) -> str:
    name = _NUMBERS.get(trend.quantity)
    if name is None:
        return ""
    whose = f"the {name} of {trend.who}" if trend.who else f"the {name}"
    verb = "grew" if trend.after > trend.before else "fell"
    before, after = (_number(value, trend.quantity) for value in (trend.before, trend.after))
    return f"{whose} {verb} from {before} to {after} in {duration(trend.end_ns - trend.begin_ns)}"


def _number(value: float, quantity: Quantity) -> str:
    if quantity not in _BYTES:
        return f"{value:.0f}"
    return f"{value / 1e9:.2f} GB" if value >= 1e9 else f"{value / 1e6:.1f} MB"


def _parameters(known: ParametersOfALife, at_ns: int) -> Iterator[str]:
    for each in known.changes[-_CHANGES:]:
        yield f"Its {change(each)} {_precisely(max(0, at_ns - each.at_ns))} before."
    own = [f"{name} {_value(value)}" for name, value in known.values if is_of_the_node(name)]
    if own:
        yield f"Its parameters: {_names(own)}."


def change(changed: Changed) -> str:
    """Say what happened to a parameter: ``parameter gain changed from 1.0 to 2.5``."""
    if changed.after is None:
        return f"parameter {changed.name} was deleted"
    since = "" if changed.before is None else f" from {_value(changed.before)}"
    return f"parameter {changed.name} changed{since} to {_value(changed.after)}"


def _value(value: str) -> str:
    return shortened(value, _LONGEST_VALUE)


def _away(finding: Finding) -> str:
    by_name: dict[str, list[Away]] = {}
    for each in finding.away:
        by_name.setdefault(each.who, []).append(each)
    if finding.kind is Kind.SLOW:
        return f"It took {duration(finding.away[-1].ns or 0)}."
    texts = [_absence(who, absences) for who, absences in by_name.items()]
    more = f" and {len(texts) - _MANY} others" if len(texts) > _MANY else ""
    return f"Downtime: {', '.join(texts[:_MANY])}{more}."


def _absence(who: str, absences: Sequence[Away]) -> str:
    if any(each.ns is None for each in absences):
        return f"{who} until the end"
    total = sum(each.ns or 0 for each in absences)
    if len(absences) == 1:
        return f"{who} for {_precisely(total)}"
    longest = max(each.ns or 0 for each in absences)
    return f"{who} {len(absences)} times, {_precisely(total)} in all, {_precisely(longest)} at most"


def _precisely(nanoseconds: int) -> str:
    return f"{nanoseconds / 1e6:.0f} ms" if nanoseconds < _SECOND else duration(nanoseconds)


def _names(names: Sequence[str]) -> str:
    more = f" and {len(names) - _MANY} more" if len(names) > _MANY else ""
    return ", ".join(names[:_MANY]) + more


def _followed(done: Sequence[str]) -> str:
    if len(done) <= _MANY:
        return "; ".join(done)
    # The last one says how it ended.
    first = done[: _MANY // 2]
    return "; ".join((*first, f"{len(done) - len(first) - 1} more", done[-1]))


def _backtrace(finding: Finding) -> Iterator[str]:
    lines = finding.lines or (None,) * len(finding.frames)
    for frame, line in zip(finding.frames[:_FRAMES], lines, strict=False):
        yield f"  {frame.text}" + (f" at {line}" if line else "")
    if len(finding.frames) > _FRAMES:
        yield f"  and {len(finding.frames) - _FRAMES} more"


def _summary(findings: Sequence[Finding], session: PastSession) -> str:
    view, reader = session.view, session.reader
    size = ", ".join(
        (
            counted(len(view.containers), "container"),
            counted(view.total, "node"),
            counted(len(view.processes), "process"),
        )
    )
    name = session.about.get("name", "of an unknown name")
    lasted = duration(max(0, reader.end - reader.begin))
    nothing = "Nothing in what can be read" if reader.damages else "Nothing"
    verdict = "" if findings else f"{nothing} was wrong. "
    return f"{verdict}Session {name}: {lasted}, {size}."

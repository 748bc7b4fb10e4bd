"""What ``play-launch explain`` does: reports what went wrong in a session, most important first."""

from __future__ import annotations

from collections import Counter
from textwrap import shorten
from typing import TYPE_CHECKING, Final

import msgspec

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.info import report_damage
from play_launch.cli.output import counted, duration, printable, say
from play_launch.postmortem.diagnostics import level_name, status_object
from play_launch.postmortem.findings import findings, is_wrong
from play_launch.postmortem.known_causes import BY_NAME, known_by
from play_launch.postmortem.parameters import is_of_the_node, shortened
from play_launch.postmortem.source_lines import located
from play_launch.postmortem.timeline import read_timeline
from play_launch.supervisor.frames import plain_function

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from play_launch.postmortem.findings import DeclaredPlace, Finding
    from play_launch.postmortem.parameters import Changed, ParametersOfALife
    from play_launch.postmortem.timeline import Timeline
    from play_launch.postmortem.units import Downtime

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


def explain(file: options.Recording, as_json: options.Json = False) -> int:
    """Explain what went wrong in a session: first failure, cause, source line, affected nodes.

    Exits with 0 if nothing went wrong, with 1 if something did, with 2 if the file is not a
    recording, and with 5 if the recording could not be read completely. Source lines need addr2line
    (binutils) and the libraries of the session on this machine.
    """
    timeline = read_timeline(file)
    found = located(findings(timeline))
    wrong = is_wrong(found)
    session, reader = timeline.session, timeline.session.reader
    if as_json:
        values = {
            "path": str(reader.path),
            "session": session.about,
            "started_ns": session.started_ns,
            "begin_ns": reader.begin,
            "end_ns": reader.end,
            "complete": reader.is_complete and not reader.damages,
            "damages": [str(damage) for damage in reader.damages],
            "wrong": wrong,
            "findings": [
                {
                    "signature_id": each.signature.id if each.signature else None,
                    **msgspec.to_builtins(each),
                    "says": headline(each, session.started_ns),
                }
                for each in found
            ],
            "diagnostics": [
                status_object(*each) for each in sorted(timeline.diagnostics.statuses.items())
            ],
        }
        say(msgspec.json.encode(values).decode())
    else:
        for line in paragraphs(found, timeline):
            say(printable(line))
    if report_damage(reader):
        return ExitCode.DAMAGED
    return ExitCode.NODE_FAILED if wrong else ExitCode.OK


def paragraphs(found: Sequence[Finding], timeline: Timeline) -> Iterator[str]:
    started = timeline.session.started_ns
    for number, finding in enumerate(found):
        lines = list(details(finding))
        yield headline(finding, started)
        yield from (f"  {line}" for line in lines[: None if number < _IN_FULL else _IN_SHORT])
        yield ""
    if len(found) > _IN_FULL:
        yield f"The first {_IN_FULL} are in full here; all are with --json."
    yield _summary(found, timeline)


def headline(finding: Finding, started_ns: int) -> str:
    """Subject, event, count, time: ``/talker in /box crashed 3 times, first at 0.636 s``."""
    seconds = f"{round((finding.at_ns - started_ns) / _SECOND, 3) + 0.0:.3f} s"  # no -0.000
    at, times = f"{seconds} after the start", len(finding.times_ns)
    when = f"at {at}" if times == 1 else f"{times} times, first at {at}"
    inside = f" in {finding.place.container}" if finding.place.container else ""
    name = f"{finding.name}{inside} " if finding.name else ""
    return f"{name}{finding.says.replace('{when}', when).replace('{at}', at)}."


def details(finding: Finding) -> Iterator[str]:
    """Give the lines that follow: cause, place, fix, state before and result."""
    if cause := _cause(finding):
        yield f"Cause: {cause}."
    if place := _place(finding.place):
        yield f"Place: {place}."
    if finding.chain:
        yield "Critical chain, from the end to the start:"
        yield from (f"  {link}" for link in finding.chain)
    yield from (f"{problem[0].upper()}{problem[1:]}." for problem in finding.problems)
    known = BY_NAME.get(finding.known)
    if known is not None and known.fix:
        yield f"Fix: {known.fix}."
    if finding.since_ns and finding.at_ns - finding.since_ns >= _BRIEF:
        state = "in its constructor" if finding.state == "loading" else finding.state
        yield f"Before, it was {state} for {duration(finding.at_ns - finding.since_ns)}."
    yield from (f"Before: {trend}." for trend in finding.before)
    if finding.parameters:
        yield from _parameters(finding.parameters, finding.at_ns)
    if finding.hit:
        yield f"Also affected: {_names(finding.hit)}."
    if finding.done:
        yield f"What followed: {'; '.join(finding.done)}."
    if finding.away:
        yield _downtimes(finding)
    if finding.last_lines:
        yield "Its last lines:"
        yield from (f"  {line}" for line in finding.last_lines)
    if finding.frames:
        yield "Backtrace:"
        yield from _backtrace(finding)


def _cause(finding: Finding) -> str:
    cause, known = finding.cause.removesuffix("."), BY_NAME.get(finding.known)
    if known is None:
        return cause
    said = known_by(cause, finding.last_lines)
    quoted = f', after it wrote "{said.text.strip()}"' if said and said.text != cause else ""
    return f"{cause}{quoted}; that is, {known.means}"


def _place(place: DeclaredPlace) -> str:
    parts = []
    if place.frame is not None:
        function = plain_function(place.frame.function)
        library = f"{place.frame.library}+0x{place.frame.offset:x}" if place.frame.library else ""
        where = str(place.line) if place.line is not None else ""
        inside = f"{function} ({library})" if function and library else function or library
        parts.append(", ".join(filter(None, (where, inside or place.frame.text))))
    elif place.line is not None:
        parts.append(", ".join(filter(None, (str(place.line), place.line.function))))
    if place.plugin:
        parts.append(f"{place.plugin} of package {place.package}")
    if place.command:
        parts.append("command " + shorten(" ".join(place.command), 120, placeholder=" ..."))
    if place.config:
        parts.append(f"declared in {place.config}")
    if place.machine:
        parts.append(f"on machine {place.machine}")
    return "; ".join(parts)


def _parameters(known: ParametersOfALife, at_ns: int) -> Iterator[str]:
    for each in known.changes[-_CHANGES:]:
        yield f"Its {change(each)} {duration(max(0, at_ns - each.at_ns))} before."
    own = [f"{name} {_value(value)}" for name, value in known.values if is_of_the_node(name)]
    if own:
        yield f"Its parameters: {_names(own)}."


def change(changed: Changed) -> str:
    """Word the change of a parameter: ``parameter gain changed from 1.0 to 2.5``."""
    if changed.after is None:
        return f"parameter {changed.name} was deleted"
    since = "" if changed.before is None else f" from {_value(changed.before)}"
    return f"parameter {changed.name} changed{since} to {_value(changed.after)}"


def _value(value: str) -> str:
    return shortened(value, _LONGEST_VALUE)


def _downtimes(finding: Finding) -> str:
    by_name: dict[str, list[Downtime]] = {}
    for each in finding.away:
        by_name.setdefault(each.name, []).append(each)
    texts = [_downtime(name, each) for name, each in by_name.items()]
    more = f" and {len(texts) - _MANY} others" if len(texts) > _MANY else ""
    return f"Downtime: {', '.join(texts[:_MANY])}{more}."


def _downtime(name: str, every: Sequence[Downtime]) -> str:
    ended = [each.ns for each in every if each.ns is not None]
    if not ended:
        return f"{name} until the end"
    at_last = "" if len(ended) == len(every) else ", at last until the end"
    if len(ended) == 1:
        return f"{name} for {duration(ended[0])}{at_last}"
    total, longest = duration(sum(ended)), duration(max(ended))
    return f"{name} {len(ended)} times, {total} in all, {longest} at most{at_last}"


def _names(names: Sequence[str]) -> str:
    more = f" and {len(names) - _MANY} more" if len(names) > _MANY else ""
    return ", ".join(names[:_MANY]) + more


def _backtrace(finding: Finding) -> Iterator[str]:
    lines = finding.lines or (None,) * len(finding.frames)
    for frame, line in zip(finding.frames[:_FRAMES], lines, strict=False):
        yield f"  {frame.text}" + (f" at {line}" if line else "")
    if len(finding.frames) > _FRAMES:
        yield f"  and {len(finding.frames) - _FRAMES} more"


def _summary(found: Sequence[Finding], timeline: Timeline) -> str:
    session, reader = timeline.session, timeline.session.reader
    size = ", ".join(counted(number, noun) for noun, number in timeline.size().items())
    name = session.about.get("name", "of an unknown name")
    lasted = duration(max(0, reader.end - reader.begin))
    nothing = "Nothing in what can be read" if reader.damages else "Nothing"
    verdict = "" if found else f"{nothing} was wrong. "
    levels = Counter(each.level for each in timeline.diagnostics.statuses.values())
    each = ", ".join(f"{levels[level]} {level_name(level)}" for level in sorted(levels))
    return f"{verdict}Session {name}: {lasted}, {size}." + f" Diagnostics: {each}." * bool(each)

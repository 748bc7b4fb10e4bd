"""What ``play-launch rerun`` does: decides once more, and compares with what was recorded."""

from __future__ import annotations

import contextlib
import re
import struct
from difflib import SequenceMatcher
from itertools import pairwise, zip_longest
from typing import TYPE_CHECKING, Annotated, Any, Final, NamedTuple

import msgspec
import typer

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.info import report_damage
from play_launch.cli.output import counted, printable, say, warn
from play_launch.container.cdr.messages import STATE_EVENT
from play_launch.container.cdr.structure import CdrError
from play_launch.postmortem.past_session import PastSession
from play_launch.recording import topics
from play_launch.recording.decisions import UnreadableInputError, read
from play_launch.recording.environment import REDACTED
from play_launch.recording.forms import convert
from play_launch.supervisor.difference import events_since
from play_launch.supervisor.events import SubjectKind
from play_launch.supervisor.inputs import Origin, Over, Raised
from play_launch.supervisor.reducer import reduce
from play_launch.supervisor.view import is_guest
from play_launch.supervisor.world import World

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.recording.decisions import Decision
    from play_launch.supervisor.events import RunEvent

    Fields = dict[str, Any]
    """Those of a `StateEvent`."""

_DECIDED: Final = frozenset(
    {
        SubjectKind.NODE,
        SubjectKind.CONTAINER,
        SubjectKind.PROCESS,
        SubjectKind.MANAGED,
        SubjectKind.WANT,
    }
)
_OLD: Final = "it holds no inputs: an older version recorded it, or its beginning is missing"
_MERGED: Final = "it holds the decisions of several machines; rerun the recording of one"
_FOREIGN: Final = ": another version recorded inputs that this one does not know"
_NO_END: Final = "its end is missing"
_WHAT: Final = ("kind", "key", "state")


class RecordedInputs(NamedTuple):
    """What a recording holds: inputs without a gap, and what followed."""

    decisions: list[Decision]
    states: list[Fields]
    flaw: str
    """Why there is no more; else empty."""
    began_ns: int
    """From the start of the session to that of the world."""


_OUTCOME: Final = ("cause", "sequel", "delay_ns", "culprit")
"""Fields that the recordings of earlier versions do not have."""


def rerun(
    file: options.Recording,
    until: Annotated[
        float | None,
        options.time("Only up to this time after the start: 12.5s, 2min."),
    ] = None,
    diff: Annotated[
        bool, typer.Option("--diff", help="Print all differences, not only the first one.")
    ] = False,
    as_json: options.Json = False,
) -> int:
    """Repeat the supervisor's decisions of a session with this version, and compare them.

    Nothing is started: results of processes and nodes are read from the recording. Exits with 0 if
    all changes of state are as recorded, with 1 if not, with 2 if the file is not a recording, and
    with 5 if inputs are missing, as in a recording of an older version.
    """
    session = PastSession(file)
    recorded = _recorded(session)
    report_damage(session.reader)
    path = str(file).encode("utf-8", "backslashreplace").decode()
    found = {"path": path, **repeated(recorded, until, most=None if diff else 1)}
    if as_json:
        say(msgspec.json.encode(found).decode())
    else:
        for line in _lines(found):
            say(printable(line))
    if found["differences"]:
        return ExitCode.NODE_FAILED
    return ExitCode.DAMAGED if found["incomplete"] else ExitCode.OK


def _recorded(session: PastSession) -> RecordedInputs:
    decisions: list[Decision] = []
    states: list[Fields] = []
    foreign = ""
    for message in session.reader.messages({topics.INPUTS.name, topics.STATES.name}):
        try:
            if message.topic.name == topics.INPUTS.name:
                decisions += read(message.data)
            elif message.sequence != topics.REPEATED:
                # Earlier versions wrote no causes.
                fields = STATE_EVENT.read(message.data + bytes(32))
                others = is_guest(fields["unique_id"], fields["attempt"])
                if fields["kind"] in _DECIDED and not others:
                    states.append(fields)
        except (CdrError, UnreadableInputError) as error:
            foreign = foreign or (_FOREIGN if isinstance(error, UnreadableInputError) else "")
            session.reader.damaged(str(error))
    if topics.MACHINES_METADATA in session.reader.metadata:
        return RecordedInputs([], states, _MERGED, 0)
    flaw = ""
    origin = decisions[0].said if decisions else None
    if not isinstance(origin, Origin):
        return RecordedInputs([], states, _OLD, 0)
    for before, after in pairwise(decisions):
        first, last = before.number + 1, after.number - 1
        if first > last:
            continue
        flaw = f"inputs {first} to {last} are missing{foreign}"
        decisions = [each for each in decisions if each.number < first]
        break
    if not flaw and not isinstance(decisions[-1].said, Over):
        flaw = f"{_NO_END}{foreign}"
    if not flaw and decisions[-1].events > len(states):
        missing = decisions[-1].events - len(states)
        return RecordedInputs([], states, f"{counted(missing, 'change')} of state are missing", 0)
    began_ns = origin.stamp_ns - session.started_ns
    return RecordedInputs(decisions, states, flaw, began_ns)


def repeated(recorded: RecordedInputs, until: float | None, most: int | None) -> dict[str, Any]:
    """Decide once more, up to a time and to so many differences; return what `--json` prints."""
    decisions, states, flaw, began_ns = recorded
    inputs, events, seconds = 0, 0, 0.0
    differences: list[Fields] = []
    origin = decisions[0].said if decisions else None
    if isinstance(origin, Origin):
        world = World(origin.config, starts=origin.starts, limits=origin.limits)
        for decision, following in zip_longest(decisions, decisions[1:]):
            at = began_ns / 1e9 + decision.now - decisions[0].now
            if until is not None and at > until:
                flaw = ""
                break
            if following is None or (most is not None and len(differences) >= most):
                break  # what followed the last one may be incomplete
            inputs, seconds = inputs + 1, at
            new = _events(world, decision)
            events += len(new)
            unequal = _unequal(states[decision.events : following.events], new)
            differences += [_difference(at, decision, was, now) for was, now in unequal]
    return {
        "inputs": inputs,
        "states": events,
        "until_s": seconds,
        "same": not differences and not flaw,
        "incomplete": flaw or None,
        "differences": differences[:most],
    }


def _events(world: World, decision: Decision) -> list[Fields]:
    """Give what follows in a world, as a recording would hold it."""
    said = decision.said
    effects = (
        []
        if isinstance(said, Origin | Over)
        else reduce(world, said, decision.now, decision.chance)
    )
    for effect in effects:
        if isinstance(effect, Raised):
            _warn(decision, effect.error)
    events: list[RunEvent] = []
    try:
        events += events_since(world, now=decision.now, stamp_ns=0)
    except Exception as error:  # noqa: BLE001 - as in the session, which goes on
        _warn(decision, error)
    found: list[Fields] = []
    for event in events:
        with contextlib.suppress(struct.error):  # it would not be recorded either
            found += [
                STATE_EVENT.read(message.data)
                for message in convert(event)
                if message.topic is topics.STATES
            ]
    return found


def _warn(decision: Decision, error: Exception) -> None:
    warn(f"input {decision.number}: {type(error).__name__}: {error}")


def _unequal(old: list[Fields], new: list[Fields]) -> Iterator[tuple[Fields | None, Fields | None]]:
    """Pair what followed one input, then and now, and give the pairs that differ."""
    found = SequenceMatcher(None, [*map(_key, old)], [*map(_key, new)], autojunk=False)
    for _, begin, end, new_begin, new_end in found.get_opcodes():
        for was, now in zip_longest(old[begin:end], new[new_begin:new_end]):
            if was is None or now is None or _fields(was, now):
                yield was, now


def _key(fields: Fields) -> tuple[Any, ...]:
    return tuple(fields[name] for name in _WHAT)


def _fields(old: Fields, new: Fields) -> list[str]:
    passed_over = {"stamp"} if old["cause"] else {"stamp", *_OUTCOME}
    return [name for name in old if name not in passed_over and not _is_like(old[name], new[name])]


def _is_like(old: Any, new: Any) -> bool:
    """Whether a value is as recorded, where the inputs may lack a secret."""
    if old == new:
        return True
    if isinstance(new, tuple):
        return len(old) == len(new) and all(map(_is_like, old, new))
    if not isinstance(new, str) or REDACTED not in new:
        return False
    pattern = ".*".join(map(re.escape, new.split(REDACTED)))
    return re.fullmatch(pattern, old, re.DOTALL) is not None


def _difference(
    seconds: float, decision: Decision, recorded: Fields | None, new: Fields | None
) -> Fields:
    """Describe an event that does not follow as it was recorded; None: it does not at all."""
    said, fields = decision.said, recorded or new or {}
    return {
        "seconds": seconds,
        "unit": str(fields["key"]),
        "kind": SubjectKind(fields["kind"]).name.lower(),
        "input": {
            "number": decision.number,
            "type": type(said).__name__,
            "unit": str(getattr(said, "unit", getattr(said, "node", ""))),
        },
        "recorded": recorded,
        "new": new,
        "fields": _fields(recorded, new) if recorded and new else [],
    }


def _lines(found: dict[str, Any]) -> Iterator[str]:
    for each in found["differences"]:
        number, cause, unit = each["input"].values()
        of = f" of {unit}" if unit else ""
        yield (
            f"{each['seconds']:.3f} s: {each['kind']} {each['unit']} differs"
            f" after input {number}, {cause}{of}"
        )
        old, new = each["recorded"], each["new"]
        for name in each["fields"]:
            yield f"  {name}: recorded {old[name]!r}, now {new[name]!r}"
        if not each["fields"]:
            yield f"  recorded: {_summary(old)}"
            yield f"  now: {_summary(new)}"
    if found["incomplete"]:
        yield f"the recording is incomplete: {found['incomplete']}"
    if found["inputs"]:
        verdict = "differently" if found["differences"] else "as recorded"
        yield (
            f"{counted(found['inputs'], 'input')} up to {found['until_s']:.3f} s led to"
            f" {counted(found['states'], 'change')} of state, {verdict}"
        )


def _summary(fields: Fields | None) -> str:
    if fields is None:
        return "nothing"
    reason = f" ({fields['reason']})" if fields["reason"] else ""
    return f"{fields['state']}{reason}"

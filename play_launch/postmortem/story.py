"""What a recording says about a session that went wrong: one pass, findings at its end."""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from play_launch.config.node_key import NodeKey
from play_launch.postmortem.declared import declared_places
from play_launch.postmortem.events import UnreadableEventError, event_of
from play_launch.postmortem.findings import (
    Finding,
    Kind,
    Place,
    Trend,
    by_importance,
)
from play_launch.postmortem.frames import blamed
from play_launch.postmortem.incidents import Incident, Incidents
from play_launch.postmortem.known_causes import known_cause
from play_launch.postmortem.last_lines import LastLines
from play_launch.postmortem.parameters import TOPICS as PARAMETER_TOPICS
from play_launch.postmortem.parameters import Parameters
from play_launch.postmortem.session import PastSession
from play_launch.postmortem.trends import LITTLE_DISK, Samples
from play_launch.recording import topics
from play_launch.supervisor.events import (
    ComponentEvent,
    ContainerStateChanged,
    LogRecord,
    NodeStateChanged,
    ProcessEvent,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from play_launch.postmortem.bag_reader import BagReader, Message, RecordedTopic

_RECORDER: Final = "play_launch.recording.recorder"
_INTERRUPTED: Final = "the recording is interrupted: "
_GOES_ON: Final = "the recording goes on "
_LATE_LINES: Final = 200_000_000
"""Nanoseconds that a dead process's last lines may take to where they are recorded."""


class Story(Struct, frozen=True):
    """What was wrong, and what the rest of the recording says."""

    findings: tuple[Finding, ...]
    """The most important one first."""
    session: PastSession
    """Read to its end."""
    samples: Samples
    bring_up: dict[str, int]
    """Nanoseconds from the start of the session until a node was loaded first, by key."""
    parameters: Parameters


class _Topics:
    """Those that are read: what the user recorded besides does not matter here."""

    def __init__(self, *names: str, samples: bool) -> None:
        self._names = names
        self._with_stats = samples

    def __contains__(self, name: object) -> bool:
        return name in self._names or (self._with_stats and _is_of_samples(str(name)))


def _is_of_samples(name: str) -> bool:
    return name.startswith("/play_launch/") and name.endswith("/stats")


_STATES: Final = (topics.COMPONENT_EVENTS.name, topics.STATES.name)
_EVERYTHING: Final = _Topics(
    *_STATES,
    *PARAMETER_TOPICS,
    topics.OUTPUT.name,
    topics.SYSTEM.name,
    topics.LOG_ALL.name,
    samples=True,
)
_FAILURES: Final = _Topics(*_STATES, samples=False)


def read_story(path: Path, *, only_failures: bool = False) -> Story:
    """Read a recording to its end, or to where it cannot be read any more.

    With ``only_failures``, what was written and measured is left out, which is faster.

    Raises:
        NotARecordingError: For another kind of file.
    """
    session = PastSession(path)
    telling = Telling(session)
    for message in session.reader.messages(_FAILURES if only_failures else _EVERYTHING):
        telling.take(message)
    return telling.story()


class Telling:
    """The state of a pass, for callers that need the messages as well."""

    def __init__(self, session: PastSession) -> None:
        """Take nothing yet."""
        self._session = session
        self._lines = LastLines()
        self.samples = Samples()
        self.parameters = Parameters()
        self.incidents = Incidents(self._begun)
        self._interruptions: list[LogRecord] = []
        self._waiting: list[tuple[int, int, Incident]] = []
        """Incidents whose last lines may still come, and until when."""
        self._takes: dict[RecordedTopic, Callable[[Message], None]] = {}

    def take(self, message: Message) -> None:
        """Take the next message of the recording, of whatever topic."""
        while self._waiting and message.log_time > self._waiting[0][0]:
            self._look_at_lines(heapq.heappop(self._waiting)[2])
        take = self._takes.get(message.topic)
        if take is None:
            take = self._takes[message.topic] = self._take_of(message.topic)
        take(message)

    def _take_of(self, topic: RecordedTopic) -> Callable[[Message], None]:
        if topic.type_name == topics.PROCESS_STATS:
            return self.samples.of(topic.key)
        if topic.name == topics.OUTPUT.name:
            return self._lines.take
        if topic.name == topics.SYSTEM.name:
            return self.samples.take_system
        return self._take_parameters if topic.name in PARAMETER_TOPICS else self._take_event

    def story(self) -> Story:
        """Give what was wrong; no message comes any more."""
        started = self._session.started_ns
        bring_up = {key: stamp - started for key, stamp in self.incidents.bring_up.items()}
        return Story(self.findings(), self._session, self.samples, bring_up, self.parameters)

    def findings(self) -> tuple[Finding, ...]:
        """Give them alone; no message comes any more."""
        while self._waiting:
            self._look_at_lines(heapq.heappop(self._waiting)[2])
        self.incidents.end()
        reader = self._session.reader
        places = declared_places(reader.attachments)
        found = [self._finding(each, places) for each in self.incidents.all]
        found += self._starvations(places)
        failed = {each.who for each in found}
        found += [each for each in self._leaks(places) if each.who not in failed]
        found += self._interrupted()
        found += self._disk(reader)
        if not reader.is_complete and reader.counts:
            at = reader.end or self._session.started_ns
            found.append(Finding(kind=Kind.UNFINISHED, who="", times_ns=(at,)))
        return by_importance(found)

    def _take_parameters(self, message: Message) -> None:
        try:
            self.parameters.take(message)
        except UnreadableEventError as error:
            self._session.note_damage(message, error)

    def _take_event(self, message: Message) -> None:
        try:
            event = event_of(message)
        except UnreadableEventError as error:
            self._session.note_damage(message, error)
            return
        match event:
            case NodeStateChanged():
                self.incidents.node(event, message.log_time)
            case ProcessEvent():
                self.incidents.process(event, message.log_time)
            case ComponentEvent():
                self.incidents.component(event)
            case ContainerStateChanged():
                self.incidents.container(event)
            case LogRecord() if event.name == _RECORDER:
                self._interruptions.append(event)
                return
            case _:
                return
        self._session.view = self._session.view.after(event)

    def _begun(self, incident: Incident) -> None:
        if known := self.parameters.nodes.get(incident.who):
            incident.parameters = known.of_life(incident.since_ns) or None
        until = incident.log_time + _LATE_LINES
        heapq.heappush(self._waiting, (until, len(self.incidents.all), incident))

    def _look_at_lines(self, incident: Incident) -> None:
        until = incident.log_time + _LATE_LINES
        if incident.container:
            # When it is loaded again, other lines follow.
            until = min(until, incident.back_at or until)
            lines = self._lines.of_node(incident.container, incident.who, until)
        else:
            lines = self._lines.of_process(incident.who, until)
        incident.last_lines = lines

    def _finding(self, incident: Incident, places: dict[str, Place]) -> Finding:
        place = self._declared(incident.key, places)
        number = blamed(incident.frames)
        place = replace(
            place,
            frame=None if number is None else incident.frames[number],
            plugin=place.plugin or incident.plugin,
            package=place.package or incident.package,
            container=place.container or incident.container,
        )
        return Finding(
            kind=incident.kind,
            who=incident.who,
            times_ns=tuple(incident.times),
            cause=incident.cause,
            known=known_cause(incident.cause, incident.last_lines),
            place=place,
            frames=incident.frames,
            modules=incident.modules,
            signature=incident.signature,
            state=incident.state,
            since_ns=incident.since_ns,
            last_lines=incident.last_lines,
            parameters=incident.parameters,
            before=self.samples.before(incident.key, incident.who, incident.pid, incident.log_time),
            hit=tuple(incident.hit),
            done=tuple(incident.done),
            away=tuple(incident.away),
        )

    def _declared(self, key: str, places: dict[str, Place]) -> Place:
        place = places.get(key, Place())
        command = self.incidents.commands.get(key, ())
        return place if place.command else replace(place, command=command)

    def _starvations(self, places: dict[str, Place]) -> list[Finding]:
        found: dict[str, Finding] = {}
        for each in self.samples.starvations():
            known = found.get(each.who)
            if known is not None:
                found[each.who] = replace(known, times_ns=(*known.times_ns, each.begin_ns))
                continue
            trends = tuple(replace(trend, who=_name(trend.who)) for trend in each.trends)
            found[each.who] = Finding(
                kind=Kind.STARVED,
                who=_name(each.who),
                times_ns=(each.begin_ns,),
                place=self._declared(each.who, places),
                hit=tuple(map(_name, each.hit)),
                before=trends,
            )
        return list(found.values())

    def _leaks(self, places: dict[str, Place]) -> list[Finding]:
        found: dict[str, list[Trend]] = {}
        for key, trend in self.samples.leaks():
            found.setdefault(key, []).append(replace(trend, who=_name(key)))
        return [
            Finding(
                kind=Kind.GREW,
                who=_name(key),
                times_ns=(trends[0].begin_ns,),
                place=self._declared(key, places),
                before=tuple(trends),
            )
            for key, trends in found.items()
        ]

    def _interrupted(self) -> list[Finding]:
        causes: dict[str, list[int]] = {}
        done: dict[str, None] = {}
        for record in self._interruptions:
            if record.message.startswith(_INTERRUPTED):
                cause = record.message.removeprefix(_INTERRUPTED)
                causes.setdefault(cause, []).append(record.stamp_ns)
            elif record.message.startswith(_GOES_ON):
                done[record.message] = None
        return [
            Finding(
                kind=Kind.INTERRUPTED,
                who="",
                times_ns=tuple(times),
                cause=cause,
                known=known_cause(cause, ()),
                done=tuple(done),
            )
            for cause, times in causes.items()
        ]

    def _disk(self, reader: BagReader) -> list[Finding]:
        trend = self.samples.disk_free_at_the_end()
        if trend is None or reader.is_complete or trend.after >= LITTLE_DISK:
            return []
        return [Finding(kind=Kind.DISK_FULL, who="", times_ns=(trend.end_ns,), before=(trend,))]


def _name(key: str) -> str:
    """Give the name in a key: ``/talker`` of ``/box:/talker``."""
    return NodeKey.parsed(key).name if ":/" in key else key

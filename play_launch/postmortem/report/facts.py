"""What a page is made of: small things as JSON, columns of numbers and texts packed."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct
from msgspec.structs import replace

from play_launch.postmortem.parameters import shortened
from play_launch.postmortem.report.configuration import Configuration, configuration
from play_launch.postmortem.report.gather import Arrival, Mark, PageRow  # noqa: TC001 - fields of a Struct
from play_launch.postmortem.report.page import shown
from play_launch.postmortem.report.series import (
    PROCESS_COLUMNS,
    SYSTEM_COLUMNS,
    packed,
    quantised,
    time_planes,
    value_planes,
)

if TYPE_CHECKING:
    from array import array
    from collections.abc import Sequence

    from play_launch.postmortem.bag_reader import BagReader
    from play_launch.postmortem.parameters import KnownParameters, Parameters
    from play_launch.postmortem.past_session import PastSession
    from play_launch.postmortem.report.gather import Gathered
    from play_launch.postmortem.report.series import Series

_MOST_PARAMETERS: Final = 20_000
"""Parameters and changes of all nodes together; a page of 110 nodes has about 2,000."""
_LARGEST_FACTS = 1_000_000
"""Bytes of an attachment that is shown as names and values."""


class ParameterChanged(Struct, frozen=True):
    """A change; times are milliseconds since the start."""

    at: float
    name: str
    before: str
    after: str


class NodeParameters(Struct, frozen=True):
    """Those of one node at the end of the session."""

    node: str
    note: str
    """What to know about them; empty: they are what it answered, and what changed since."""
    values: tuple[tuple[str, str], ...]
    changes: tuple[ParameterChanged, ...]


class Point(Struct, frozen=True):
    """One thing that happened."""

    title: str
    lines: tuple[str, ...] = ()
    """The first ones are shown at once."""
    at: float | None = None
    """Milliseconds since the start; None: no moment."""
    name: str = ""
    """Name of the node, container or process; empty: the machine."""
    is_failure: bool = True


class Scale(Struct, frozen=True):
    """From where to where the steps of a column go."""

    low: float
    high: float


class PackedSeries(Struct, frozen=True):
    """Where a series stands in the columns: they follow one another."""

    row: int
    count: int
    is_shared: bool
    scales: tuple[Scale, ...]
    """Of each column."""


class TopicRate(Struct, frozen=True):
    """Messages of a topic."""

    name: str
    type_name: str
    messages: int
    counts: tuple[int, ...]
    """In each part of the time."""


class Facts(Struct, frozen=True, kw_only=True):
    """The JSON of a page; times are milliseconds since the start."""

    title: str
    file: str
    bytes: int
    started_ms: float
    """Since the epoch."""
    end: float
    notices: tuple[str, ...]
    """What cannot be read, or is left out."""
    story: tuple[Point, ...]
    rows: tuple[PageRow, ...]
    marks: tuple[Mark, ...]
    came_up: float | None
    arrivals: tuple[Arrival, ...]
    chain: tuple[str, ...]
    """What the first of them waited for, unit by unit, back to the start."""
    part: float
    """Of the rates, in milliseconds."""
    topics: tuple[TopicRate, ...]
    parameters: tuple[NodeParameters, ...]
    configuration: Configuration
    session: dict[str, str]
    """What the recording says about itself and its machine, in words."""
    lanes: int
    lines: int
    series: tuple[PackedSeries, ...]
    system: PackedSeries
    columns: tuple[str, ...] = PROCESS_COLUMNS
    system_columns: tuple[str, ...] = SYSTEM_COLUMNS


class Contents(Struct, frozen=True):
    """Facts, and the packed columns by name."""

    facts: Facts
    columns: dict[str, str]


def contents(
    gathered: Gathered,
    story: Sequence[Point] = (),
) -> Contents:
    """Put together what a page shows of a session that was read to its end."""
    session = gathered.timeline.session
    reader = session.reader
    every = [each for _, each in sorted(gathered.usage.of_rows.items())]
    lanes, lines, system = gathered.lanes(), gathered.lines, gathered.usage.system
    series, columns = _pack("series", every, len(PROCESS_COLUMNS))
    machine, system_columns = _pack("system", [system], len(SYSTEM_COLUMNS))
    facts = Facts(
        title=shown(session.about.get("name", "")) or reader.path.name,
        file=shown(str(reader.path)),
        bytes=reader.size,
        started_ms=(session.started_ns + reader.ahead_ns) / 1e6,
        end=gathered.end,
        notices=_notices(reader, gathered),
        story=tuple(map(_shown, story)),
        rows=gathered.rows(),
        marks=gathered.marks(),
        came_up=gathered.came_up(),
        arrivals=gathered.arrivals(),
        chain=gathered.chain(),
        part=gathered.rates.width,
        topics=_topics(reader, gathered),
        parameters=_parameters(gathered.timeline.parameters, session.started_ns),
        configuration=configuration(reader.path, reader.attachments),
        session=_session(session),
        lanes=len(lanes.rows),
        lines=len(lines.texts),
        series=tuple(series),
        system=machine[0],
    )
    columns |= system_columns
    columns |= {
        "lane_rows": packed(value_planes([lanes.rows])),
        "lane_states": packed(lanes.states.tobytes()),
        "lane_times": packed(time_planes([lanes.begins, lanes.ends])),
        "line_rows": packed(value_planes([lines.rows])),
        "line_levels": packed(lines.levels.tobytes()),
        "line_times": packed(time_planes([lines.times])),
        "line_texts": packed("\n".join(lines.texts).encode("utf-8", "replace")),
    }
    return Contents(facts, columns)


def _shown(point: Point) -> Point:
    return replace(
        point,
        title=shown(point.title),
        lines=tuple(map(shown, point.lines)),
        name=shown(point.name),
    )


def _pack(
    name: str, every: Sequence[Series], count: int
) -> tuple[list[PackedSeries], dict[str, str]]:
    """Pack series of so many columns, column by column."""
    columns = {f"{name}_times": packed(time_planes(each.times for each in every))}
    steps: list[list[array[int]]] = [[] for _ in range(count)]
    found = []
    for each in every:
        scales = []
        for number, values in enumerate(each.columns):
            low, high, column = quantised(values)
            steps[number].append(column)
            scales.append(Scale(low, high))
        found.append(PackedSeries(each.row, len(each.times), each.is_shared, tuple(scales)))
    columns |= {f"{name}_{n}": packed(value_planes(column)) for n, column in enumerate(steps)}
    return found, columns


def _topics(reader: BagReader, gathered: Gathered) -> tuple[TopicRate, ...]:
    types = {topic.name: topic.type_name for topic in reader.counts}
    rates = gathered.rates
    used = int(gathered.end / rates.width) + 1
    return tuple(
        TopicRate(shown(name), shown(types.get(name, "")), sum(counts), tuple(counts[:used]))
        for name, counts in sorted(rates.counts.items())
    )


def _notices(reader: BagReader, gathered: Gathered) -> tuple[str, ...]:
    notices = unread(reader)
    notices += [f"{text}.".capitalize() for text in reader.notes]
    for count, what in (
        (gathered.lines.left_out, "lines below WARN that were not written close to a failure"),
        (gathered.timeline.events_left_out, "failures"),
        (gathered.timeline.changes_left_out, "changes of state"),
    ):
        if count:
            notices.append(f"Left out, as a page cannot hold as many: {count:,} {what}.")
    return tuple(map(shown, notices))


def unread(reader: BagReader) -> list[str]:
    """Describe what cannot be read of a recording; empty if it is whole."""
    notices = [f"{damage}" for damage in reader.damages]
    if notices:
        notices.insert(0, "Not everything could be read of the recording:")
    elif not reader.is_complete:
        notices.append("The recording was not closed in order, so its end may be missing.")
    return notices


def _session(session: PastSession) -> dict[str, str]:
    host = session.reader.attachments.get("host.json")
    values: dict[str, Any] = dict(session.about)
    if host is not None and len(host.data) < _LARGEST_FACTS:
        try:
            read = json.loads(host.data)
        except (ValueError, RecursionError):
            read = {}
        if isinstance(read, dict):
            values |= {f"host: {name}": value for name, value in read.items()}
    return {
        shown(name): shown(value if isinstance(value, str) else json.dumps(value))
        for name, value in values.items()
    }


def _parameters(parameters: Parameters, started_ns: int) -> tuple[NodeParameters, ...]:
    """Give what a page shows, by node."""
    left = _MOST_PARAMETERS
    found = []
    for name, known in sorted(parameters.nodes.items()):
        each = _of_node(name, known, started_ns, left)
        left -= len(each.values) + len(each.changes)
        found.append(each)
    return tuple(found)


def _of_node(name: str, known: KnownParameters, started_ns: int, most: int) -> NodeParameters:
    values = sorted(known.values.items())
    notes = []
    if known.error:
        notes.append(f"When it was asked last: {known.error}.")
    if not known.asked_ns:
        notes.append("Only what changed is known.")
    left_out = len(values) - min(len(values), most)
    changes = known.changes[: max(0, most - len(values))]
    left_out += len(known.changes) - len(changes) + known.further_changes
    if left_out:
        notes.append(f"Left out, as a page cannot hold as many: {left_out:,}.")
    return NodeParameters(
        shown(name),
        shown(" ".join(notes)),
        tuple((shown(one), shown(shortened(value))) for one, value in values[:most]),
        tuple(
            ParameterChanged(
                (each.at_ns - started_ns) / 1e6,
                shown(each.name),
                "not set" if each.before is None else shown(shortened(each.before)),
                "not set" if each.after is None else shown(shortened(each.after)),
            )
            for each in changes
        ),
    )

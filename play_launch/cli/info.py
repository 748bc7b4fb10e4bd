"""What a recording holds, and how its session went."""

from __future__ import annotations

import json
from collections import Counter
from typing import TYPE_CHECKING, Any

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.output import clock, counted, note, printable, say, warn
from play_launch.postmortem.timeline import read_timeline
from play_launch.recording.topics import DROPS_METADATA, PART_METADATA

if TYPE_CHECKING:
    from play_launch.postmortem.bag_reader import BagReader
    from play_launch.postmortem.timeline import Timeline


def info(file: options.Recording, as_json: options.Json = False) -> int:
    """Summarise a recording: session, duration, nodes, crashes, restarts, messages of each topic.

    Damaged and unfinished recordings (.active) are read as far as possible; exits with 5 then, with
    2 if the file is not a recording.
    """
    timeline = read_timeline(file, only_failures=True)
    found = session_object(timeline)
    say(json.dumps(found) if as_json else "\n".join(_lines(found)))
    return ExitCode.DAMAGED if report_damage(timeline.session.reader) else 0


def report_damage(reader: BagReader) -> bool:
    """Write to stderr what cannot be read of a file; return whether there is anything."""
    for damage in reader.damages:
        warn(f"{reader.path}: {damage}")
    for text in reader.notes:
        note(f"note: {reader.path}: {text}")
    if not reader.is_complete and not reader.damages:
        warn(f"{reader.path}: it was not closed in order, so its end may be missing")
    return bool(reader.damages) or not reader.is_complete


def session_object(timeline: Timeline) -> dict[str, Any]:
    """Give what is known about a session that was read to its end, as plain values."""
    session, reader, size = timeline.session, timeline.session.reader, timeline.size()
    crashes: Counter[str] = Counter()
    for failure in timeline.failures:
        if failure.is_crash:
            crashes[failure.name] += len(failure.times)
    seconds = (reader.end - reader.begin) / 1e9
    again = [unit for unit in timeline.units if unit.restarts and not unit.is_withdrawn]
    return {
        "path": str(reader.path),
        "files": list(reader.files),
        "removed_files": reader.removed_files,
        "part": reader.metadata.get(PART_METADATA, {}).get("number"),
        "bytes": reader.size,
        "complete": reader.is_complete and not reader.damages,
        "damages": [str(damage) for damage in reader.damages],
        "session": session.about,
        "started_ns": session.started_ns + reader.ahead_ns,
        "duration_s": seconds,
        "containers": size["container"],
        "nodes": size["node"],
        "processes": size["process"],
        "crashes": dict(crashes),
        "reloads": {unit.name: unit.restarts for unit in again if unit.container},
        "restarts": {unit.name: unit.restarts for unit in again if not unit.container},
        "topic_drops": {
            name: int(count)
            for name, count in reader.metadata.get(DROPS_METADATA, {}).items()
            if count.isdecimal()
        },
        "topics": [
            {"name": topic.name, "type": topic.type_name, "messages": count}
            for topic, count in sorted(reader.counts.items())
        ],
        "attachments": {name: len(each.data) for name, each in reader.attachments.items()},
    }


def _lines(found: dict[str, Any]) -> list[str]:
    about = found["session"]
    state = "" if found["complete"] else ", not complete"
    files = "" if len(found["files"]) == 1 else f"{len(found['files'])} files, "
    if files == "" and found["part"] is not None:
        state += "; one of several files: give their folder for the whole session"
    rows = {
        "File": f"{found['path']} ({files}{found['bytes']:,} bytes{state})",
        "Session": f"{about.get('name', 'unknown')} ({about.get('id', 'no id')}), "
        f"play-launch {about.get('play_launch_version') or 'of an unknown version'}",
        "Start": clock(found["started_ns"], "%Y-%m-%d %H:%M:%S.%3N %z"),
        "Duration": f"{found['duration_s']:.3f} s",
        "System": ", ".join(
            (
                counted(found["containers"], "container"),
                counted(found["nodes"], "node"),
                counted(found["processes"], "process"),
            )
        ),
        "Crashes": _counts(found["crashes"]),
        "Reloads": _counts(found["reloads"]),
        "Restarts": _counts(found["restarts"]),
        "Messages": f"{sum(topic['messages'] for topic in found['topics']):,}",
    }
    if found["topic_drops"]:
        rows["Dropped"] = f"messages of topics: {_counts(found['topic_drops'])}"
    lines = [f"{name + ':':<10} {printable(text)}" for name, text in rows.items()]
    width = max((len(topic["name"]) for topic in found["topics"]), default=0)
    types = max((len(topic["type"]) for topic in found["topics"]), default=0)
    lines += [
        printable(
            f"  {topic['name']:<{width}}  {topic['type']:<{types}}  {topic['messages']:>9,}",
            colour=False,
        )
        for topic in found["topics"]
    ]
    return lines


def _counts(counts: dict[str, int]) -> str:
    if not counts:
        return "none"
    each = ", ".join(f"{name} {count}" for name, count in sorted(counts.items()))
    return f"{sum(counts.values())} ({each})"

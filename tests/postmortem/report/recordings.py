"""Recordings to make pages of: an ordinary one, and one full of hostile text."""

from __future__ import annotations

from pathlib import Path

from benchmarks.long_session.plan import Plan
from benchmarks.long_session.write import write_session
from play_launch.cli.output import write_file
from play_launch.config.node_key import NodeKey
from play_launch.postmortem.report.facts import contents
from play_launch.postmortem.report.gather import Gathered
from play_launch.postmortem.report.page import render
from play_launch.postmortem.timeline import Timeline
from play_launch.recording.bag import BagWriter
from play_launch.recording.forms import convert
from play_launch.recording.topics import ALL_TOPICS, METADATA_NAME
from play_launch.supervisor.events import (
    ComponentEvent,
    ComponentEventKind,
    ContainerState,
    ContainerStateChanged,
    LogRecord,
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
    RunEvent,
    Stream,
)

SECOND = 1_000_000_000
BEGIN = 1_790_000_000 * SECOND
ORDINARY = Plan(nodes=24, seconds=300.0, crashes=25, lines=3000)
HOSTILE = (
    "</script><script>document.title = 'owned'</script>",
    "<img src=x onerror=\"document.title = 'owned'\">",
    "<!-- <script> -->",
    "{{facts}} {{script}} ${document.title = 'owned'}",
    "\u202egnp.exe\u202c and \u2066isolated",
    "\x1b[31mred\x1b[0m \x1b]0;owned\x07 \x9b2J",
    "شهادة על node",
    "a\0b\x7fc\ufeffd\u2028e",
    "&lt;b&gt; &amp; \"quotes\" 'and' \\u003c",
    "😀" * 40 + "x" * 3000,
)


def page_of(recording: Path, output: Path) -> None:
    """Write the page without a story."""
    write_file(output, render(contents(gather(recording))))


def gather(recording: Path) -> Gathered:
    timeline = Timeline(recording)
    gathered = Gathered(timeline)
    gathered.read()
    return gathered


def ordinary(folder: Path) -> Path:
    path = folder / "session.mcap"
    write_session(path, ORDINARY)
    return path


def hostile(folder: Path) -> Path:
    """Names, reasons, backtraces, output and configuration are what an enemy would write."""
    events: list[RunEvent] = []
    for number, text in enumerate(HOSTILE):
        container, stamp = f"/{text}", BEGIN + number * SECOND
        key = NodeKey(container.replace(":", ""), f"/{text}")
        container = key.container
        states = (NodeState.PENDING, NodeState.LOADING, NodeState.LOADED, NodeState.CRASHED)
        running = ContainerState.RUNNING
        events += [
            ContainerStateChanged(stamp_ns=stamp, container=container, state=running),
            OutputLine(stamp_ns=stamp, process=container, pid=1, stream=Stream.STDERR, text=text),
            LogRecord(stamp_ns=stamp, level=30, name=text, message=text),
            ComponentEvent(
                stamp_ns=stamp,
                kind=ComponentEventKind.CRASHED,
                container=container,
                unique_id=1,
                attempt=number,
                full_node_name=key.name,
                package_name=text,
                plugin_name=text,
                backtrace=(text, text),
            ),
        ]
        events += [
            NodeStateChanged(
                stamp_ns=stamp,
                key=key,
                state=state,
                reason=text,
                attempt=number,
                crashes=int(state is NodeState.CRASHED),
            )
            for state in states
        ]
        died = ProcessEventKind.EXITED
        events.append(
            ProcessEvent(stamp_ns=stamp, kind=died, name=f"{text}!", exit_code=1, message=text)
        )
    return record(folder / "session.mcap", events, name=HOSTILE[0], config="\n".join(HOSTILE))


def record(
    path: Path, events: list[RunEvent], *, name: str = "robot", config: str = "a: 1\n"
) -> Path:
    """Write a recording whose times are those of its events."""
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = BagWriter(path)
    writer.attach("config.yaml", "application/yaml", config.encode(), time=BEGIN)
    host = b'{"hostname": "</script><b>", "cpus": 2}'
    writer.attach("host.json", "application/json", host, time=BEGIN)
    writer.metadata(METADATA_NAME, {"name": name, "started_ns": str(BEGIN), "id": "x"})
    channels = {topic: writer.register(topic) for topic in ALL_TOPICS}
    for event in events:
        for topic, data, _ in convert(event):
            stamp = event.stamp_ns
            writer.write(channels[topic], data, log_time=stamp, publish_time=stamp)
    writer.close()
    return path

"""Layouts show what a recording holds, by the names that it has there."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

from mcap.reader import make_reader

from play_launch.cli.layout import layout as show_layout
from play_launch.container.cdr.messages import PROCESS_STATS, STATE_EVENT, SYSTEM_STATS
from play_launch.postmortem.export.layouts import (
    MOST,
    Subjects,
    chosen,
    foxglove_layout,
    plotjuggler_layout,
)
from play_launch.postmortem.timeline import read_timeline
from play_launch.supervisor.events import MemoryKind, NodeState, RunEvent, SubjectKind, SystemSample
from tests.postmortem.export.test_trace import KEY, node, sample
from tests.postmortem.test_past_session import record

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

FOXGLOVE_PATH = re.compile(r"(?P<topic>/[\w/]+)(?:\{\w+==[^{}]+\})*\.(?P<field>\w+)")
FIELDS = {
    "play_launch_msgs/msg/ProcessStats": PROCESS_STATS.types,
    "play_launch_msgs/msg/SystemStats": SYSTEM_STATS.types,
    "play_launch_msgs/msg/StateEvent": STATE_EVENT.types,
}
SYSTEM = SystemSample(
    **dict.fromkeys(SystemSample.__struct_fields__, 0)  # type: ignore[arg-type]
    | {"core_percent": (), "core_mhz": ()}
)
STORY: list[RunEvent] = [
    node(NodeState.LOADED),
    sample(kind=SubjectKind.CONTAINER, key="/box", cpu_seconds=5.0),
    sample(memory_kind=MemoryKind.SHARED, cpu_seconds=1.0),
    sample(kind=SubjectKind.PROCESS, key="/[tool]", cpu_seconds=9.0),
    SYSTEM,
]


def fields_of(path: Path) -> dict[str, set[str]]:
    """The numeric fields of each topic, by the schemas in the file."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return {
        channel.topic: set(FIELDS.get(summary.schemas[channel.schema_id].name, {}))
        for channel in summary.channels.values()
    }


def panels(layout: dict[str, Any]) -> set[str]:
    def leaves(part: Any) -> set[str]:
        if isinstance(part, str):
            return {part}
        assert part["direction"] in {"row", "column"}
        assert 0 < part["splitPercentage"] < 100
        return leaves(part["first"]) | leaves(part["second"])

    return leaves(layout["layout"])


def test_foxglove_finds_every_path_in_the_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = record(tmp_path / "x.mcap", STORY)
    assert show_layout("foxglove", path) == 0
    layout = json.loads(capsys.readouterr().out)
    assert panels(layout) == layout["configById"].keys()
    fields = fields_of(path)
    shown = set()
    for config in layout["configById"].values():
        for each in config.get("paths", []):
            found = FOXGLOVE_PATH.fullmatch(each["value"])
            assert found, each["value"]
            assert found["field"] in fields[found["topic"]]
            shown.add((found["topic"], found["field"], each["label"]))
        assert config.get("topicToRender", "/play_launch/output") in fields
    assert ("/play_launch/node/talker/stats", "cpu_percent", "/talker") in shown
    assert ("/play_launch/container/box/stats", "memory_bytes", "/box") in shown
    # It has no memory of its own.
    assert ("/play_launch/node/talker/stats", "memory_bytes", "/talker") not in shown
    assert ("/play_launch/states", "state", "/talker") in shown


def test_panels_have_titles_in_both_viewers_and_legends_hide_no_curve() -> None:
    titles = set()
    for kind, config in foxglove_layout(Subjects())["configById"].items():
        assert config["foxglovePanelTitle"] == config["lichtblickPanelTitle"]
        titles.add(config["foxglovePanelTitle"])
        if kind.startswith("Plot!"):
            assert config["legendDisplay"] != "floating"
    assert len(titles) == 7


def test_plotjuggler_finds_every_curve_in_the_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = record(tmp_path / "x.mcap", STORY)
    assert show_layout("plotjuggler", path) == 0
    root = ET.fromstring(capsys.readouterr().out.encode())
    fields = fields_of(path)
    curves = {curve.attrib["name"] for curve in root.iter("curve")}
    for curve in curves:
        topic, _, field = curve.rpartition("/")
        assert field in fields[topic]
    assert "/play_launch/node/tool/stats/cpu_percent" in curves
    for splitter in root.iter("DockSplitter"):
        assert int(splitter.attrib["count"]) == len(list(splitter))
        assert len(splitter.attrib["sizes"].split(";")) == len(list(splitter))


def test_without_a_recording_the_machine_and_the_log_are_shown() -> None:
    text = json.dumps(foxglove_layout(Subjects()))
    assert "/play_launch/system.cpu_percent" in text
    assert "/play_launch/output" in text
    tabs = ET.fromstring(plotjuggler_layout(Subjects()).encode()).iter("Tab")
    assert [tab.attrib["tab_name"] for tab in tabs] == ["machine"]


def test_of_many_nodes_those_that_failed_and_the_busiest_are_shown(tmp_path: Path) -> None:
    events: list[RunEvent] = [
        sample(key=f"/box:/n{number}", cpu_seconds=float(number)) for number in range(30)
    ]
    events += [sample(cpu_seconds=0.5), node(NodeState.CRASHED)]
    subjects = chosen(read_timeline(record(tmp_path / "x.mcap", events)))
    assert len(subjects.others) == MOST
    assert subjects.others[0].key == str(KEY)
    assert subjects.others[1].key == "/box:/n29"

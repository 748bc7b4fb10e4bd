"""Layouts with which Foxglove and PlotJuggler show a session over one time axis."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Any, Final, NamedTuple
from xml.etree import ElementTree as ET

from play_launch.recording import topics
from play_launch.recording.topics import stats_topic
from play_launch.supervisor.events import MemoryKind, SubjectKind

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from play_launch.postmortem.timeline import Timeline
    from play_launch.postmortem.units import Unit

_RECEIVED: Final = "receiveTime"
_MACHINE_PERCENT: Final = {
    "cpu_percent": "cpu",
    "cpu_some_avg10": "waiting for a core",
    "memory_some_avg10": "waiting for memory",
    "io_some_avg10": "waiting for a disk",
    "steal_percent": "stolen",
}
_COLOURS: Final = (
    "#1f77b4",
    "#d62728",
    "#1ac938",
    "#ff7f0e",
    "#f14cc1",
    "#9467bd",
    "#17becf",
    "#bcbd22",
)
MOST: Final = 12
"""Nodes and processes in one plot."""


class Subjects(NamedTuple):
    """Units that were measured and are shown."""

    containers: Sequence[Unit] = ()
    others: Sequence[Unit] = ()
    """Nodes and processes: those that failed, then those that used the most CPU time."""
    memory: Sequence[Unit] = ()
    """Those of both that have memory of their own."""


def chosen(timeline: Timeline) -> Subjects:
    """Choose of a session that was read to its end."""
    used = {key: total.latest for key, total in timeline.samples.totals().items()}
    units = [unit for unit in timeline.units if unit.key in used]
    units.sort(key=lambda unit: (unit.failure is None, -used[unit.key].cpu_seconds, unit.key))
    containers = [one for one in units if one.kind is SubjectKind.CONTAINER][:MOST]
    others = [one for one in units if one.kind is not SubjectKind.CONTAINER][:MOST]
    own = {key for key, sample in used.items() if sample.memory_kind != MemoryKind.SHARED}
    memory = [one for one in (*containers, *others) if one.key in own]
    return Subjects(containers, others, memory)


def _topic(unit: Unit) -> str:
    return stats_topic(unit.kind, unit.key).name


def foxglove_layout(subjects: Subjects) -> dict[str, Any]:
    """Make a layout, as Foxglove imports it from a file."""
    everything = (*subjects.containers, *subjects.others)
    panels: dict[str, Any] = {
        "StateTransitions!states": _titled("States")
        | {
            "isSynced": True,
            "showPoints": True,
            "paths": [_state_path(one) for one in everything],
        },
        "Plot!cpu": _panel("CPU, percent of one core", _paths(everything, "cpu_percent")),
        "Plot!memory": _panel("Memory in bytes", _paths(subjects.memory, "memory_bytes")),
        "Plot!machine": _panel(
            "Machine, percent",
            [
                _path(f"{topics.SYSTEM.name}.{name}", label)
                for name, label in _MACHINE_PERCENT.items()
            ],
        ),
        "Plot!free": _panel(
            "Free memory and disk, used shared memory, in bytes",
            [
                _path(f"{topics.SYSTEM.name}.memory_available", "memory available"),
                _path(f"{topics.SYSTEM.name}.disk_free", "disk free"),
                _path(f"{topics.SYSTEM.name}.shm_used", "shared memory used"),
            ],
        ),
        "RosOut!output": _log("Output of all processes", topics.OUTPUT.name),
        "RosOut!log": _log("Log of play-launch", topics.LOG_ALL.name),
    }
    left = _column(["StateTransitions!states", "Plot!cpu", "Plot!memory"])
    right = _column(["Plot!machine", "Plot!free", "RosOut!output", "RosOut!log"])
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {"direction": "row", "first": left, "second": right, "splitPercentage": 60},
    }


def _paths(subjects: Iterable[Unit], field: str) -> list[dict[str, Any]]:
    return [_path(f"{_topic(one)}.{field}", one.name) for one in subjects]


def _path(value: str, label: str) -> dict[str, Any]:
    return {"value": value, "label": label, "enabled": True, "timestampMethod": _RECEIVED}


def _state_path(subject: Unit) -> dict[str, Any]:
    which = f'{{key=="{subject.key}"}}{{kind=={subject.kind.value}}}'
    return {
        "value": f"{topics.STATES.name}{which}.state",
        "label": subject.name,
        "enabled": True,
        "timestampMethod": _RECEIVED,
    }


def _panel(title: str, paths: list[dict[str, Any]]) -> dict[str, Any]:
    return _titled(title) | {
        "paths": paths,
        "isSynced": True,
        "xAxisVal": "timestamp",
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        # A floating one of a dozen nodes hides the curves.
        "legendDisplay": "left",
        "showPlotValuesInLegend": True,
        "sidebarDimension": 240,
    }


def _log(title: str, topic: str) -> dict[str, Any]:
    return _titled(title) | {"topicToRender": topic, "minLogLevel": 1, "searchTerms": []}


def _titled(title: str) -> dict[str, Any]:
    # Foxglove reads the one, Lichtblick the other.
    return {"foxglovePanelTitle": title, "lichtblickPanelTitle": title}


def _column(panels: list[str]) -> Any:
    first, *rest = panels
    if not rest:
        return first
    share = 100 / len(panels)
    return {
        "direction": "column",
        "first": first,
        "second": _column(rest),
        "splitPercentage": round(share, 1),
    }


class _Plot(NamedTuple):
    title: str
    curves: tuple[str, ...]


def plotjuggler_layout(subjects: Subjects) -> str:
    """Make a layout, as PlotJuggler loads it from a file."""
    everything = (*subjects.containers, *subjects.others)
    root = ET.Element("root")
    tabs = ET.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    if everything:
        _tab(
            tabs,
            "processes",
            (
                _Plot("CPU, percent of one core", _curves(everything, "cpu_percent")),
                _Plot("memory, bytes", _curves(subjects.memory, "memory_bytes")),
                _Plot("interruptions", _curves(everything, "involuntary_switches")),
            ),
        )
    system = topics.SYSTEM.name
    _tab(
        tabs,
        "machine",
        (
            _Plot("CPU, percent", (f"{system}/cpu_percent", f"{system}/steal_percent")),
            _Plot(
                "pressure, percent of 10 s",
                tuple(
                    f"{system}/{name}_avg10"
                    for name in ("cpu_some", "memory_some", "memory_full", "io_some", "io_full")
                ),
            ),
            _Plot(
                "memory, bytes",
                (f"{system}/memory_available", f"{system}/shm_used", f"{system}/swap_used"),
            ),
            _Plot("load", (f"{system}/load_1", f"{system}/load_5")),
        ),
    )
    ET.SubElement(tabs, "currentTabIndex", {"index": "0"})
    ET.SubElement(root, "use_relative_time_offset", {"enabled": "1"})
    for name in ("Plugins", "customMathEquations", "snippets"):
        ET.SubElement(root, name)
    ET.indent(root, " ")
    return f"<?xml version='1.0' encoding='UTF-8'?>\n{ET.tostring(root, encoding='unicode')}\n"


def _curves(subjects: Iterable[Unit], field: str) -> tuple[str, ...]:
    return tuple(f"{_topic(one)}/{field}" for one in subjects)


def _tab(tabs: ET.Element, name: str, plots: Sequence[_Plot]) -> None:
    tab = ET.SubElement(tabs, "Tab", {"tab_name": name, "containers": "1"})
    container = ET.SubElement(tab, "Container")
    sizes = ";".join(f"{1 / len(plots):.6f}" for _ in plots)
    splitter = ET.SubElement(
        container, "DockSplitter", {"orientation": "-", "count": str(len(plots)), "sizes": sizes}
    )
    for title, curves in plots:
        area = ET.SubElement(splitter, "DockArea", {"name": title})
        plot = ET.SubElement(
            area,
            "plot",
            {"mode": "TimeSeries", "style": "Lines", "flip_x": "false", "flip_y": "false"},
        )
        ET.SubElement(plot, "limitY")
        for curve, colour in zip(curves, cycle(_COLOURS)):
            ET.SubElement(plot, "curve", {"name": curve, "color": colour})

"""A layout for PlotJuggler: a tab for the processes and one for the machine."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Final, NamedTuple
from xml.etree import ElementTree as ET

from play_launch.recording import topics

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from play_launch.postmortem.export.subjects import Subject, Subjects

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


def _curves(subjects: Iterable[Subject], field: str) -> tuple[str, ...]:
    return tuple(f"{one.topic}/{field}" for one in subjects)


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

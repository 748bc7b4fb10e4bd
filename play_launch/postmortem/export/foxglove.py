"""A layout for Foxglove: what happened, the numbers, and the log, over one time axis."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from play_launch.recording import topics

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.postmortem.export.subjects import Subject, Subjects

_RECEIVED: Final = "receiveTime"
_MACHINE_PERCENT: Final = {
    "cpu_percent": "cpu",
    "cpu_some_avg10": "waiting for a core",
    "memory_some_avg10": "waiting for memory",
    "io_some_avg10": "waiting for a disk",
    "steal_percent": "stolen",
}


def foxglove_layout(subjects: Subjects) -> dict[str, Any]:
    """Make a layout, as Foxglove imports it from a file."""
    everything = (*subjects.containers, *subjects.others)
    panels: dict[str, Any] = {
        "StateTransitions!states": _titled("States")
        | {
            "isSynced": True,
            "showPoints": True,
            "paths": [_state(one) for one in everything],
        },
        "Plot!cpu": _plot("CPU, percent of one core", _series(everything, "cpu_percent")),
        "Plot!memory": _plot("Memory in bytes", _series(subjects.memory, "memory_bytes")),
        "Plot!machine": _plot(
            "Machine, percent",
            [
                _path(f"{topics.SYSTEM.name}.{name}", label)
                for name, label in _MACHINE_PERCENT.items()
            ],
        ),
        "Plot!free": _plot(
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


def _series(subjects: Iterable[Subject], field: str) -> list[dict[str, Any]]:
    return [_path(f"{one.topic}.{field}", one.label) for one in subjects]


def _path(value: str, label: str) -> dict[str, Any]:
    return {"value": value, "label": label, "enabled": True, "timestampMethod": _RECEIVED}


def _state(subject: Subject) -> dict[str, Any]:
    which = f'{{key=="{subject.key}"}}{{kind=={subject.kind.value}}}'
    return {
        "value": f"{topics.STATES.name}{which}.state",
        "label": subject.label,
        "enabled": True,
        "timestampMethod": _RECEIVED,
    }


def _plot(title: str, paths: list[dict[str, Any]]) -> dict[str, Any]:
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

"""Metrics of a session for Prometheus, by the conventions of OpenMetrics."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, StateSetMetricFamily
from prometheus_client.openmetrics.exposition import (
    ALLOWUTF8,
    CONTENT_TYPE_LATEST,
    generate_latest,
)
from prometheus_client.registry import CollectorRegistry

from play_launch.control.units import Health, health, target_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from prometheus_client.metrics_core import Metric

    from play_launch.control.messages import UnitRow

CONTENT_TYPE: Final = CONTENT_TYPE_LATEST
_LABELS: Final = ("unit", "kind", "machine")
_COUNTERS: Final[dict[str, tuple[str, Callable[[UnitRow], float]]]] = {
    "restarts": (
        "Restarts of a container or process, reloads of a node after a crash.",
        lambda row: row.restarts,
    ),
    "crashes": ("Crashes of a unit.", lambda row: row.crashes),
}
_GAUGES: Final[dict[str, tuple[str, Callable[[UnitRow], float | None]]]] = {
    "up_seconds": ("Seconds since the unit is up.", lambda row: row.uptime_s),
    "cpu_ratio": (
        "Use of CPU in the last second; 1 is one whole CPU.",
        lambda row: None if row.cpu_percent is None else row.cpu_percent / 100,
    ),
    "memory_bytes": ("Memory of a unit.", lambda row: row.memory_bytes),
}


class Scrape(NamedTuple):
    """What metrics are made of, as the session answers; without a session its name is empty."""

    session: str
    rows: list[UnitRow]
    topics: list[dict[str, Any]]
    recording: dict[str, Any]
    system: dict[str, Any]


class _Families:
    """What Prometheus' client collects."""

    def __init__(self, scrape: Scrape) -> None:
        self._scrape = scrape

    def collect(self) -> Iterator[Metric]:
        session = GaugeMetricFamily(
            "play_launch_session_up", "Whether the session answers.", labels=("session",)
        )
        session.add_metric((self._scrape.session,), float(bool(self._scrape.session)))
        yield session
        if (seconds := self._scrape.system.get("up_after_s")) is not None:
            yield GaugeMetricFamily(
                "play_launch_session_start_seconds",
                "From the start of the session until all was started and loaded.",
                value=seconds,
            )
        states = StateSetMetricFamily(
            "play_launch_unit_state", "The class of a unit's state.", labels=_LABELS
        )
        for row in self._scrape.rows:
            now = health(row)
            states.add_metric(_labels(row), {each.value: each is now for each in Health})
        yield states
        for name, (about, count) in _COUNTERS.items():
            counter = CounterMetricFamily(f"play_launch_unit_{name}", about, labels=_LABELS)
            for row in self._scrape.rows:
                counter.add_metric(_labels(row), count(row))
            yield counter
        for name, (about, figure) in _GAUGES.items():
            gauge = GaugeMetricFamily(f"play_launch_unit_{name}", about, labels=_LABELS)
            for row in self._scrape.rows:
                if (value := figure(row)) is not None:
                    gauge.add_metric(_labels(row), value)
            yield gauge
        failures = CounterMetricFamily(
            "play_launch_unit_failures",
            "How often a unit ended unrequested, by cause.",
            labels=(*_LABELS, "cause"),
        )
        for row in self._scrape.rows:
            for cause, times in row.causes.items():
                failures.add_metric((*_labels(row), cause), times)
        yield failures
        yield from self._topics()
        yield from self._recording()

    def _recording(self) -> Iterator[Metric]:
        found = self._scrape.recording
        if found:
            yield CounterMetricFamily(
                "play_launch_recording_dropped",
                "Events and messages that are not recorded.",
                value=found["dropped"] + found["topic_drops"],
            )
            yield GaugeMetricFamily(
                "play_launch_recording_lag_seconds",
                "How long the oldest event waits that is not recorded yet.",
                value=found["lag"],
            )

    def _topics(self) -> Iterator[Metric]:
        labels = ("topic", "machine")
        met = GaugeMetricFamily(
            "play_launch_topic_as_expected", "Whether a topic is as expected.", labels=labels
        )
        rate = GaugeMetricFamily(
            "play_launch_topic_rate_hertz", "Messages per second of a topic.", labels=labels
        )
        breaks = CounterMetricFamily(
            "play_launch_topic_breaks", "How often a topic was not as expected.", labels=labels
        )
        for row in self._scrape.topics:
            values = (row["topic"], row.get("machine", ""))
            breaks.add_metric(values, row["breaks"])
            if row["is_met"] is not None:
                met.add_metric(values, float(row["is_met"]))
            if row["rate"] is not None:
                rate.add_metric(values, row["rate"])
        yield from (met, rate, breaks)


def _labels(row: UnitRow) -> tuple[str, str, str]:
    return str(target_of(row)), row.kind, row.machine or ""


def exposition(scrape: Scrape) -> bytes:
    """Return the text of a scrape."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Families(scrape))
    # All names are plain, so nothing is escaped; other ways to escape look at each character.
    text: bytes = generate_latest(registry, ALLOWUTF8)  # type: ignore[no-untyped-call]
    return text

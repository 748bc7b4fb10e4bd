"""The tests of the findings can fail: each notices that the detection of its finding is broken."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import pytest

from play_launch.postmortem import detect
from play_launch.postmortem.connections import Connections
from play_launch.postmortem.detect import (
    bring_up,
    connections,
    diagnostics,
    failures,
    recording,
    resources,
)
from play_launch.postmortem.samples import _is_busy
from play_launch.postmortem.timeline import Timeline
from play_launch.postmortem.units import Fault, Unit
from play_launch.supervisor.endpoints import Mismatch
from play_launch.supervisor.events import NodeState
from tests.postmortem import test_detect, test_missing, test_timeline
from tests.postmortem.scenes import Scene
from tests.support.breaks import rewrite

if TYPE_CHECKING:
    from collections.abc import Callable


class Break(NamedTuple):
    """A text in the source of a function, what stands there instead, and the test that notices."""

    rule: Callable[..., Any]
    old: str
    new: str
    notices: Callable[[Path], None]


BREAKS: Final = {
    "blocked": Break(
        failures._blocked,
        "is_failure=not worst",
        "is_failure=worst",
        lambda path: test_detect.test_an_executor_that_was_blocked_in_a_callback(path, True),
    ),
    "crashed": Break(
        Timeline._node_failed,
        "event.state is NodeState.CRASHED",
        "event.state is NodeState.LOST",
        lambda path: test_timeline.test_equal_crashes_are_one_finding_with_all_times(Scene(), path),
    ),
    "stop_timeout": Break(
        Timeline._exited,
        "is Cause.STOP_TIMEOUT",
        "is None",
        lambda path: (
            test_timeline.test_a_unit_that_does_not_stop_is_reported_and_one_that_does_is_not(
                Scene(), path
            )
        ),
    ),
    "died": Break(
        Timeline._exited,
        "fault = Fault.DIED",
        "fault = Fault.KILLED",
        lambda path: test_timeline.test_nodes_that_the_death_of_a_container_hit(Scene(), path),
    ),
    "disk_full": Break(
        recording.detect,
        "free.after < LITTLE_DISK",
        "free.after < 0",
        test_timeline.test_a_recording_without_an_end_is_no_failure_and_a_full_disk_is,
    ),
    "grew": Break(
        resources._growing,
        "[] if key in failed",
        "[] if key not in failed",
        test_timeline.test_a_process_that_grows_without_failing,
    ),
    "disconnected": Break(
        connections._disconnected,
        "is_near and",
        "",
        lambda path: test_detect.test_what_a_failure_left_without_a_publisher(
            path, 0, "until the end"
        ),
    ),
    "incompatible_qos in the graph": Break(
        Mismatch.__str__,
        "self.odd",
        "self.topic",
        test_detect.test_what_the_graph_knows_of_policies_that_do_not_match,
    ),
    "incompatible_type": Break(
        connections._mismatched,
        'each.policy == "type"',
        'each.policy != "type"',
        test_detect.test_topics_whose_types_differ,
    ),
    "misnamed_topic": Break(
        connections._unpublished,
        "unused=True",
        "unused=False",
        test_detect.test_subscriptions_that_nothing_publishes_for,
    ),
    "unpublished": Break(
        Connections._problems,
        "and not now.has_publisher",
        "",
        test_detect.test_subscriptions_that_nothing_publishes_for,
    ),
    "unpublished at the end": Break(
        Connections.take,
        "if self._stopped_ns",
        "if False",
        test_detect.test_a_topic_that_only_a_similar_one_is_published_for,
    ),
    "incompatible_qos": Break(
        connections._reported,
        'by_side[report["other"]]',
        'by_side["publisher"]',
        test_detect.test_publishers_and_subscriptions_that_do_not_match,
    ),
    "interrupted": Break(
        recording.detect,
        "in timeline.interruptions",
        "in timeline.interruptions[1:]",
        lambda path: test_timeline.test_interruptions_of_the_recording(Scene(), path),
    ),
    "killed": Break(
        Timeline._process,
        "if event.cause in _KILLED",
        "if event.cause not in _KILLED",
        lambda path: test_timeline.test_what_is_killed_for_its_own_sake(Scene(), path),
    ),
    "late_bring_up": Break(
        bring_up._late,
        "later < _LATER",
        "later > _LATER",
        lambda path: test_detect.test_a_late_bring_up_with_its_critical_chain(path, 31, True),
    ),
    "left": Break(
        Unit.note_node,
        "not container.is_stopping",
        "container.is_stopping",
        lambda path: test_missing.test_a_node_that_was_unloaded(path, "another program"),
    ),
    "load_failed": Break(
        Timeline._node,
        "NodeState.CRASHED | NodeState.LOAD_FAILED if",
        "NodeState.CRASHED if",
        lambda path: test_timeline.test_a_load_that_failed_and_a_crash_in_a_constructor(
            Scene(), path
        ),
    ),
    "not_brought_up": Break(
        Timeline.fold,
        "state=ManagedState.FAILED",
        "state=ManagedState.FINALIZED",
        test_missing.test_a_managed_node_that_was_not_brought_up,
    ),
    "not_loaded": Break(
        bring_up._absence,
        "since_ns, container = unit.since_ns, timeline.of_name(unit.container)",
        "return None",
        lambda path: test_timeline.test_a_node_that_was_never_loaded(path, NodeState.PENDING),
    ),
    "not_started": Break(
        bring_up._absence,
        "state in _GAVE_UP",
        "state not in _GAVE_UP",
        test_detect.test_a_process_that_cannot_be_started,
    ),
    "oom": Break(
        resources._limited,
        "if group.oom_times",
        "if False",
        test_detect.test_what_the_kernel_kills_and_refuses_for_limits,
    ),
    "diagnostics_error": Break(
        diagnostics.detect,
        "stay[0].level >= ERROR",
        "stay[0].level > ERROR",
        test_detect.test_errors_in_diagnostics_and_silence,
    ),
    "diagnostics_silent": Break(
        diagnostics._silent,
        "(end or end_ns)",
        "end_ns",
        test_detect.test_errors_in_diagnostics_and_silence,
    ),
    "machine_lost": Break(
        failures._machines,
        "*changes[1:], None",
        "*changes[:-1], None",
        test_detect.test_machines_that_were_lost,
    ),
    "machine_restarted": Break(
        failures._machines,
        "each.reason or",
        "not each.reason or",
        test_detect.test_machines_that_were_lost,
    ),
    "not_as_expected": Break(
        connections._unexpected,
        "changes[1:]",
        "changes[:-1]",
        test_detect.test_topics_that_were_not_as_expected,
    ),
    "pids_max": Break(
        resources._limited,
        "if group.refused_times",
        "if False",
        test_detect.test_what_the_kernel_kills_and_refuses_for_limits,
    ),
    "restart_loop": Break(
        failures._looping,
        "end - begin <= _WITHIN",
        "end - begin > _WITHIN",
        lambda path: test_detect.test_a_restart_loop(path, 2, True),
    ),
    "slow": Break(
        Timeline._node,
        "is_repeated and event.reason",
        "is_repeated and not event.reason",
        lambda path: test_timeline.test_a_slow_constructor_with_how_long_it_took(Scene(), path),
    ),
    "starved": Break(
        resources._starving,
        "each is not hog and",
        "each is hog and",
        lambda path: test_timeline.test_a_process_that_starves_others(path, 60.0, 30.0, True),
    ),
    "starved at rest": Break(
        _is_busy,
        "pressure >= _BUSY_PRESSURE",
        "pressure >= 0",
        lambda path: test_timeline.test_a_process_that_starves_others(path, 0.0, 99.0, False),
    ),
    "throttled": Break(
        resources._limited,
        "lasted * _THROTTLED",
        "lasted",
        lambda path: test_detect.test_a_unit_that_its_cpu_limit_throttles(path, 0.3, True),
    ),
    "throttled at rest": Break(
        resources._limited,
        "lasted * _THROTTLED",
        "0",
        lambda path: test_detect.test_a_unit_that_its_cpu_limit_throttles(path, 0.05, False),
    ),
    "unfinished": Break(
        recording.detect,
        "if reader.counts",
        "if not reader.counts",
        test_timeline.test_a_recording_without_an_end_is_no_failure_and_a_full_disk_is,
    ),
}
"""By the kind of the finding."""


@pytest.mark.parametrize("broken", BREAKS.values(), ids=BREAKS)
def test_a_broken_detection_is_noticed(
    broken: Break, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "whole").mkdir()
    (tmp_path / "broken").mkdir()
    broken.notices(tmp_path / "whole")
    rewrite(monkeypatch, broken.rule, broken.old, broken.new)
    with pytest.raises((AssertionError, ValueError)):
        broken.notices(tmp_path / "broken")


def test_each_kind_of_finding_has_a_break() -> None:
    sources = [path.read_text(encoding="utf-8") for path in Path(*detect.__path__).glob("*.py")]
    kinds = {kind for text in sources for kind in re.findall(r'kind="(\w+)"', text)}
    assert kinds | set(Fault) <= BREAKS.keys()

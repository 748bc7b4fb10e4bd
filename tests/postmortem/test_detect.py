"""Findings that need more than one event: limits of control groups, loops, late bring-up."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from msgspec.structs import replace

from play_launch.cli.explain import details, headline
from play_launch.postmortem.diagnostics import LEVELS
from play_launch.postmortem.units import Downtime
from play_launch.supervisor.events import (
    ContainerState,
    ExpectationChanged,
    MachineChanged,
    MachineState,
    NodeState,
    ProcessEventKind,
)
from play_launch.supervisor.outcome import Cause
from tests.postmortem.scenes import DIAGNOSTICS, SECOND, Scene, ns, requested

if TYPE_CHECKING:
    from pathlib import Path

    from play_launch.postmortem.findings import Finding


def text_of(finding: Finding) -> tuple[str, str]:
    """Headline and cause."""
    return headline(finding, ns(0)), next(iter(details(finding)), "")


@pytest.mark.parametrize(("share", "is_found"), [(0.05, False), (0.3, True)])
def test_a_unit_that_its_cpu_limit_throttles(tmp_path: Path, share: float, is_found: bool) -> None:
    scene = Scene()
    for at in range(1, 41):
        # A restart makes a new group, whose numbers begin at 0.
        group, since = (1, 0) if at <= 20 else (2, 20)
        throttled = share * (at - since) if at > 5 else 0.0
        scene.group(at, "/planner", group=group, throttled_seconds=throttled)
    found = scene.story(tmp_path).findings
    assert bool(found) is is_found
    for finding in found:
        what, cause = text_of(finding)
        assert what == (
            "/planner was throttled by its CPU limit, first in the 10 s before 6.000 s after the "
            "start."
        )
        assert cause == "Cause: cpu_max stopped it for 12 s in 39 s."


def test_what_the_kernel_kills_and_refuses_for_limits(tmp_path: Path) -> None:
    scene = Scene()
    for at in range(1, 11):
        scene.group(at, "/mapper", oom_kills=(at >= 4) + 2 * (at >= 7), pids_max_hits=at // 10)
        scene.group(at, "/fine")
    oom, refused = scene.story(tmp_path).findings
    assert (oom.kind, oom.name, oom.times_ns) == ("oom", "/mapper", (ns(4), ns(7)))
    assert "processes killed: 3; that is, " in text_of(oom)[1]
    assert (refused.kind, refused.name, refused.times_ns) == ("pids_max", "/mapper", (ns(10),))


def test_machines_that_were_lost(tmp_path: Path) -> None:
    scene = Scene()
    for at, machine, state, reason in (
        (0.5, "h2", MachineState.STARTING, ""),
        (1, "h2", MachineState.RUNNING, ""),
        (2, "h2", MachineState.UNREACHABLE, "timeout"),
        (4, "h2", MachineState.RUNNING, ""),
        (6, "h2", MachineState.UNREACHABLE, "timeout"),
        (7, "h3", MachineState.FAILED, "no such host"),
        (8, "h4", MachineState.STARTING, "its supervisor was killed"),
        (9, "h4", MachineState.RUNNING, ""),
    ):
        scene.events.append(
            MachineChanged(stamp_ns=ns(at), machine=machine, state=state, reason=reason)
        )
    lost, failed, again = scene.story(tmp_path).findings
    assert text_of(lost) == (
        "machine h2 could not be reached 2 times, first at 2.000 s after the start.",
        "Cause: timeout.",
    )
    assert lost.away == (Downtime("h2", 2 * SECOND), Downtime("h2", None))
    assert text_of(failed)[0] == "machine h3 could not be used at 7.000 s after the start."
    assert text_of(again)[0] == "machine h4 was started again at 8.000 s after the start."
    assert again.away == (Downtime("h4", SECOND),)


def test_topics_that_were_not_as_expected(tmp_path: Path) -> None:
    scene = Scene()
    for at, topic, reason in (
        (1, "/scan", ""),
        (2, "/scan", "3 Hz, expected at least 8 Hz"),
        (5, "/scan", ""),
        (6, "/map", ""),
        (7, "/scan", "no publisher"),
    ):
        scene.events.append(
            ExpectationChanged(stamp_ns=ns(at), topic=topic, is_met=not reason, reason=reason)
        )
    (found,) = scene.story(tmp_path).findings
    assert text_of(found) == (
        "/scan was not as expected 2 times, first at 2.000 s after the start.",
        "Cause: 3 Hz, expected at least 8 Hz.",
    )
    assert found.away == (Downtime("/scan", 3 * SECOND), Downtime("/scan", None))


def test_errors_in_diagnostics_and_silence(tmp_path: Path) -> None:
    scene = Scene()
    for at in range(60):
        lidar = (2, "no data") if at in {5, 6, 7, 20} else (0, "fine")
        camera = (3, "no frames") if at >= 50 else (1, "warm")
        scene.diagnostics(at, lidar=lidar, camera=camera)
        if at < 10:
            scene.diagnostics(at, gps=(0, "fix"))
        if not 10 <= at < 45:
            scene.diagnostics(at, imu=(1, "drifts"))
    story = scene.story(tmp_path)
    lidar_bad, camera_stale, gps_silent, imu_silent = story.findings
    assert text_of(lidar_bad) == (
        "lidar was reported as ERROR 2 times, first at 5.000 s after the start.",
        "Cause: no data, for 3.0 s.",
    )
    assert lidar_bad.is_failure
    assert text_of(camera_stale) == (
        "camera was reported as STALE at 50.000 s after the start.",
        "Cause: no frames, until the end.",
    )
    assert not camera_stale.is_failure
    assert text_of(gps_silent) == (
        "gps fell silent at 9.000 s after the start.",
        "Cause: no report of it for 50 s, until the end.",
    )
    assert not gps_silent.is_failure
    assert text_of(imu_silent) == (
        "imu fell silent at 9.000 s after the start.",
        "Cause: no report of it for 36 s.",
    )
    statuses = story.timeline.diagnostics.statuses
    assert {name: LEVELS[each.level] for name, each in statuses.items()} == {
        "lidar": "OK",
        "camera": "STALE",
        "gps": "STALE",
        "imu": "WARN",
    }


def test_a_status_that_changes_too_often(tmp_path: Path) -> None:
    scene = Scene()
    for at in range(1_010):
        scene.diagnostics(at, lidar=(2 * (at % 2), "no data"))
    (found,) = scene.story(tmp_path).findings
    assert len(found.times_ns) == 500
    assert found.cause == "no data, for 1.0 s; 10 later changes of its level are not counted"


@pytest.mark.parametrize(("given", "is_silent"), [(None, True), (20.0, True), (40.0, False)])
def test_how_long_a_silence_may_be(tmp_path: Path, given: float | None, is_silent: bool) -> None:
    scene = Scene()
    if given is not None:
        scene.resolved = {"record": {"stale_after": given}}
    for at in (0, 35):
        scene.diagnostics(at, gps=(0, "fix"))
    found = scene.story(tmp_path).findings
    assert [each.kind for each in found] == ["diagnostics_silent"] * is_silent


def test_diagnostics_that_cannot_be_read_are_damage(tmp_path: Path) -> None:
    scene = Scene()
    scene.messages.append((ns(1), DIAGNOSTICS, b"\0\1\0\0nonsense"))
    story = scene.story(tmp_path)
    assert not story.findings
    assert "/diagnostics cannot be read" in str(story.timeline.session.reader.damages)


@pytest.mark.parametrize(("pause", "is_loop"), [(2, True), (20, False)])
def test_a_restart_loop(tmp_path: Path, pause: int, is_loop: bool) -> None:
    scene = Scene()
    for number in range(6):
        begin = 1 + number * pause
        scene.process(begin, ProcessEventKind.STARTED, "/driver", pid=number + 1)
        end = begin + pause / 2
        scene.process(end, ProcessEventKind.EXITED, "/driver", pid=number + 1, exit_code=1)
    died, *loops = scene.story(tmp_path).findings
    assert (died.kind, len(died.times_ns)) == ("died", 6)
    assert bool(loops) is is_loop
    for loop in loops:
        assert text_of(loop) == (
            "/driver was restarted in a loop, from 2.000 s after the start on.",
            "Cause: it failed 6 times within 10 s.",
        )


@pytest.mark.parametrize(("loaded", "is_late"), [(31, True), (6, False)])
def test_a_late_bring_up_with_its_critical_chain(
    tmp_path: Path, loaded: float, is_late: bool
) -> None:
    scene = Scene()
    scene.container(0, ContainerState.STARTING)
    scene.container(2, ContainerState.RUNNING)
    for name in ("/a", "/b", "/c"):
        scene.node(2, name, NodeState.REQUESTED)
        scene.node(3, name, NodeState.LOADING)
        scene.node(4, name, NodeState.LOADED)
    scene.node(2, "/map", NodeState.PENDING, reason="waits for topic /tf")
    scene.node(5, "/map", NodeState.REQUESTED)
    scene.node(5, "/map", NodeState.LOADING)
    scene.node(loaded, "/map", NodeState.LOADED)
    # Another program loads it: no attempt of ours.
    scene.node(90, "/guest", NodeState.LOADED, unique_id=9)
    found = scene.story(tmp_path).findings
    assert bool(found) is is_late
    for finding in found:
        assert not finding.is_failure
        what, cause = text_of(finding)
        at = "31.000 s after the start"
        assert what == f"/map in /box was loaded last, 27 s after all other nodes, {at}."
        assert cause == "Cause: /map: its constructor ran for 26 s."
        waited = "its load waited (waits for topic /tf) for 3.0 s, its constructor ran for 26 s"
        assert finding.chain == (
            f"/map, loaded after 31 s: {waited}",
            "/box, started after 2.0 s: it was starting for 2.0 s",
        )


def test_a_process_that_cannot_be_started(tmp_path: Path) -> None:
    scene = Scene()
    scene.process(1, ProcessEventKind.GAVE_UP, "/driver", message="cannot start driver: no file")
    scene.process(1, ProcessEventKind.STARTED, "/fine", pid=1)
    (finding,) = scene.story(tmp_path).findings
    assert finding.is_failure
    what = "/driver was not started: it was given up at 1.000 s after the start."
    assert text_of(finding) == (what, "Cause: cannot start driver: no file.")


def test_a_program_that_cannot_be_executed(tmp_path: Path) -> None:
    scene = Scene()
    scene.process(0, ProcessEventKind.STARTED, "/driver", pid=4)
    died = "exited with status 126"
    scene.process(1, ProcessEventKind.EXITED, "/driver", exit_code=126, message=died)
    why = f"{died}: its program cannot be executed"
    scene.process(1, ProcessEventKind.GAVE_UP, "/driver", message=why)
    (finding,) = scene.story(tmp_path).findings
    assert finding.done == ("gave up: its program cannot be executed",)


def test_publishers_and_subscriptions_that_do_not_match(tmp_path: Path) -> None:
    scene = Scene()
    for at, report in (
        (1, "[robot.slam]: New publisher discovered on topic '/scan', offering incompatible QoS."),
        (2, "[lidar]: New subscription discovered on topic '/scan', requesting incompatible QoS."),
        (3, "[slam]: I know nothing of incompatible QoS"),
    ):
        policy = "Last incompatible policy: DURABILITY_QOS_POLICY"
        scene.line(at, f"[WARN] [1.0] {report} {policy}", "/box")
    (finding,) = scene.story(tmp_path).findings
    what, cause = text_of(finding)
    when = "from 1.000 s after the start on"
    assert what == f"QoS on /scan is incompatible, so messages are lost, {when}."
    assert cause.startswith(
        "Cause: durability: /robot/slam requests more than is offered; "
        "/lidar offers less than is requested; "
    )
    assert finding.hit == ("/robot/slam", "/lidar")


def running() -> Scene:
    """A session with a process that runs until `stopped`."""
    scene = Scene()
    scene.process(0, ProcessEventKind.STARTED, "/rviz", pid=1)
    return scene


def stopped(scene: Scene) -> Scene:
    scene.process(30, ProcessEventKind.STOPPING, "/rviz")
    scene.process(31, ProcessEventKind.EXITED, "/rviz")
    return scene


def test_what_the_graph_knows_of_policies_that_do_not_match(tmp_path: Path) -> None:
    scene = running()
    # Reliability and durability of rmw: 1 is the stronger one.
    scene.graph(1, "/lidar>/scan /_ros2cli_1</map", reliability=2, durability=2)
    scene.graph(2, "/slam</scan /nav</scan", reliability=1, durability=2)
    scene.graph(2, "/rviz</scan", reliability=2, durability=2)
    scene.graph(3, "/server>/map", reliability=1, durability=2)
    scene.graph(3, "/nav</map", reliability=1, durability=1)
    # It is away before it counts.
    scene.graph(10, "/server>/brief", reliability=2)
    scene.graph(10, "/nav</brief", reliability=1)
    scene.graph(12, "", "/nav</brief", reliability=1)
    scene.line(4, "[WARN] [1.0] [nav]: New publisher discovered on topic '/map', offering incompat")
    scan, map_ = stopped(scene).story(tmp_path).findings
    what, cause = text_of(scan)
    at = "from 2.000 s after the start on"
    assert what == f"QoS on /scan is incompatible, so messages are lost, {at}."
    assert cause == (
        "Cause: reliability: /lidar offers best_effort, /nav, /slam requests reliable; to change: "
        "request best_effort in /nav, /slam."
    )
    assert scan.hit == ("/nav", "/slam", "/lidar")
    assert text_of(map_)[1] == (
        "Cause: durability: /server offers volatile, /nav requests transient_local; to change: "
        "offer transient_local in /server or request volatile in /nav."
    )


def test_topics_whose_types_differ(tmp_path: Path) -> None:
    scene = running()
    scene.graph(1, "/lidar>/scan:a/msg/Scan /slam</scan:a/msg/Points")
    (finding,) = stopped(scene).story(tmp_path).findings
    assert finding.kind == "incompatible_type"
    assert text_of(finding)[1] == (
        "Cause: /lidar publishes a/msg/Scan, /slam subscribes to a/msg/Points."
    )


def test_a_topic_that_only_a_similar_one_is_published_for(tmp_path: Path) -> None:
    scene = running()
    scene.graph(1, "/lidar>/lidar/scan /slam</scan /imu>/scan_raw:a/msg/Other /rosbag>/rosout")
    stopped(scene)
    # What comes and goes after all have stopped is no fault.
    scene.graph(30.5, "", "/lidar>/lidar/scan")
    scene.graph(36, "/late</late")
    (finding,) = scene.story(tmp_path).findings
    assert finding.is_failure
    what, cause = text_of(finding)
    at = "from 1.000 s after the start on"
    assert what == f"/slam subscribed to /scan, which had no publisher until the end, {at}."
    assert cause == (
        "Cause: did you mean /lidar/scan? It has the same type, /lidar publishes it, and nothing "
        "subscribes to it."
    )


def test_subscriptions_that_nothing_publishes_for(tmp_path: Path) -> None:
    scene = running()
    scene.graph(1, "/teleop</joy:a/msg/Joy /drive>/cmd_vel /safe</cmd_vel /viz</cmd_vell")
    scene.graph(1, "/_ros2cli_8>/goal /planner</goal")
    scene.graph(1, "/viz</cam_1/image:a/msg/Image /cam_2>/cam_2/image:a/msg/Image")
    scene.graph(1, "/viz</left/points:a/msg/Cloud /right>/right/points:a/msg/Cloud")
    scene.graph(2, "/tool>/unwanted /_ros2cli_7</nothing /late</path")
    scene.graph(8, "/planner>/path")
    (finding,) = stopped(scene).story(tmp_path).findings
    assert not finding.is_failure
    assert text_of(finding)[1] == (
        "Cause: /joy (/teleop), /cmd_vell (/viz, did you mean /cmd_vel?), /cam_1/image (/viz), "
        "/left/points (/viz)."
    )


@pytest.mark.parametrize(("back", "how_long"), [(25, "for 10 s"), (0, "until the end")])
def test_what_a_failure_left_without_a_publisher(
    tmp_path: Path, back: float, how_long: str
) -> None:
    scene = running()
    scene.process(0, ProcessEventKind.STARTED, "/lidar", pid=2)
    scene.graph(1, "/lidar>/scan /slam</scan /lidar</cmd /drive>/cmd /other>/x /slam</x")
    scene.graph(1, "/lidar>/points /slam</points")
    scene.graph(8, "", "/lidar>/points")  # long before it fails
    scene.process(14, ProcessEventKind.EXITED, "/lidar", pid=2, signal=11)
    scene.graph(15, "", "/lidar>/scan /lidar</cmd")
    # Nothing of this system failed then.
    scene.graph(22, "", "/other>/x")
    if back:
        scene.process(24, ProcessEventKind.STARTED, "/lidar", pid=3)
        scene.graph(25, "/lidar>/scan /lidar</cmd")
    died, scan, cmd = stopped(scene).story(tmp_path).findings
    assert died.kind == "died"
    at = "from 15.000 s after the start on"
    assert text_of(scan)[0] == f"/lidar left /scan without a publisher {how_long}, {at}."
    assert text_of(cmd)[0] == f"/lidar left /cmd without a subscription {how_long}, {at}."
    assert (scan.hit, cmd.hit, scan.is_failure) == (("/slam",), ("/drive",), False)


def test_what_the_next_process_writes_at_once_is_not_the_last_of_the_one_before(
    tmp_path: Path,
) -> None:
    scene = Scene()
    scene.process(0, ProcessEventKind.STARTED, "/driver", pid=4)
    scene.line(0.9, "the range finder does not answer", "/driver")
    scene.process(1, ProcessEventKind.EXITED, "/driver", exit_code=1)
    scene.process(1.05, ProcessEventKind.STARTED, "/driver", pid=5)
    for number in range(30):
        scene.line(1.06, f"line {number} of the next", "/driver")
    scene.process(3, ProcessEventKind.EXITED, "/driver", exit_code=1)
    scene.process(4, ProcessEventKind.STARTED, "/driver", pid=6)
    scene.process(5, ProcessEventKind.EXITED, "/driver", signal=9)
    first, killed = scene.story(tmp_path).findings
    assert first.last_lines == ("the range finder does not answer",)
    assert killed.last_lines == (), "the third one has written nothing"


@pytest.mark.parametrize("returns", [True, False])
def test_an_executor_that_was_blocked_in_a_callback(tmp_path: Path, returns: bool) -> None:
    scene = Scene()
    scene.started()
    scene.node(0.5, "/slam", NodeState.LOADED)
    scene.line(5, "[INFO] [1.0] [slam]: optimising")
    scene.node(16, "/slam", NodeState.LOADED, cause=Cause.BLOCKED, reason="its executor ...")
    if returns:
        scene.node(40, "/slam", NodeState.LOADED, cause=Cause.RETURNED)
        scene.node(75, "/slam", NodeState.LOADED, cause=Cause.BLOCKED, reason="its executor ...")
        scene.node(80, "/slam", NodeState.LOADED, cause=Cause.RETURNED)
    else:
        scene.node(46, "/slam", NodeState.UNLOADING)
    (finding,) = scene.story(tmp_path).findings
    assert (finding.kind, finding.key, finding.is_failure) == ("blocked", "/box:/slam", not returns)
    assert finding.times_ns == ((ns(6), ns(65)) if returns else (ns(6),))
    how = "it returned after 34 s" if returns else "it had not returned after 40 s"
    assert finding.cause == f"one callback kept its executor from everything else; {how}"
    assert finding.last_lines == ("[INFO] [1.0] [slam]: optimising",)


@pytest.mark.parametrize(("cause", "signal"), [(Cause.SIGNAL, 11), (Cause.STOPPED, 2)])
def test_a_crash_while_it_stops(tmp_path: Path, cause: Cause, signal: int) -> None:
    scene = Scene()
    scene.process(0, ProcessEventKind.STARTED, "/driver", pid=4)
    scene.process(1, ProcessEventKind.STOPPING, "/driver", cause=Cause.STOPPED)
    scene.process(2, ProcessEventKind.EXITED, "/driver", signal=signal, cause=cause)
    found = scene.story(tmp_path).findings
    assert [each.kind for each in found] == ["died"] * (signal == 11)
    assert all("stopping" in each.state for each in found)


def test_a_signal_that_an_operator_sent_is_told(tmp_path: Path) -> None:
    scene = Scene()
    scene.process(0, ProcessEventKind.STARTED, "/sleeper", pid=5)
    sent = requested(ns(3), "signal", ("/sleeper",))
    scene.events.append(replace(sent, reason="SIGKILL", command="play-launch signal KILL sleeper"))
    scene.process(3.1, ProcessEventKind.EXITED, "/sleeper", pid=5, signal=9, message="SIGKILL")
    (finding,) = scene.story(tmp_path).findings
    by = "user 0, pid 1: play-launch signal KILL sleeper"
    assert finding.cause == f"SIGKILL; an operator sent SIGKILL ({by})"

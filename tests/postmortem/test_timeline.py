"""What the events of a session come to: failures, their causes, what else was down."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from play_launch.cli.explain import headline, paragraphs
from play_launch.config.dependency import Condition
from play_launch.container.cdr.messages import log_message
from play_launch.postmortem.critical_chain import critical_chain
from play_launch.postmortem.findings import Finding, is_wrong
from play_launch.postmortem.known_causes import BY_NAME, known_cause
from play_launch.postmortem.last_lines import MOST_LOGGERS, LastLines
from play_launch.postmortem.samples import Quantity
from play_launch.postmortem.units import Downtime, Fault
from play_launch.recording import topics
from play_launch.supervisor.events import (
    LogRecord,
    MemoryKind,
    NodeState,
    ProcessEventKind,
    RecordingInterrupted,
    SubjectKind,
    Withdrawn,
)
from play_launch.supervisor.outcome import Cause, Sequel
from tests.postmortem.scenes import (
    NAN,
    SECOND,
    STAYS,
    Scene,
    channel_of,
    message_record,
    ns,
    story_of,
)
from tests.recording.test_states import EVENTS

if TYPE_CHECKING:
    from play_launch.supervisor.events import RunEvent

LOADING, LOADED, LOST = NodeState.LOADING, NodeState.LOADED, NodeState.LOST


def kinds(findings: tuple[Finding, ...]) -> list[tuple[str, str]]:
    return [(each.kind, each.name) for each in findings]


@pytest.fixture(params=[True, False], ids=["codes", "version 1"])
def scene(request: pytest.FixtureRequest) -> Scene:
    """A session of this version, and of the one whose events have sentences only."""
    return Scene(has_codes=request.param)


def test_a_session_in_which_nothing_happened(scene: Scene, tmp_path: Path) -> None:
    scene.started()
    scene.node(0.1, "/talker", LOADING)
    scene.node(0.2, "/talker", LOADED)
    scene.process(5, ProcessEventKind.STOPPING, message="the run is over")
    scene.node(5, "/talker", NodeState.UNLOADED)
    scene.process(5.1, ProcessEventKind.EXITED)
    story = scene.story(tmp_path)
    assert story.findings == ()
    assert [unit.loaded_ns for unit in story.timeline.units if unit.container] == [ns(0.2)]


def test_equal_crashes_are_one_finding_with_all_times(scene: Scene, tmp_path: Path) -> None:
    scene.started()
    scene.node(1, "/talker", LOADED)
    for at in (2, 4):
        scene.crashed(at, "/talker")
        scene.node(at + 0.5, "/talker", LOADING)
        scene.node(at + 1, "/talker", LOADED)
    scene.crashed(6, "/talker", "demo::other()", sequel=STAYS)
    first, second = found = scene.story(tmp_path).findings
    assert kinds(found) == [(Fault.CRASHED, "/talker")] * 2
    assert first.times_ns == (ns(2), ns(4))
    assert first.away == (Downtime("/talker", SECOND), Downtime("/talker", SECOND))
    assert first.done == ("reloaded immediately",)
    assert (first.state, first.since_ns) == ("loaded", ns(1))
    assert first.known == "null_pointer"
    assert second.away == (Downtime("/talker", None),)
    assert str(second.signature) == "SIGSEGV in demo::other (libdemo.so)"


def test_a_load_that_failed_and_a_crash_in_a_constructor(scene: Scene, tmp_path: Path) -> None:
    scene.started()
    scene.node(1, "/gone", NodeState.LOAD_FAILED, reason="libgone.so: no such library")
    scene.crashed(2, "/victim", in_constructor=True)
    gone, victim = scene.story(tmp_path).findings
    assert kinds((gone, victim)) == [
        (Fault.LOAD_FAILED, "/gone"),
        (Fault.LOAD_FAILED, "/victim"),
    ]
    assert (gone.is_crash, gone.known) == (False, "missing_library")
    assert victim.is_crash
    what = "/victim in /box crashed in its constructor at 2.000 s after the start."
    assert headline(victim, ns(0)) == what


def test_nodes_that_the_death_of_a_container_hit(scene: Scene, tmp_path: Path) -> None:
    scene.started()
    for name in ("/a", "/b"):
        scene.node(1, name, LOADED)
    scene.process(2, ProcessEventKind.EXITED, signal=11, message="exited with signal 11 (SIGSEGV)")
    for name in ("/a", "/b"):
        scene.node(2, name, LOST)
    again = "exited with signal 11 (SIGSEGV); starts again in 0.10 s"
    scene.process(
        2,
        ProcessEventKind.RESTARTING,
        message=again,
        cause=Cause.SIGNAL,
        sequel=Sequel.RESTART,
        delay_ns=SECOND // 10,
    )
    scene.process(3, ProcessEventKind.STARTED)
    scene.node(3.5, "/a", LOADED)
    (finding,) = scene.story(tmp_path).findings
    assert (finding.kind, finding.name, finding.hit) == (Fault.DIED, "/box", ("/a", "/b"))
    assert finding.done == ("restarted after 100 ms",)
    assert set(finding.away) == {
        Downtime("/box", SECOND),
        Downtime("/a", SECOND * 3 // 2),
        Downtime("/b", None),
    }


def test_what_is_killed_for_a_dead_node_is_blamed_on_that(scene: Scene, tmp_path: Path) -> None:
    scene.started()
    for name, pid in (("/holder", 7), ("/waiting", 8)):
        scene.node(1, name, LOADED, pid=pid)
    scene.crashed(2, "/holder", signal=9, error_message="SIGKILL", backtrace=())
    why = "killed: a node died with a lock: thread 9 of process 8 waits for one held by process 7"
    cause, culprit = Cause.NODE_LEFT_LOCK, "/box:/holder"
    scene.process(3, ProcessEventKind.STOPPING, message=why, cause=cause, culprit=culprit)
    scene.process(3.1, ProcessEventKind.EXITED, signal=9, cause=cause)
    scene.node(3.1, "/waiting", LOST)
    (finding,) = scene.story(tmp_path).findings
    assert (finding.kind, finding.name) == (Fault.CRASHED, "/holder")
    assert finding.hit == ("/box", "/waiting")
    assert "process 8 (/waiting) waits for one held by process 7 (/holder)" in finding.done[-1]


def test_what_is_killed_for_its_own_sake(scene: Scene, tmp_path: Path) -> None:
    scene.started()
    why, cause = "killed: it is frozen: no answer for 3 s", Cause.FROZEN
    scene.process(3, ProcessEventKind.STOPPING, message=why, cause=cause)
    scene.process(3.1, ProcessEventKind.EXITED, signal=9, cause=cause)
    (finding,) = scene.story(tmp_path).findings
    assert (finding.kind, finding.cause) == (Fault.KILLED, "it is frozen: no answer for 3 s")


def test_a_unit_that_does_not_stop_is_reported_and_one_that_does_is_not(
    scene: Scene, tmp_path: Path
) -> None:
    for name, signal, cause in (
        ("/deaf", 9, Cause.STOP_TIMEOUT),
        ("/good", 2, Cause.STOPPED),
        ("/bad", 11, Cause.SIGNAL),
    ):
        scene.process(0, ProcessEventKind.STARTED, name)
        scene.process(1, ProcessEventKind.STOPPING, name, message="the run is over")
        scene.process(2, ProcessEventKind.EXITED, name, signal=signal, cause=cause)
    died, deaf = (Fault.DIED, "/bad"), (Fault.STOP_TIMEOUT, "/deaf")
    assert kinds(scene.story(tmp_path).findings) == [died, deaf]


DEADLINE = "SIGTERM (it did not leave in time after the signal) in thread 'main'"
TIMEOUT = "SIGABRT (uncaught exception Timeout: the vehicle did not leave in time; it stays away)"


@pytest.mark.parametrize(
    ("signal", "said", "kind"),
    [
        (15, DEADLINE, Fault.STOP_TIMEOUT),
        (6, TIMEOUT, Fault.CRASHED),
        (6, f"a; {DEADLINE}", Fault.CRASHED),
    ],
)
@pytest.mark.parametrize("sequel", [STAYS, ("", Sequel.NONE)])
def test_what_a_program_says_of_its_end_does_not_decide_what_it_is(
    scene: Scene, tmp_path: Path, signal: int, said: str, kind: Fault, sequel: tuple[str, Sequel]
) -> None:
    scene.started()
    scene.node(1, "/gate", LOADED)
    cause = Cause.STOP_TIMEOUT if kind is Fault.STOP_TIMEOUT else Cause.EXCEPTION
    scene.crashed(2, "/gate", signal=signal, error_message=said, sequel=sequel, cause=cause)
    (finding,) = scene.story(tmp_path).findings
    assert (finding.kind, finding.cause) == (kind, said)
    assert finding.done == ()


def test_a_slow_constructor_with_how_long_it_took(scene: Scene, tmp_path: Path) -> None:
    scene.started()
    scene.node(1, "/engine", LOADING)
    for at in (11, 21):
        scene.node(at, "/engine", LOADING, reason=f"its constructor runs for {at - 1:.1f} s")
    scene.node(25, "/engine", LOADED, elapsed_ns=24 * SECOND)
    (finding,) = scene.story(tmp_path).findings
    assert (finding.kind, finding.times_ns) == (Fault.SLOW, (ns(11),))
    assert finding.cause == "its constructor runs for 20.0 s; it took 24 s"
    what = "was slow to construct: it was not ready at 11.000 s after the start."
    assert headline(finding, ns(0)) == f"/engine in /box {what}"


@settings(max_examples=60)
@given(st.lists(EVENTS, max_size=15), st.data())
def test_any_events_make_a_story(events: list[RunEvent], data: st.DataObject) -> None:
    names = ("key", "container", "name", "unit")
    keys = {str(getattr(event, name)) for event in events for name in names if hasattr(event, name)}
    dependency = st.fixed_dictionaries(
        {"condition": st.sampled_from([*Condition]), "unit": st.sampled_from(sorted(keys) or [""])}
    )
    rules = {key: {"dependencies": data.draw(st.lists(dependency, max_size=3))} for key in keys}
    with tempfile.TemporaryDirectory() as folder:
        story = Scene(events, resolved={"start_rules": rules}).story(Path(folder))
        lines = list(paragraphs(story.findings, story.timeline))
        for unit in story.timeline.units:
            chain = critical_chain(story.timeline, unit)
            assert 1 <= len(chain) <= len(story.timeline.units)
            assert all(step.ns > 0 for link in chain for step in link.steps)
    assert all(finding.times_ns for finding in story.findings)
    assert lines[-1].endswith(".")
    assert msgspec.json.encode(story.findings)


def test_just_before_the_start_is_at_the_start() -> None:
    finding = Finding(
        kind="crashed", rank=0, says="crashed {when}", name="/a", times_ns=(ns(1) - 9,)
    )
    assert headline(finding, ns(1)) == "/a crashed at 0.000 s after the start."


@pytest.mark.parametrize("state", [NodeState.PENDING, LOST])
def test_a_node_that_was_never_loaded(tmp_path: Path, state: NodeState) -> None:
    scene = Scene()
    scene.started()
    scene.node(1, "/late", state)
    scene.node(1, "/gone", state)
    scene.events.append(Withdrawn(stamp_ns=ns(2), kind=SubjectKind.NODE, key="/box:/gone"))
    story = scene.story(tmp_path)
    assert kinds(story.findings) == [("not_loaded", "/late")]
    what = "not loaded again" if state is LOST else "never loaded"
    text = f"/late in /box was {what}: it was {state} since 1.000 s after the start."
    assert headline(story.findings[0], ns(0)) == text
    assert story.timeline.size() == {"container": 1, "node": 1, "process": 0}


def test_the_last_lines_are_those_of_the_node(scene: Scene, tmp_path: Path) -> None:
    scene.started()
    scene.node(0.5, "/ns/talker", LOADED)
    for number in range(30):
        scene.line(1 + number / 100, f"[INFO] [1.0] [ns.talker]: {number}")
        scene.line(1 + number / 100, f"[INFO] [1.0] [ns.talker_two]: {number}")
    scene.line(1.9, "[INFO] [1.0] [ns.talker.child]: child")
    scene.line(1.95, "plain")
    scene.crashed(2, "/ns/talker")
    scene.node(2.1, "/ns/talker", LOADING)
    scene.line(2.15, "[INFO] [1.0] [ns.talker]: I am new")
    (finding,) = scene.story(tmp_path).findings
    lines = [f"[INFO] [1.0] [ns.talker]: {number}" for number in range(12, 30)]
    assert finding.last_lines == (*lines, "[INFO] [1.0] [ns.talker.child]: child", "plain")


def test_loggers_whose_names_count_up_take_bounded_memory() -> None:
    lines = LastLines()
    channels = {0: channel_of(topics.OUTPUT.name)}
    count = 20 * MOST_LOGGERS
    for number in range(count):
        data = b"".join(
            message_record(log_message(number, 20, "/box", text), number)
            for text in (
                f"[INFO] [1.0] [worker_{number}]: done",
                f"[INFO] [1.0] [talker]: {number}",
            )
        )
        assert lines.take(data, 0, channels) == (len(data), number)
    (rings,) = lines._rings.values()
    assert len(rings) <= MOST_LOGGERS
    last = f"[INFO] [1.0] [talker]: {count - 1}"
    assert lines.of("/box", "/talker", count)[-1] == last
    assert len(lines.of("/box", f"/worker_{count - 1}", count)) == 1


def test_what_grew_before_a_failure(tmp_path: Path) -> None:
    scene = Scene()
    scene.process(0, ProcessEventKind.STARTED, "/leaker", pid=7)
    for at in range(10):
        scene.used(at, "/leaker", pid=6, memory_bytes=9 * 10**9)
    for at in range(10, 20):
        scene.used(at, "/leaker", memory_bytes=at * 10**7)
    scene.process(20, ProcessEventKind.EXITED, "/leaker", pid=7, signal=9)
    (finding,) = scene.story(tmp_path).findings
    (trend,) = finding.before
    assert (trend.name, trend.quantity) == ("/leaker", Quantity.MEMORY)
    assert (trend.before, trend.after) == (10**8, 19 * 10**7)
    assert (trend.begin_ns, trend.end_ns) == (ns(10), ns(19))


def test_the_memory_of_the_container_is_not_held_against_a_node(tmp_path: Path) -> None:
    scene = Scene()
    for at in range(10):
        scene.used(at, "/box:/a", memory_bytes=at * 10**9, memory_kind=MemoryKind.SHARED)
    scene.crashed(10, "/a")
    (finding,) = scene.story(tmp_path).findings
    assert finding.before == ()


def test_a_process_that_grows_without_failing(tmp_path: Path) -> None:
    scene = Scene()
    for at in range(100):
        scene.used(at, "/leaker", memory_bytes=10**8 + at * 10**7)
        # Takes its memory at once and keeps it.
        scene.used(at, "/big", memory_bytes=10**7 if at < 2 else 10**9)
    (finding,) = scene.story(tmp_path).findings
    assert (finding.kind, finding.name) == ("grew", "/leaker")
    text = "memory 200.0 MB -> 1.09 GB in 1 min 29 s, still rising at the end"
    assert headline(finding, ns(0)) == f"/leaker may leak: {text}."


@pytest.mark.parametrize(
    ("pressure", "percent", "is_busy"),
    [(0.0, 99.0, False), (60.0, 30.0, True), (NAN, 99.0, True), (NAN, 50.0, False)],
)
def test_a_process_that_starves_others(
    tmp_path: Path, pressure: float, percent: float, is_busy: bool
) -> None:
    scene = Scene()
    for at in range(10):
        scene.machine(at, cpu_some_avg10=pressure, cpu_percent=percent)
        scene.used(at, "/hog", cpu_seconds=0.99 * at, involuntary_switches=at)
        scene.used(at, "/box:/poor", cpu_seconds=0.01 * at, involuntary_switches=50 * at)
        scene.used(at, "/idle", cpu_seconds=0.01 * at)
    found = scene.story(tmp_path).findings
    if not is_busy:
        assert found == ()
        return
    (finding,) = found
    assert (finding.kind, finding.name, finding.hit) == ("starved", "/hog", ("/poor",))


def test_a_recording_without_an_end_is_no_failure_and_a_full_disk_is(tmp_path: Path) -> None:
    scene = Scene()
    scene.started()
    scene.machine(1)
    path = scene.record(tmp_path / "cut.mcap", finished=False)
    found = story_of(path).findings
    assert kinds(found) == [("unfinished", "")]
    assert not is_wrong(found)
    scene.machine(2, disk_free=1000)
    path = scene.record(tmp_path / "full.mcap", finished=False)
    found = story_of(path).findings
    assert [each.kind for each in found] == ["disk_full", "unfinished"]
    assert is_wrong(found)


def test_interruptions_of_the_recording(scene: Scene, tmp_path: Path) -> None:
    scene.started()
    why = "cannot write x.mcap: No space left on device"
    for at, text in (
        (1, f"the recording is interrupted: {why}"),
        (3, "recording resumed after 2.0 s, no data lost"),
    ):
        scene.events.append(
            LogRecord(
                stamp_ns=ns(at), level=40, name="play_launch.recording.recorder", message=text
            )
        )
    if scene.has_codes:
        event = RecordingInterrupted(stamp_ns=ns(1), reason=why, lasted_ns=2 * SECOND)
        scene.events.append(event)
    (finding,) = scene.story(tmp_path).findings
    assert (finding.kind, finding.known) == ("interrupted", "disk_full")
    assert (finding.times_ns, finding.cause) == ((ns(1),), why)
    assert finding.done == ("it resumed after 2.0 s, no data lost",)


def test_a_node_that_is_given_up(scene: Scene, tmp_path: Path) -> None:
    scene.started()
    scene.node(1, "/talker", LOADED)
    scene.crashed(2, "/talker", sequel=("", Sequel.GAVE_UP))
    why = "SIGSEGV (no memory at address 0x0) in thread 'main'; restart limit reached (3 in 60 s)"
    scene.node(2, "/talker", NodeState.GAVE_UP, reason=why, crashes=1)
    (finding,) = scene.story(tmp_path).findings
    assert finding.done == ("gave up: restart limit reached (3 in 60 s)",)
    assert finding.away == (Downtime("/talker", None),)


def test_only_failures_gives_the_same_failures(tmp_path: Path) -> None:
    scene = Scene()
    scene.started()
    scene.node(1, "/a", LOADED)
    scene.line(1.5, "hello")
    scene.crashed(2, "/a")
    path = scene.record(tmp_path / "x.mcap")
    (fast,) = story_of(path, only_failures=True).findings
    (whole,) = story_of(path).findings
    assert (fast.signature, fast.last_lines) == (whole.signature, ())
    assert whole.last_lines == ("hello",)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("write failed: No space left on device", "disk_full"),
        ("terminate called after throwing an instance of 'std::bad_alloc'", "out_of_memory"),
        ("MemoryError", "out_of_memory"),
        ("ModuleNotFoundError: No module named 'x'", "missing_library"),
        ("libx.so: cannot open shared object file: No such file", "missing_library"),
        ("libx.so: undefined symbol: _ZN1aE", "missing_symbol"),
        (
            "rclcpp::exceptions::InvalidParameterTypeException: parameter 'x'",
            "wrong_parameter_type",
        ),
        ("SIGSEGV (no memory at address 0x8) in thread", "null_pointer"),
        ("SIGSEGV (no memory at address 0x7f0012345678)", ""),
        ("*** stack smashing detected ***: terminated", "stack_smashed"),
        ("free(): invalid pointer", "heap_broken"),
        ("bind: Address already in use", "address_in_use"),
        ("exited with status 127: its program was not found", "missing_program"),
        (
            "object 'libx.so' cannot be preloaded (cannot open shared object file): ignored.",
            "",
        ),
        ("all is well", ""),
    ],
)
def test_well_known_causes(text: str, name: str) -> None:
    assert known_cause(text, ()) == name
    assert known_cause("exited with status 1", ("before", text, "after")) == name
    assert not name or BY_NAME[name].means


@pytest.mark.parametrize("line", ["free(): invalid pointer", "bind: Address already in use"])
def test_a_line_is_no_cause_of_a_kill_from_outside(line: str) -> None:
    killed = "exited with signal 9 (SIGKILL): sent by a process, not by the kernel"
    assert known_cause(killed, (line,)) == ""
    # A reason that names one itself keeps it.
    assert known_cause(f"{killed}: out of memory", (line,)) == "out_of_memory"

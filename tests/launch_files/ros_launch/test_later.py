"""What a launch file starts later: handlers of events, timers, lifecycle states."""

from __future__ import annotations

import pytest

from play_launch.config.model import Autostart
from play_launch.launch_files.records import Description, Event, StartCondition
from tests.launch_files.ros_launch.prefix import Prefix, prefix, processes
from tests.support.launch import IS_INSTALLED

__all__ = ["prefix"]

HEAD = """
from launch import EventHandler, LaunchDescription
from launch.actions import *
from launch.event_handlers import *
from launch.events import IncludeLaunchDescription as Included
from launch.events import matches_action, Shutdown as ShutdownEvent
from launch.events.process import *

def process(name):
    return ExecuteProcess(cmd=["true", name])

async def sleep(context):
    pass

class Stop(ShutdownEvent):
    pass

every = lambda action: True
a, b, c, d, e = (process(name) for name in "abcde")
"""
MANAGED = """
from launch_ros.actions import *
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from lifecycle_msgs.msg import Transition

def change(node, transition):
    return EmitEvent(event=ChangeState(
        lifecycle_node_matcher=matches_action(node), transition_id=transition))

m = LifecycleNode(package="pkg", executable="talker", name="m", namespace="")
CONFIGURE, ACTIVATE = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE
"""


def on_exit(of: str, *then: str) -> str:
    return f"RegisterEventHandler(OnProcessExit(target_action={of}, on_exit=[{', '.join(then)}]))"


def on_start(of: str, *then: str) -> str:
    return f"RegisterEventHandler(OnProcessStart(target_action={of}, on_start=[{', '.join(then)}]))"


def timer(period: float, *then: str) -> str:
    return f"TimerAction(period={period}, actions=[{', '.join(then)}])"


def when(node: str, goal: str, then: str) -> str:
    handler = f"OnStateTransition(target_lifecycle_node={node}, goal_state={goal!r}"
    return f"RegisterEventHandler({handler}, entities=[{then}]))"


@pytest.fixture
def evaluated(prefix: Prefix, request: pytest.FixtureRequest) -> Description:
    lines = ",\n        ".join(request.param)
    head = HEAD
    if "m" in request.param:
        if not IS_INSTALLED:
            pytest.skip("ROS's launch_ros is not installed here: managed nodes")
        head += MANAGED
    function = "def generate_launch_description():\n    return LaunchDescription([\n        "
    return prefix.evaluate("a.launch.py", f"{head}\n{function}{lines}])\n")


def starts(description: Description) -> dict[str, list[StartCondition]]:
    """Return the conditions of each process, by its name."""
    return {each.name or each.command[-1]: each.start for each in processes(description)}


def exited(unit: str) -> StartCondition:
    return StartCondition(event=Event.EXITED, unit=unit)


def started(unit: str) -> StartCondition:
    return StartCondition(event=Event.STARTED, unit=unit)


def delay(seconds: float) -> StartCondition:
    return StartCondition(event=Event.DELAY, seconds=seconds)


@pytest.mark.parametrize(
    ("evaluated", "expected"),
    [
        ([on_exit("a", "b"), "a"], {"a": [], "b": [exited("p1")]}),
        (
            ["a", on_exit("a", "b"), on_exit("b", "c")],
            {"a": [], "b": [exited("p1")], "c": [exited("p2")]},
        ),
        (["a", on_start("a", "b")], {"a": [], "b": [started("p1")]}),
        ([timer(2.0, "a", timer(3.0, "b"))], {"a": [delay(2)], "b": [delay(2), delay(3)]}),
        (["a", on_exit("a", timer(1.0, "b"))], {"a": [], "b": [exited("p1"), delay(1)]}),
        (
            ["a", "b", on_exit("a", on_exit("b", "c"))],
            {"a": [], "b": [], "c": [exited("p1"), exited("p2")]},
        ),
        (
            ["a", on_exit("a", "b", on_exit("b", "c"))],
            {"a": [], "b": [exited("p1")], "c": [exited("p2")]},
        ),
        # Never started, so nothing follows it in launch either.
        ([on_exit("a", "b")], {}),
        (["a", on_start("a", on_exit("a", "b"))], {"a": [], "b": [exited("p1")]}),
    ],
    indirect=["evaluated"],
)
def test_processes(evaluated: Description, expected: dict[str, list[StartCondition]]) -> None:
    assert starts(evaluated) == expected
    assert evaluated.losses == []


@pytest.mark.parametrize(
    "evaluated",
    [[timer(3.0, "SetEnvironmentVariable('LATE', '1')", "b"), timer(1.0, "a")]],
    indirect=True,
)
def test_timers_fire_in_the_order_of_their_times(evaluated: Description) -> None:
    found = {each.command[-1]: dict(each.environment) for each in processes(evaluated)}
    assert found == {"a": {}, "b": {"LATE": "1"}}


@pytest.mark.parametrize(
    "evaluated",
    [
        ["ExecuteProcess(cmd=['true', 'a'], on_exit=[Shutdown(reason='over')])"],
        ["a", on_exit("a", "Shutdown()")],
        ["a", "RegisterEventHandler(OnProcessExit(on_exit=[EmitEvent(event=Stop())]))"],
    ],
    indirect=True,
)
def test_shutdown_when_a_process_exits(evaluated: Description) -> None:
    assert [each.ends_all for each in processes(evaluated)] == [True]
    assert evaluated.losses == []


BOTH = "lifecycle_node_names=['m'], transition_ids=[CONFIGURE, ACTIVATE]"


@pytest.mark.parametrize(
    "evaluated",
    [
        [
            "m",
            on_start("m", "change(m, CONFIGURE)"),
            when("m", "inactive", "change(m, ACTIVATE)"),
            when("m", "active", "a"),
        ],
        ["m", f"LifecycleTransition({BOTH})", when("m", "active", "a")],
    ],
    indirect=True,
)
def test_managed_nodes(evaluated: Description) -> None:
    node, process = processes(evaluated)
    assert node.is_lifecycle
    assert node.autostart is Autostart.ACTIVATE
    assert process.start == [StartCondition(event=Event.STATE, unit=node.id, state="active")]
    assert evaluated.losses == []


@pytest.mark.parametrize(
    "evaluated", [["m", "a", "change(m, CONFIGURE)"], ["change(m, CONFIGURE)", "m"]], indirect=True
)
def test_a_node_that_is_only_configured(evaluated: Description) -> None:
    assert processes(evaluated)[0].autostart is Autostart.CONFIGURE


@pytest.mark.parametrize(
    ("evaluated", "words"),
    [
        (
            [
                "a",
                "RegisterEventHandler(OnProcessIO(target_action=a, on_stdout=lambda event: [b]))",
            ],
            "OnProcessIO",
        ),
        (["a", "RegisterEventHandler(OnShutdown(on_shutdown=[b]))"], "OnShutdown"),
        (["a", "Shutdown(reason='over')"], "shuts everything down"),
        (["a", timer(5.0, "Shutdown()")], "when 5 s have passed"),
        (["m", timer(5.0, "change(m, CONFIGURE)")], "when 5 s have passed"),
        (["m", "change(m, Transition.TRANSITION_ACTIVATE)"], "not possible when unconfigured"),
        (
            [
                "a",
                "EmitEvent(event=SignalProcess(signal_number='SIGINT', process_matcher=every))",
            ],
            "ended by the launch file",
        ),
        (
            [
                "a",
                (
                    "RegisterEventHandler(OnProcessExit(target_action=a, "
                    "on_exit=lambda event, context: [b] if event.returncode == 0 else []))"
                ),
            ],
            "a function decides what follows; it is not called",
        ),
        (["OpaqueCoroutine(coroutine=sleep)"], "OpaqueCoroutine"),
        (["EmitEvent(event=Included(LaunchDescription([a])))"], "an emitted IncludeLaunch"),
        (
            ["a", "RegisterEventHandler(OnExecutionComplete(target_action=a, on_completion=[b]))"],
            "OnExecutionComplete: what it does",
        ),
        (
            [
                "a",
                "RegisterEventHandler(EventHandler(matcher=lambda event: 1 / 0, entities=[b]))",
            ],
            "EventHandler: what it does is not carried over",
        ),
        (
            [
                "a",
                "(h := RegisterEventHandler(OnProcessExit(target_action=a, on_exit=[b])))",
                timer(9.0, "UnregisterEventHandler(h.event_handler)"),
            ],
            "UnregisterEventHandler when 9 s have passed: the handler stays",
        ),
        (
            ["a", "b", on_exit("a", on_exit("b", "Shutdown()"))],
            "when true a has exited and then true b has exited",
        ),
        (["m", when("m", "active", "a")], "OnStateTransition: what it handles does not follow"),
        (
            ["a", "RegisterEventHandler(OnProcessStart(on_start=[b]))"],
            "starts again and again with the events of others",
        ),
        (
            [
                "m",
                "change(m, CONFIGURE)",
                "change(m, ACTIVATE)",
                when("m", "active", "change(m, Transition.TRANSITION_DEACTIVATE)"),
                when("m", "inactive", "change(m, ACTIVATE)"),
            ],
            "the transition deactivate when ",
        ),
    ],
    indirect=["evaluated"],
)
def test_what_has_no_record_is_reported_with_its_place(evaluated: Description, words: str) -> None:
    found = [loss for loss in evaluated.losses if words in loss.what]
    assert found
    assert all("a.launch.py:" in loss.where for loss in found)


@pytest.mark.parametrize(
    "evaluated",
    [
        [
            "LogInfo(msg='now')",
            "a",
            on_exit("a", "LogInfo(msg='later')", timer(1.0, "b")),
            on_start("a", "OpaqueFunction(function=lambda context: [c])"),
        ]
    ],
    indirect=True,
)
def test_what_is_only_done_later(capfd: pytest.CaptureFixture[str], evaluated: Description) -> None:
    assert starts(evaluated)["b"] == [exited("p1"), delay(1)]
    assert "c" not in starts(evaluated)
    assert [(loss.what, loss.is_note) for loss in evaluated.losses] == [
        ("OpaqueFunction when true a has started: it is not called", False),
        ("LogInfo when true a has exited", True),
    ]
    errors = capfd.readouterr().err
    assert "now" in errors
    assert "later" not in errors


RELEASE = "def release(*_): print('brakes released', flush=True); return [b]"
HANDLER = """class Mine(EventHandler):
    def handle(self, event, context): return release()
class MyStart(OnProcessStart):
    def handle(self, event, context): return release()"""
RELEASING = "OpaqueFunction(function=release)"
EXITED = "matcher=lambda event: isinstance(event, ProcessExited)"


@pytest.mark.parametrize(
    "entity",
    [
        "RegisterEventHandler(OnProcessExit(target_action=a, on_exit=release))",
        f"RegisterEventHandler(OnProcessExit(on_exit=[{RELEASING}]))",
        "RegisterEventHandler(OnExecutionComplete(target_action=a, on_completion=release))",
        f"RegisterEventHandler(Mine({EXITED}, entities=[]))",
        "RegisterEventHandler(OnProcessStart(target_action=a, on_start=release))",
        f"RegisterEventHandler(OnProcessStart(on_start=[{RELEASING}]))",
        "RegisterEventHandler(MyStart(target_action=a, on_start=[]))",
        f"RegisterEventHandler(OnProcessExit(on_exit=[{timer(1.0, RELEASING)}]))",
    ],
)
def test_functions_for_events_are_reported_and_not_called(
    prefix: Prefix, capfd: pytest.CaptureFixture[str], entity: str
) -> None:
    text = f"""{HEAD}
{RELEASE}
{HANDLER}
def generate_launch_description():
    return LaunchDescription([{entity}, a])
"""
    found = prefix.evaluate("a.launch.py", text)
    assert any("not called" in each.what or "not carried" in each.what for each in found.losses)
    assert not any(each.is_note for each in found.losses)
    assert starts(found) == {"a": []}
    assert "brakes released" not in capfd.readouterr().err


@pytest.mark.parametrize(
    "evaluated", [["ExecuteProcess(cmd=['true'], output_format='{line}')"]], indirect=True
)
def test_what_is_only_done_in_another_way_is_noted(evaluated: Description) -> None:
    (note,) = evaluated.losses
    assert note.is_note
    assert note.what.startswith("output_format")
    assert "a.launch.py:" in note.where


@pytest.mark.parametrize("evaluated", [["a", on_exit("a", "GroupAction([b])")]], indirect=True)
def test_the_place_is_that_of_the_action(evaluated: Description) -> None:
    line = HEAD.lstrip().count("\n", 0, HEAD.lstrip().index("return ExecuteProcess")) + 1
    assert [each.origin.line for each in processes(evaluated)] == [line, line]

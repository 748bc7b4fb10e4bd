from __future__ import annotations

import io
import json
import threading
from typing import TYPE_CHECKING, Any

import pytest
from rich.console import Console

from play_launch.cli.show import display as display_module
from play_launch.cli.show.display import (
    Display,
    JsonStyle,
    LiveStyle,
    PlainStyle,
    ShownEvent,
    Style,
    live_view,
)
from play_launch.supervisor.events import (
    ComponentEvent,
    ComponentEventKind,
    ContainerState,
    LogRecord,
    NodeState,
    ProcessEventKind,
    ProcessSample,
    RunEvent,
)
from play_launch.supervisor.view import SystemView
from tests.cli.scenes import SECOND, START, container, node, output, process, view

if TYPE_CHECKING:
    from collections.abc import Sequence

EMPTY = SystemView()


class StubStyle(Style[ShownEvent]):
    """Collects; ``gate`` stands for a terminal that takes nothing."""

    def __init__(self, error: Exception | None = None) -> None:
        self.shown: list[RunEvent] = []
        self.missed = 0
        self.error = error
        self.gate = threading.Event()
        self.gate.set()
        self.entered = threading.Event()

    def show(self, batch: Sequence[ShownEvent], missed: int) -> float | None:
        if batch:
            self.entered.set()
            self.gate.wait()
            if self.error:
                raise self.error
        self.shown += [shown.event for shown in batch]
        self.missed += missed
        return None


def test_a_blocked_terminal_blocks_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(display_module, "_LINES_LIMIT", 10)
    monkeypatch.setattr(display_module, "_OTHERS_LIMIT", 5)
    style = StubStyle()
    style.gate.clear()
    shower = Display(style)
    shower.publish(output("first"), EMPTY, EMPTY)
    style.entered.wait()
    for number in range(100):
        shower.publish(output(str(number)), EMPTY, EMPTY)
    for _ in range(10):
        shower.publish(container("/c"), EMPTY, EMPTY)
    style.gate.set()
    shower.close()
    assert len(style.shown) == 1 + 10 + 5
    assert style.missed == 90 + 5


def folded(*events: RunEvent) -> list[ShownEvent]:
    shown = []
    before = EMPTY
    for event in events:
        after = before.after(event)
        shown.append(ShownEvent(event, before, after))
        before = after
    return shown


def test_plain_lines_have_a_time_and_a_source() -> None:
    stream = io.StringIO()
    style = PlainStyle(stream, colour=False)
    style.show(folded(container("/c"), node("/c", 0, NodeState.LOADED), output("hello")), 3)
    lines = stream.getvalue().splitlines()
    assert [line.split(" ", 1)[1] for line in lines] == [
        "[/c] /c/n0 loaded (1/1)",
        "[/a] hello",
        "[play-launch] skipped 3 lines (the terminal is too slow); they are in the recording",
    ]


@pytest.mark.parametrize("quiet", [True, False])
def test_samples_are_not_shown_nor_output_where_it_is_quiet(quiet: bool) -> None:
    values: dict[str, Any] = dict.fromkeys(ProcessSample.__struct_fields__, 0)
    style = StubStyle()
    shower = Display(style, quiet=quiet)
    events: list[RunEvent] = [output("x"), node("/c", 0, NodeState.LOADED)]
    for event in (ProcessSample(**values), *events):
        shower.publish(event, EMPTY, EMPTY)
    shower.close()
    assert style.shown == (events[1:] if quiet else events)


def test_a_record_of_the_log_leaves_the_live_view_as_it_is() -> None:
    # It comes from any thread, and what that thread knows of the view may be older.
    stream = io.StringIO()
    style = LiveStyle(Console(file=stream, force_terminal=True, width=80), colour=False)
    heard: list[ShownEvent] = []
    collecting = StubStyle()
    collecting.show = lambda batch, _: heard.extend(batch)  # type: ignore[assignment, method-assign]
    display = Display(collecting)
    for shown in folded(container("/c"), node("/c", 0, NodeState.LOADED)):
        display.publish(*shown)
    display.publish_alone(LogRecord(stamp_ns=1, level=30, name="n", message="late"))
    display.close()
    assert style.show(heard, 0) is None, "all that is declared is there: nothing to draw again"
    style.close()
    assert "late" in stream.getvalue()


def test_json_has_one_object_for_each_event() -> None:
    stream = io.StringIO()
    component = ComponentEvent(
        stamp_ns=1,
        kind=ComponentEventKind.LOAD_FAILED,
        container="/c",
        unique_id=1,
        attempt=2,
        full_node_name="/n",
        package_name="p",
        plugin_name="p::N",
        backtrace=("f",),
    )
    events: list[RunEvent] = [
        component,
        process("/c", ProcessEventKind.GAVE_UP),
        output("grüße\n\x1b\udc80"),
        LogRecord(stamp_ns=1, level=30, name="n", message="m"),
        node("/c", 0, NodeState.LOAD_FAILED),
        container("/c", ContainerState.GAVE_UP),
    ]
    JsonStyle(stream).show(folded(*events), 2)
    objects = [json.loads(line) for line in stream.getvalue().splitlines()]
    assert stream.getvalue().isascii()
    kinds = ["component", "process", "output", "log", "node", "container", "missed"]
    assert [each["event"] for each in objects] == kinds
    assert objects[0]["kind"] == "load_failed"
    assert objects[0]["backtrace"] == ["f"]
    assert objects[1]["kind"] == "gave_up"
    assert objects[2]["text"] == "grüße\n\x1b\udc80"
    assert objects[2]["stream"] == "stdout"
    assert objects[4]["state"] == "load failed"
    assert objects[6]["lines"] == 2


def drawn(system: SystemView, *, width: int = 80, height: int = 24) -> list[str]:
    console = Console(file=io.StringIO(), width=width, height=height, color_system=None)
    console.print(live_view(system, START + 20 * SECOND, height))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue().splitlines()


def test_the_live_view_shows_trouble_first_and_counts_what_is_complete() -> None:
    system = view(
        container("/done"),
        node("/done", 0, NodeState.LOADED),
        container("/slow"),
        node("/slow", 0, NodeState.LOADED),
        node("/slow", 1, NodeState.LOADING, at=8),
        container("/zz_bad"),
        node("/zz_bad", 0, NodeState.LOAD_FAILED),
        process("/listener", ProcessEventKind.STARTED),
        process("/other", ProcessEventKind.EXITED, exit_code=3),
    )
    assert drawn(system) == [
        "  /zz_bad  loaded 0/1, failed: /zz_bad/n0",
        "  /slow  loaded 1/2, waiting on /slow/n1 … 12 s",
        "  /other  exited with status 3",
        "  /done  loaded 1/1",
        "2/4 nodes loaded, 1/3 containers complete, 1/2 processes running",
    ]


def test_the_live_view_fits_a_small_terminal() -> None:
    events: list[RunEvent] = []
    for number in range(30):
        events += [container(f"/c{number:02}"), node(f"/c{number:02}", 0, NodeState.LOADING)]
    lines = drawn(view(*events), width=30, height=10)
    assert len(lines) == 9
    assert all(len(line) <= 30 for line in lines)
    assert lines[0].endswith("…")
    assert lines[-2] == "  … and 23 more"


def test_the_live_style_leaves_the_lines_and_takes_the_view_away() -> None:
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=True, width=60, height=10, color_system=None)
    style = LiveStyle(console, colour=False)
    again = style.show(
        folded(
            container("/c"),
            node("/c", 0, NodeState.LOADING),
            output("hello [bold]not markup[/bold] :smile:"),
            node("/c", 1, NodeState.LOADED),
        ),
        0,
    )
    assert again is not None
    shown = stream.getvalue()
    assert "[/a] hello [bold]not markup[/bold] :smile:\n" in shown
    assert "waiting on /c/n0" in shown
    assert "n1 loaded" not in shown, "the live view tells that already"
    assert style.show(folded(container("/c"), node("/c", 0, NodeState.LOADED)), 0) is None
    style.close()
    assert stream.getvalue().count("\x1b[?25l") == stream.getvalue().count("\x1b[?25h") == 1

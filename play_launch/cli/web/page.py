"""The page: the table of units, the story of one, and the log. Elements of NiceGUI."""

from __future__ import annotations

import json
import time
from typing import TYPE_CHECKING, Any, Final

from fastapi import Request  # noqa: TC002 - FastAPI reads the annotation of the page's function
from nicegui import ui

from play_launch.cli import diagnostics, expect
from play_launch.cli import session_model as model
from play_launch.cli.output import clock, duration, size
from play_launch.cli.status import fields
from play_launch.cli.web.admission import RIGHT, Right
from play_launch.cli.web.commands import CommandError
from play_launch.control.protocol import MEMBER_ACTIONS, NODE_ACTIONS, OperationError
from play_launch.control.units import Health, health, health_counts, target_of

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Sequence

    from nicegui.events import GenericEventArguments, ValueChangeEventArguments

    from play_launch.cli.web.commands import Commands
    from play_launch.cli.web.watch import Watch
    from play_launch.control.messages import UnitRow
    from play_launch.control.units import Target

_REFRESH: Final = 0.5
"""Seconds between two looks for changes."""
_ASK: Final = 1.0
"""Seconds between two looks at diagnostics and topics, while they are shown."""
_EVERY: Final = 3
"""Every how many samples of memory one is drawn; it changes slowly."""
_MOST_ROWS: Final = 500
_MOST_LINES: Final = 300
"""Lines of a log on the page."""
_BATCH: Final = 100
"""Lines that are added at once."""
_COLOURS: Final = {
    Health.FAILED: "red-9",
    Health.CHANGING: "amber-10",
    Health.UP: "green-9",
    Health.INACTIVE: "grey-8",
}
_WIDE: Final = {"classes": "gt-xs", "headerClasses": "gt-xs"}
"""Not on a phone."""
_COLUMNS: Final[list[dict[str, Any]]] = [
    {"name": "name", "label": "Name", "field": "name", "align": "left"},
    {"name": "state", "label": "State", "field": "state", "align": "left"},
    {"name": "uptime", "label": "Up", "field": "uptime", **_WIDE},
    {"name": "restarts", "label": "Restarts", "field": "restarts", **_WIDE},
    {"name": "cpu", "label": "CPU %", "field": "cpu", **_WIDE},
    {"name": "memory", "label": "Memory", "field": "memory", **_WIDE},
    {"name": "last", "label": "Last line", "field": "last", "align": "left", **_WIDE},
]
_NAME: Final = """
<q-td :props="props"><q-btn flat dense no-caps align="left" :label="props.value"
  :class="props.row.inner ? 'q-ml-md' : ''" @click="$parent.$emit('open', props.row.key)" /></q-td>
"""
_STATE: Final = """
<q-td :props="props"><q-badge :color="props.row.colour" text-color="white"
  :label="props.value" /></q-td>
"""
_CURVED: Final = """
<q-td :props="props" class="no-wrap"><svg v-if="props.value" width="60" height="14"
  class="inline q-mr-xs" aria-hidden="true"><polyline fill="none" stroke="currentColor"
  :points="props.row.%s" /></svg>{{ props.value }}</q-td>
"""
_LAST: Final = """
<q-td :props="props"><div class="ellipsis" style="max-width: 40vw">{{ props.value }}</div></q-td>
"""
_TEXT: Final = "overflow-wrap: anywhere; white-space: pre-wrap"
_HEADING: Final = 'role="heading" aria-level="1"'
PROBLEMS_FIRST: Final = "problems first"


def declare(watch: Watch, commands: Commands) -> None:
    """Declare the pages, for all visitors."""

    @ui.page("/", title="play-launch")
    def index(request: Request) -> None:
        _Page(watch, commands, Right(request.scope.get(RIGHT, Right.NOTHING)))

    @ui.page("/sessions", title="sessions")
    async def sessions() -> None:
        _style()
        with ui.header().classes("items-center"):
            ui.link("play-launch", "/").classes("text-white text-h6")
        ui.label("Sessions, the newest first").classes("text-h6").props(_HEADING)
        for entry in await commands.sessions():
            with ui.row().classes("items-center"):
                link = ui.link(entry.name, f"/report/{entry.name}", new_tab=True)
                link.style("color: inherit; text-decoration: underline")
                ui.label(f"{size(entry.size)}{', running' if entry.is_running else ''}")


def _style() -> None:
    ui.dark_mode(value=None)
    ui.add_head_html("<script>document.documentElement.lang = 'en'</script>")
    ui.colors(primary="#0d47a1")


class _Page:
    """One visitor's page."""

    def __init__(self, watch: Watch, commands: Commands, right: Right) -> None:
        self._watch = watch
        self._commands = commands
        self._may_act = right is Right.ACT
        self._seen = -1
        self._story: _UnitDialog | None = None
        _style()
        client = ui.context.client
        client.on_connect(watch.enter)
        client.on_disconnect(watch.leave)
        with ui.header().classes("items-center bg-primary"):
            self._title = ui.label().classes("text-h6").props(_HEADING)
            self._counts = ui.label()
            ui.space()
            ui.label("" if self._may_act else "read only")
            self._bring_up = ui.link("Bring-up", "/sessions", new_tab=True).classes("text-white")
            ui.link("Sessions", "/sessions").classes("text-white")
        self._problem = ui.label().classes("text-red-9 text-weight-bold").props('role="alert"')
        with ui.row().classes("items-center w-full"):
            self._pattern = ui.input("Filter by name", on_change=self._draw_rows).props("clearable")
            orders = [PROBLEMS_FIRST, *(each.value for each in model.Order)]
            self._order = ui.select(
                orders, value=PROBLEMS_FIRST, label="Order", on_change=self._draw_rows
            ).classes("w-40")
        self._table = ui.table(columns=_COLUMNS, rows=[], row_key="key").classes("w-full")
        self._table.props("dense flat")
        slots = {"name": _NAME, "state": _STATE, "last": _LAST}
        slots |= {name: _CURVED % f"{name}_curve" for name in ("cpu", "memory")}
        for name, template in slots.items():
            self._table.add_slot(f"body-cell-{name}", template)
        self._table.on("open", self._open)
        _panel("Findings", "The recording is being read …", self._findings)
        _live("Diagnostics", "auto auto 1fr", self._diagnostics)
        _panel("Connections", "Its ROS graph is being looked through …", self._unconnected)
        _live("Topics", "auto auto auto 1fr", self._topics)
        ui.label("Log").classes("text-h6")
        self._log = _Log(watch)
        ui.timer(_REFRESH, self._refresh)

    def _refresh(self) -> None:
        self._log.refresh()
        if self._story is not None:
            self._story.log.refresh()
        self._problem.text = self._watch.complaint
        if self._seen == self._watch.changes:
            return
        self._seen = self._watch.changes
        self._title.text = self._watch.name or "play-launch"
        ui.page_title(self._title.text)
        self._bring_up.props(f'href="{self._watch.bring_up}"')
        count = len(self._watch.rows)
        left_out = f"; {_MOST_ROWS} are shown" if count > _MOST_ROWS else ""
        if self._watch.missed:
            left_out += f"; {self._watch.missed} events were missed"
        self._counts.text = f"{health_counts(self._watch.rows)}{left_out}" if count else ""
        self._draw_rows()

    def _draw_rows(self) -> None:
        rows = model.matching(self._watch.rows, self._pattern.value or "")
        if self._order.value == PROBLEMS_FIRST:
            # Within a class as declared: nodes stay below their container.
            rows = sorted(rows, key=lambda row: health(row) is not Health.FAILED)
        else:
            rows = model.ordered(rows, model.Order(self._order.value))
        self._table.rows = [self._cells(row) for row in rows[:_MOST_ROWS]]

    def _cells(self, row: UnitRow) -> dict[str, Any]:
        target = target_of(row)
        machine = f"{row.machine} " if row.machine else ""
        cpu, memory = zip(*self._watch.curves.get(target, ((0.0, 0.0),)), strict=True)
        return {
            "key": str(target),
            "name": f"{machine}{model.clean(row.name)}",
            "inner": row.container is not None,
            "state": row.state,
            "colour": _COLOURS[health(row)],
            "uptime": "" if row.uptime_s is None else duration(int(row.uptime_s * 1e9)),
            "restarts": row.restarts,
            "cpu": "" if row.cpu_percent is None else f"{row.cpu_percent:.1f}",
            "cpu_curve": _curve(cpu),
            "memory": "" if row.memory_bytes is None else size(row.memory_bytes),
            "memory_curve": _curve(memory[::-_EVERY][::-1], _EVERY),
            "last": self._watch.last.last.get(target, "")[:200],
        }

    async def _findings(self) -> list[tuple[str, str]]:
        return [("", each) for each in await self._commands.explain(self._watch.folder)]

    async def _diagnostics(self) -> list[tuple[str, ...]]:
        found = self._commands.diagnostics(self._watch.folder)
        found.sort(key=lambda each: (each["level"] == "OK", each["name"]))
        return list(map(diagnostics.cells, found)) or [("nothing so far",)]

    async def _unconnected(self) -> list[tuple[str, str]]:
        found = [(each["name"], each["text"]) for each in await self._commands.check_graph()]
        return found or [("", "everything connects")]

    async def _topics(self) -> list[tuple[str, ...]]:
        rows = map(expect.cells, await self._watch.expectations())
        return [(*row[:3], row[-1]) for row in rows] or [("nothing is expected of topics",)]

    async def _open(self, event: GenericEventArguments) -> None:
        row = next((row for row in self._watch.rows if str(target_of(row)) == event.args), None)
        if row is None:
            ui.notify("it is not part of the system any more")
            return
        self._story = _UnitDialog(
            self._watch, self._commands, row, may_act=self._may_act, closed=self._closed
        )
        await self._story.fill()

    def _closed(self) -> None:
        self._story = None


def _live(title: str, columns: str, ask: Callable[[], Awaitable[list[tuple[str, ...]]]]) -> None:
    """Add rows of texts that are asked for again and again while they are shown."""
    drawn: list[tuple[str, ...]] = []

    async def draw() -> None:
        try:
            rows = await ask()
        except (CommandError, OperationError) as error:
            rows = [(str(error),)]
        if len(rows) > _MOST_ROWS:
            rows[_MOST_ROWS:] = [(f"{len(rows) - _MOST_ROWS} more",)]
        if rows == drawn:
            return
        drawn[:] = rows
        grid.clear()
        with grid:
            for row in rows:
                for text in (*row, *[""] * (columns.count(" ") + 1 - len(row))):
                    ui.label(model.clean(text)).style(_TEXT)

    async def show(event: ValueChangeEventArguments[bool]) -> None:
        asking.active = event.value
        if event.value:
            await draw()

    with ui.expansion(title, on_value_change=show).classes("w-full"):
        grid = ui.grid(columns=columns).classes("gap-x-4")
    asking = ui.timer(_ASK, draw, active=False)


def _panel(title: str, waiting: str, ask: Callable[[], Awaitable[list[tuple[str, str]]]]) -> None:
    """Add what is asked for when it is opened: names with texts of any number of lines."""

    async def show(event: ValueChangeEventArguments[bool]) -> None:
        if not event.value:
            return
        panel.clear()
        with panel:
            ui.label(waiting)
        try:
            rows = await ask()
        except (CommandError, OperationError) as error:
            rows = [("", str(error))]
        panel.clear()
        with panel, ui.grid(columns="auto 1fr").classes("gap-x-4"):
            for name, text in rows:
                ui.label(model.clean(name)).classes("text-weight-bold")
                with ui.column().classes("gap-0"):
                    for line in text.splitlines():
                        ui.label(model.clean(line)).style(_TEXT)

    panel = ui.expansion(title, on_value_change=show).classes("w-full")


class _UnitDialog:
    """All about one unit, in a dialog, with what may be done to it."""

    def __init__(
        self,
        watch: Watch,
        commands: Commands,
        row: UnitRow,
        *,
        may_act: bool,
        closed: Callable[[], None],
    ) -> None:
        self._watch = watch
        self._commands = commands
        self._may_act = may_act
        self._row = row
        self._target = target_of(row)
        with ui.dialog() as self._dialog, ui.card().classes("w-full").style("max-width: 60rem"):
            self._dialog.on("hide", self._dialog.delete)
            self._dialog.on("hide", closed)
            with ui.row().classes("items-center w-full"):
                title = ui.label(model.clean(row.name)).classes("text-h6")
                self._dialog.props(f'aria-labelledby="{title.html_id}"')
                ui.space()
                ui.button(icon="close", on_click=self._dialog.close).props(
                    'flat dense aria-label="close"'
                )
            if may_act:
                with ui.row():
                    for operation in (*MEMBER_ACTIONS, *NODE_ACTIONS):
                        if model.suits(operation, row):
                            ui.button(operation, on_click=self._asker(operation)).props("no-caps")
            self._fields = ui.grid(columns="auto 1fr").classes("gap-x-4 gap-y-1")
            if row.kind == model.COMPONENT:
                with ui.expansion("Parameters", on_value_change=self._ask_parameters) as found:
                    self._parameters = found.classes("w-full")
            self.log = _Log(watch, self._target)
        self._dialog.open()

    async def fill(self) -> None:
        try:
            unit = await self._watch.status(self._target)
        except OperationError as error:
            ui.notify(str(error), type="negative")
            return
        self._fields.clear()
        with self._fields:
            for title, text in fields(unit, time.time_ns()):
                if text:
                    ui.label(title).classes("text-weight-bold")
                    ui.label(model.clean(text)).style("overflow-wrap: anywhere")
            for each in unit["last_restarts"]:
                ui.label(clock(each["stamp_ns"]))
                ui.label(model.clean(each["cause"]))

    async def _ask_parameters(self, event: ValueChangeEventArguments[bool]) -> None:
        if event.value:
            await self._show_parameters()

    async def _show_parameters(self) -> None:
        self._parameters.clear()
        with self._parameters:
            ui.label("The node is being asked …")
        problem, values = "", dict[str, Any]()
        try:
            values = await self._commands.parameters(self._watch.folder, self._row.name)
        except (CommandError, OperationError) as error:
            problem = str(error)
        self._parameters.clear()
        with self._parameters:
            ui.label(problem or ("" if values else "it has none"))
            with ui.grid(columns="auto 1fr").classes("gap-x-4 gap-y-1"):
                for name, value in values.items():
                    ui.label(model.clean(name)).classes("text-weight-bold")
                    ui.label(model.clean(json.dumps(value))).style("overflow-wrap: anywhere")
            if self._may_act and values:
                with ui.row().classes("items-center"):
                    chosen = ui.select(list(values), label="Parameter", value=next(iter(values)))
                    given = ui.input("New value")
                    ui.button("set", on_click=lambda: self._set(chosen.value, given.value))

    async def _set(self, name: str, value: str) -> None:
        try:
            folder = self._watch.folder
            await self._commands.set_parameter(folder, self._row.name, name, value)
        except (CommandError, OperationError) as error:
            ui.notify(str(error), type="negative", multi_line=True, close_button=True)
            return
        await self._show_parameters()

    def _asker(self, operation: str) -> Callable[[], None]:
        return lambda: self._confirm(operation)

    def _confirm(self, operation: str) -> None:
        asked = model.confirmation(operation, self._row, self._watch.rows)

        def confirmed() -> None:
            question.close()
            self._watch.carry_out(asked, outcome)

        def outcome(refusal: str) -> None:
            with self._dialog:
                if refusal:
                    ui.notify(refusal, type="negative", multi_line=True, close_button=True)
                else:
                    done = model.OPERATIONS[operation][1]
                    ui.notify(f"{model.clean(self._row.name)} {done}", type="positive")

        with self._dialog, ui.dialog() as question, ui.card():
            ui.label(asked.question)
            with ui.row():
                ui.button(operation, on_click=confirmed).props("no-caps color=negative")
                ui.button("cancel", on_click=question.close).props("no-caps flat")
        question.open()


class _Log:
    """Lines, by level and text; with a target, its own."""

    def __init__(self, watch: Watch, target: Target | None = None) -> None:
        self._watch = watch
        self._filter = model.LogFilter(target=target)
        self._shown = 0
        with ui.row().classes("items-center"):
            levels = {each.value: each.name.lower() for each in model.LeastLevel}
            self._level = ui.select(levels, value=0, label="Level", on_change=self._again)
            self._level.classes("w-28")
            self._text = ui.input("Lines with", on_change=self._again).props("clearable")
        self._lines = ui.log(max_lines=_MOST_LINES).classes("w-full").style("height: 16rem")
        self._lines.props('tabindex="0" role="log" aria-label="log"')

    def _again(self) -> None:
        self._lines.clear()
        self._shown = 0
        self.refresh(_MOST_LINES)

    def refresh(self, most: int = _BATCH) -> None:
        """Add what is new, at most so many lines: the last ones."""
        lines = self._watch.lines
        if not lines or lines[-1][0] == self._shown:
            return
        fresh = [line for number, line in lines if number > self._shown and self._wants(line)]
        self._shown = lines[-1][0]
        if len(fresh) > most:
            self._lines.push(f"({len(fresh) - most} lines are not shown)")
        for line in fresh[-most:]:
            self._lines.push(model.shown(line).plain, classes=_line_class(line.level))

    def _wants(self, line: model.LogLine) -> bool:
        wanted = (self._text.value or "").lower()
        is_severe = line.level >= (self._level.value or 0)
        return is_severe and self._filter.wants(line) and wanted in line.text.lower()


def _line_class(level: int) -> str:
    return "text-red-9" if level >= model.LeastLevel.ERROR else ""


def _curve(values: Sequence[float], step: int = 1) -> str:
    """Return points of an SVG polyline of 60 by 14, of a minute's samples; the largest is its top.

    ``step`` is the seconds from one to the next.
    """
    most = max(1.0, *values)
    start = 60 - step * len(values)
    return " ".join(
        f"{start + step * x},{13 - 12 * value / most:.1f}" for x, value in enumerate(values)
    )

"""The screen of ``top``: widgets of Textual, keys, and the state behind them."""

from __future__ import annotations

import asyncio
import select
import signal
import sys
import time
from collections import deque
from typing import TYPE_CHECKING, Any, ClassVar, Final

from msgspec import Struct
from msgspec.structs import replace
from rich.text import Text
from textual.app import App
from textual.binding import Binding, BindingType
from textual.coordinate import Coordinate
from textual.widgets import DataTable, Footer, Input, RichLog, Static

from play_launch.cli import session_model as model
from play_launch.cli.session_link import POLL_INTERVAL, SessionLink
from play_launch.cli.top.modals import FilterPrompt, Help, Question
from play_launch.control.protocol import OperationError
from play_launch.control.units import Health, full_name, health, health_counts, target_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from textual.app import ComposeResult

    from play_launch.control.client import ControlClient
    from play_launch.control.messages import UnitRow
    from play_launch.control.units import Target

_FRAME: Final = 0.1
"""Least seconds between two updates of the widgets."""
_SHOWN_SILENCE: Final = 2.0
"""Seconds without an answer that are reported."""
_BATCH: Final = 500
"""Lines that are written into the log at once; of more, the last ones are, and the rest counted."""


class ScreenEnd(Struct, frozen=True):
    """Why the screen is left."""

    signal: int = 0
    is_lost: bool = False
    """The session closed the connection, or its answer is not understood."""
    reason: str = ""


class TopApp(App[ScreenEnd]):
    """One session, until it ends or the user leaves."""

    ENABLE_COMMAND_PALETTE = False
    CSS_PATH = "top.tcss"
    # With priority, the application handles each key before the next one is dispatched: keys that
    # were typed ahead act on the row that the earlier ones selected.
    BINDINGS: ClassVar[list[BindingType]] = [
        *(
            Binding(key, f"operate('{operation}')", operation, priority=True)
            for operation, (key, _) in model.OPERATIONS.items()
        ),
        Binding("question_mark,h", "help", "help", key_display="?", priority=True),
        Binding("q", "quit", "quit", priority=True),
        Binding("slash", "filter", "filter", key_display="/", priority=True),
        Binding("enter", "only_selected", "its log", key_display="Enter", priority=True),
        Binding("l", "next_level", "level", priority=True),
        Binding("o", "sort", "sort", priority=True),
        *(
            Binding(keys, action, show=False, priority=True)
            for keys, action in {
                "O": "reverse",
                "escape": "show_all",
                "tab": "other_pane",
                "ctrl+c": "interrupt",
                "ctrl+z": "suspend_process",
                "up,k": "move(-1)",
                "down,j": "move(1)",
                "pageup": "move_pages(-1)",
                "pagedown,space": "move_pages(1)",
                "home,g": "move_pages(-1000000)",
                "end,G": "move_pages(1000000)",
            }.items()
        ),
    ]

    def __init__(self, client: ControlClient) -> None:
        super().__init__(ansi_color=True)
        self.theme = "ansi-dark"
        self.hello = client.hello
        self._client = client
        self._link: SessionLink | None = None
        self.rows: list[UnitRow] | None = None  # until the session has answered
        self.shown: list[UnitRow] = []
        self._selected: Target | None = None
        self.order = model.Order.DECLARED
        self.is_reversed = False
        self.pattern = ""
        self.log_filter = model.LogFilter()
        self.lines: deque[model.LogLine] = deque(maxlen=model.LINES_LIMIT)
        self._new_lines: deque[model.LogLine] = deque(maxlen=_BATCH)
        self._undrawn = 0  # lines since the last update that did not fit into the batch
        self._last = model.RowLines()
        self._dropped = 0  # lines older than the kept ones
        self._missed = 0  # events that the session could not send in time
        self._follows_log = True
        self._message = ""
        self._is_stale = True
        self._layout: tuple[int, ...] = ()
        self._drawn: list[tuple[Target, list[Text]]] = []
        self._footer: tuple[object, ...] = ()

    def compose(self) -> ComposeResult:
        self._head, self._detail = Static(id="head", markup=False), Static(id="detail")
        self._table: DataTable[Text] = DataTable(id="table", cursor_type="row", cell_padding=0)
        self._log_title = Static(id="log-title", markup=False)
        self.log_view = RichLog(id="log", max_lines=model.LINES_LIMIT, min_width=0, wrap=True)
        yield from (self._head, self._table, self._detail, self._log_title, self.log_view)
        yield Footer(compact=True)

    def on_mount(self) -> None:
        self._link = SessionLink(self._client, self)
        self.set_interval(POLL_INTERVAL, self._link.poll)
        self.set_interval(_FRAME, lambda: self._draw() if self._is_stale else None)
        self.set_interval(1.0, self._tick)

    def on_unmount(self) -> None:
        if self._link is not None:
            self._link.close()

    def end_by(self, number: int) -> None:
        """Leave because of a signal; callable from a signal handler."""
        asyncio.get_running_loop().call_soon_threadsafe(self.exit, ScreenEnd(signal=number))

    def _tick(self) -> None:
        self._is_stale = True
        if self.is_headless:
            return
        poll = select.poll()
        poll.register(sys.stdin.fileno(), 0)
        if poll.poll(0):  # the terminal hung up, with or without a SIGHUP
            signal.setitimer(signal.ITIMER_REAL, 1.0)
            self.exit(ScreenEnd(signal=signal.SIGHUP))

    # Messages of the session.

    def on_rows(self, rows: Sequence[UnitRow]) -> None:
        """Show the rows of an answer to ``ps``."""
        self.rows = list(rows)
        self._last.declare(rows)
        self._arrange()

    def on_line(self, event: Mapping[str, Any]) -> None:
        """Show a line; raises KeyError, TypeError, ValueError."""
        line = model.line_of(event)
        self._dropped += len(self.lines) == model.LINES_LIMIT
        self.lines.append(line)
        self._last.add(line)
        if self.log_filter.wants(line):
            self._undrawn += len(self._new_lines) == _BATCH
            self._new_lines.append(line)
        self._is_stale = True

    def on_missed(self, events: int) -> None:
        self._missed += events

    def on_outcome(self, done: model.Confirmation, failure: str) -> None:
        """Show the outcome of an operation; no failure: it succeeded."""
        name = model.clean(full_name(done.target))
        self._show_message(
            f"{done.operation} {name} failed: {model.clean(failure)}"
            if failure
            else f"{name}: {model.OPERATIONS[done.operation][1]}"
        )

    def on_end(self, reason: str) -> None:
        """Leave: the connection is closed."""
        self.exit(ScreenEnd(is_lost=True, reason=reason))

    # Keys.

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Disable keys below a modal screen, and operations that do not suit the row."""
        if len(self.screen_stack) > 1 and action not in {"interrupt", "suspend_process"}:
            # pop_screen is the action of the help itself.
            return action == "pop_screen"
        if action == "operate":
            return self.selected is not None and model.suits(str(parameters[0]), self.selected)
        return super().check_action(action, parameters)

    async def action_quit(self) -> None:
        self.exit(ScreenEnd())

    def action_interrupt(self) -> None:
        self.exit(ScreenEnd(signal=signal.SIGINT))

    def action_move(self, rows: int) -> None:
        if self._is_in_log:
            end = self.log_view.max_scroll_y
            y = max(0, min(int(self.log_view.scroll_y) + rows, end))
            self._follows_log = y == end
            self.log_view.scroll_to(y=y, animate=False, immediate=True)
        elif self.shown:
            index = max(0, min(self._index() + rows, len(self.shown) - 1))
            self._selected = target_of(self.shown[index])
        self._show_message("")

    def action_move_pages(self, pages: int) -> None:
        pane = self.log_view if self._is_in_log else self._table
        self.action_move(pages * max(pane.size.height - 1, 1))

    def action_other_pane(self) -> None:
        self.screen.set_focus(self._table if self._is_in_log else self.log_view)
        self._draw()

    def action_sort(self) -> None:
        self.order, self.is_reversed = model.following(self.order), False
        self._arrange()

    def action_reverse(self) -> None:
        self.is_reversed = not self.is_reversed
        self._arrange()

    def action_only_selected(self) -> None:
        row = self.selected
        target = target_of(row) if row else None
        only = None if target == self.log_filter.target else target
        self._filter_log(replace(self.log_filter, target=only))

    def action_next_level(self) -> None:
        self._filter_log(replace(self.log_filter, level=model.following(self.log_filter.level)))

    def action_show_all(self) -> None:
        self._message = ""
        self._filter_log(replace(self.log_filter, target=None))
        self.filter_names("")

    def action_help(self) -> None:
        self.push_screen(Help())

    def action_filter(self) -> None:
        self.push_screen(FilterPrompt(self.pattern), self.filter_names)

    def on_input_changed(self, event: Input.Changed) -> None:
        if isinstance(self.screen, FilterPrompt):
            self.filter_names(event.value)

    def action_operate(self, operation: str) -> None:
        row = self.selected
        assert row is not None
        asked = model.confirmation(operation, row, self.rows or ())

        def answered(answer: bool | None) -> None:
            if not answer or self._link is None:
                return
            try:
                self._link.carry_out(asked)
            except OperationError as error:
                self.on_outcome(asked, str(error))
            else:
                self._show_message(f"{operation} {model.clean(row.name)}: in progress")

        self.push_screen(Question(asked.question), answered)

    def filter_names(self, pattern: str | None) -> None:
        self.pattern = pattern or ""
        self._arrange()

    # State.

    @property
    def selected(self) -> UnitRow | None:
        return self.shown[self._index()] if self.shown else None

    @property
    def _is_in_log(self) -> bool:
        return self.screen_stack[0].focused is self.log_view

    def _index(self) -> int:
        for index, row in enumerate(self.shown):
            if target_of(row) == self._selected:
                return index
        return max(0, min(self._table.cursor_row, len(self.shown) - 1))

    def _arrange(self) -> None:
        chosen = model.matching(self.rows or (), self.pattern)
        self.shown = model.ordered(chosen, self.order, is_reversed=self.is_reversed)
        self._selected = target_of(self.selected) if self.selected else None
        self._draw()

    def _filter_log(self, wanted: model.LogFilter) -> None:
        self.log_filter = wanted
        self._write_log_again()
        self._draw()

    def _show_message(self, message: str) -> None:
        self._message = message
        self._draw()

    # Drawing.

    def on_resize(self) -> None:
        self.call_after_refresh(self._write_log_again)
        self._is_stale = True

    def _write_log_again(self) -> None:
        self.log_view.clear()
        self._follows_log = True
        self._new_lines.clear()
        self._undrawn = 0
        if found := [model.shown(line) for line in self.lines if self.log_filter.wants(line)]:
            self.log_view.write(Text("\n").join(found))

    def _draw(self) -> None:
        self._is_stale = False
        self._head.update(self._head_text())
        self._draw_table()
        self._detail.update(Text(self._detail_text()))
        self._detail.set_class(bool(self._message), "-message")
        if self._new_lines:
            text = Text("\n").join(map(model.shown, self._new_lines))
            if self._undrawn:
                missing = f"({self._undrawn} lines not drawn; l, or choosing a row, draws all)\n"
                text = Text(missing).append_text(text)
                self._undrawn = 0
            self.log_view.write(text, scroll_end=self._follows_log)
            self._new_lines.clear()
        self._log_title.update(Text(self._log_title_text()))
        self._log_title.set_class(self._is_in_log, "-focused")
        row = self.selected
        footer = (row and (row.kind, row.state), len(self.screen_stack))
        if footer != self._footer:
            self._footer = footer
            self.refresh_bindings()

    def _draw_table(self) -> None:
        table = self._table
        machine_cells = model.machine_width(self.rows or ())
        width = table.size.width - machine_cells
        is_tree = self.order is model.Order.DECLARED and not self.is_reversed
        names = [model.name_of(row, is_tree=is_tree) for row in self.shown]
        name_cells, last = model.name_width(names, width), self._last.last
        drawn = [
            (target, model.cells_of(row, name, name_cells, last.get(target, ""), machine_cells))
            for row, name in zip(self.shown, names, strict=True)
            for target in (target_of(row),)
        ]
        if self._layout != (width, name_cells, machine_cells):
            self._layout = width, name_cells, machine_cells
            self._drawn = []
            table.clear(columns=True)
            rest = max(width - name_cells - sum(model.WIDTHS.values()), 12)
            machine = {"MACHINE": machine_cells} if machine_cells else {}
            columns = {**machine, "NAME": name_cells, **model.WIDTHS, " LAST LINE": rest}
            for title, size in columns.items():
                is_figure = title not in {"MACHINE", "NAME", "STATE", " LAST LINE"}
                table.add_column(Text(title, justify="right" if is_figure else "left"), width=size)
        if [target for target, _ in drawn] == [target for target, _ in self._drawn]:
            for y, ((_, new), (_, old)) in enumerate(zip(drawn, self._drawn, strict=True)):
                for x, cell in enumerate(new):
                    if cell != old[x] or cell.style != old[x].style:
                        table.update_cell_at(Coordinate(y, x), cell)
        else:
            scroll = table.scroll_offset.y
            table.clear()
            for _, cells in drawn:
                table.add_row(*cells)
            table.scroll_to(y=scroll, animate=False, immediate=True)
        self._drawn = drawn
        table.move_cursor(row=self._index(), animate=False)

    def _head_text(self) -> Text:
        assert self._link is not None
        text = Text(f"{model.clean(self.hello.name)} (pid {self.hello.pid})  ")
        if self._link.silence >= _SHOWN_SILENCE:
            return text.append(f"no answer for {self._link.silence:.0f} s", "red")
        if self.rows is None:
            return text.append("connecting")
        text.append(f"up {model.uptime(time.time() - self.hello.started_ns / 1e9)}  ")
        has_failed = any(health(row) is Health.FAILED for row in self.rows)
        text.append(health_counts(self.rows), "red" if has_failed else "")
        if self.pattern:
            text.append(f"; {len(self.shown)} with {model.clean(self.pattern)!r}")
        if self.order is not model.Order.DECLARED or self.is_reversed:
            order = self.order if self.order is model.Order.DECLARED else f"by {self.order}"
            text.append(f"; {order}{', reversed' if self.is_reversed else ''}")
        return text

    def _detail_text(self) -> str:
        if self._message or self.rows is None:
            return self._message
        if not self.rows:
            return "nothing is declared"
        row = self.selected
        if row is None:
            return f"no name matches {model.clean(self.pattern)!r}"
        end = f"exit code {row.exit_code}" if row.exit_code else ""
        end = f"ended by signal {row.signal}" if row.signal else end
        parts = (str(target_of(row)), row.kind, end, row.reason)
        return ", ".join(model.clean(part) for part in parts if part)

    def _log_title_text(self) -> str:
        chosen = self.log_filter
        name = "all" if chosen.target is None else model.clean(full_name(chosen.target))
        parts = [f"LOG of {name}"]
        if chosen.level is not model.LeastLevel.ALL:
            parts.append(f"{chosen.level.name.lower()} and above")
        below = int(self.log_view.max_scroll_y - self.log_view.scroll_y)
        if below > 0 and not self._follows_log:
            parts.append(f"{below} lines below")
        if self._dropped:
            parts.append(f"{self._dropped} older than the last {model.LINES_LIMIT:,} kept")
        if self._missed:
            parts.append(f"{self._missed} missed")
        return ", ".join(parts)

"""The screen as an application of Textual: leads keys and what the session says to the model."""

from __future__ import annotations

import asyncio
import signal
from typing import TYPE_CHECKING, Any, ClassVar, Final

from msgspec import Struct
from textual import events
from textual.app import App
from textual.binding import Binding, BindingType

from play_launch.cli.top import drawing
from play_launch.cli.top.link import SessionLink
from play_launch.cli.top.model import Model
from play_launch.cli.top.operations import Proposal, Refusal, Wish
from play_launch.cli.top.panes import Help, Pane, Question
from play_launch.cli.top.terminal import Screen
from play_launch.control.protocol import ControlError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from textual.app import ComposeResult

    from play_launch.cli.top.rows import Row
    from play_launch.control.client import ControlClient

_FRAME: Final = 0.1
"""Seconds between two drawings at least, however much comes."""
_TICK: Final = 1.0

_ALWAYS: Final = frozenset({"interrupt", "suspend_process"})
_ALWAYS_KEYS: Final = frozenset({"ctrl+c", "ctrl+z"})


class End(Struct, frozen=True):
    """Why the screen is left."""

    signal: int = 0
    """0: none."""
    is_lost: bool = False
    """The session closed the connection, or says what is not understood."""
    reason: str = ""


class TopApp(App[End]):
    """One session, until it ends or a person has seen enough."""

    ENABLE_COMMAND_PALETTE = False
    CSS = """
    Screen { layout: vertical; overflow: hidden; }
    #table { height: 3fr; min-height: 4; }
    #log { height: 2fr; min-height: 1; }
    """
    # With priority, a key is carried out before the next one is looked at: who types ahead over a
    # slow line gets what the keys mean in that order.
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding(keys, action, priority=True)
        for keys, action in {
            "q": "quit",
            "ctrl+c": "interrupt",
            "ctrl+z": "suspend_process",
            "up,k": "go(-1)",
            "down,j": "go(1)",
            "pageup": "go_pages(-1)",
            "pagedown,space": "go_pages(1)",
            "home,g": "go_pages(-1000000)",
            "end,G": "go_pages(1000000)",
            "tab": "other_pane",
            "slash": "type",
            "o": "sort",
            "O": "turn_around",
            "enter": "only_selected",
            "l": "next_level",
            "escape": "all_again",
            "question_mark,h": "help",
            **{wish.value: f"propose('{wish.name}')" for wish in Wish},
        }.items()
    ]

    def __init__(self, client: ControlClient, *, has_colours: bool = True) -> None:
        """Show the session of a client that nobody else uses."""
        super().__init__(driver_class=Screen)
        self.theme = "ansi-dark"
        self._client = client
        self._has_colours = has_colours
        self._link: SessionLink | None = None
        self.model = Model(client.hello)
        self._first = 0
        """The row of the table that stands at its top."""
        self._is_in_log = False
        """Whether the keys for moving are for the log."""
        self._is_old = True
        """Whether the screen shows what was."""

    def compose(self) -> ComposeResult:
        """Put the panes below each other."""
        model = self.model
        yield Pane(lambda width, _: [drawing.head(model, width)], "head")
        yield Pane(self._draw_table, "table")
        yield Pane(lambda width, _: [drawing.detail(model, width)], "detail")
        yield Pane(
            lambda width, _: [drawing.log_title(model, width, has_focus=self._is_in_log)],
            "log-title",
        )
        yield Pane(lambda width, height: drawing.log(model, width, height), "log")
        yield Pane(lambda width, _: [drawing.foot(model, width)], "foot")

    def on_mount(self) -> None:
        """Begin to ask."""
        for pane in self.query(Pane):
            pane.has_colours = self._has_colours
        self._link = SessionLink(self._client, self)
        self._link.begin()
        self.set_interval(_FRAME, self._draw_what_is_old)
        self.set_interval(_TICK, self._tick)

    def on_unmount(self) -> None:
        """Ask no more."""
        if self._link is not None:
            self._link.close()

    def end_by(self, number: int) -> None:
        """Leave because of a signal; can be called between any two lines of this thread."""
        asyncio.get_running_loop().call_soon_threadsafe(self.exit, End(signal=number))

    def give_back(self) -> None:
        """Restore the settings of the terminal; can be called like `end_by`."""
        if isinstance(self._driver, Screen):
            self._driver.give_back()

    # What the session says.

    def on_rows(self, rows: Sequence[Row]) -> None:
        """See what there is by now."""
        self.model.take_rows(rows)
        self._is_old = True

    def on_line(self, event: Mapping[str, Any]) -> None:
        """See a line."""
        self.model.take_line(event)
        self._is_old = True

    def on_missed(self, events: int) -> None:
        """Count what could not be sent."""
        self.model.buffer.missed += events
        self._is_old = True

    def on_outcome(self, proposal: Proposal, failure: str) -> None:
        """Report what came of an operation."""
        self.model.take_outcome(proposal, failure)
        self._is_old = True

    def on_end(self, reason: str) -> None:
        """Leave: there is nothing more to show."""
        self.exit(End(is_lost=True, reason=reason))

    # Keys.

    async def on_event(self, event: events.Event) -> None:
        """Let what is typed be a part of the pattern while a person writes one."""
        if self.model.is_typing and isinstance(event, events.Key | events.Paste):
            key = event.key if isinstance(event, events.Key) else ""
            if key not in _ALWAYS_KEYS:
                self.model.type(key, _text_of(event))
                self._draw()
                return
        await super().on_event(event)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Leave keys to a question that is asked."""
        is_asked = len(self.screen_stack) > 1
        return (not is_asked or action in _ALWAYS) and super().check_action(action, parameters)

    async def action_quit(self) -> None:
        """Leave; the session goes on."""
        self.exit(End())

    def action_interrupt(self) -> None:
        """Leave, as by a signal: with the terminal in our hands, Ctrl-C is a key."""
        self.exit(End(signal=signal.SIGINT))

    def action_go(self, lines: int) -> None:
        """Move in the table or the log."""
        self.model.message = ""
        if self._is_in_log:
            self.model.scroll(lines)
        else:
            self.model.move(lines)
        self._draw()

    def action_go_pages(self, pages: int) -> None:
        """Move by what is seen at once."""
        pane = self._pane("log" if self._is_in_log else "table")
        self.action_go(pages * max(pane.size.height - 1, 1))

    def action_other_pane(self) -> None:
        """Let the keys move in the other pane."""
        self._is_in_log = not self._is_in_log
        self._draw()

    def action_sort(self) -> None:
        """Sort by the next one."""
        self.model.message = ""
        self.model.sort(self.model.order.next(), is_reversed=False)
        self._draw()

    def action_turn_around(self) -> None:
        """Turn the order around."""
        self.model.message = ""
        self.model.sort(self.model.order, is_reversed=not self.model.is_reversed)
        self._draw()

    def action_only_selected(self) -> None:
        """Show the lines of one, or of all."""
        self.model.only_selected()
        self._draw()

    def action_next_level(self) -> None:
        """Show lines of a higher level only."""
        self.model.next_level()
        self._draw()

    def action_all_again(self) -> None:
        """Take what was chosen back."""
        self.model.message = ""
        self.model.all_again()
        self._draw()

    def action_help(self) -> None:
        """List the keys."""
        self.push_screen(Help())

    def action_propose(self, name: str) -> None:
        """Ask before something is done to the selected row."""
        found = self.model.propose(Wish[name])
        if isinstance(found, Refusal):
            self.model.message = found.reason
            self._draw()
            return
        self.push_screen(Question(found), lambda answer: self._answered(found, answer=answer))

    def action_type(self) -> None:
        """Let a person write what names are to be shown."""
        self.model.is_typing = True
        self._draw()

    def _answered(self, proposal: Proposal, *, answer: bool | None) -> None:
        if not answer or self._link is None:
            return
        try:
            self._link.carry_out(proposal)
        except ControlError as error:
            self.model.take_outcome(proposal, str(error))
        else:
            self.model.message = f"{proposal.question.partition('?')[0]}: under way"
        self._draw()

    # Drawing.

    def _tick(self) -> None:
        if self._link is not None:
            self.model.silence = self._link.silence
        if isinstance(self._driver, Screen) and self._driver.has_gone():
            self.exit(End(signal=signal.SIGHUP))
        self._is_old = True

    def _draw_what_is_old(self) -> None:
        if self._is_old:
            self._draw()

    def _draw(self) -> None:
        # Nothing for a terminal that takes nothing: it is drawn when it does again.
        self._is_old = isinstance(self._driver, Screen) and self._driver.is_behind
        if self._is_old:
            return
        for pane in self.screen_stack[0].query(Pane):
            pane.draw_again()

    def _draw_table(self, width: int, height: int) -> list[drawing.Line]:
        model = self.model
        seen = max(height - 1, 1)
        self._first = drawing.first_shown(self._first, model.place, seen, len(model.shown))
        self._pane("table").selected_line = model.place - self._first + 1 if model.shown else None
        return drawing.table(model, width, height, self._first, has_focus=not self._is_in_log)

    def _pane(self, name: str) -> Pane:
        return self.screen_stack[0].query_one(f"#{name}", Pane)


def _text_of(event: events.Key | events.Paste) -> str:
    if isinstance(event, events.Paste):
        return event.text.partition("\n")[0]
    return event.character if event.is_printable and event.character else ""

"""The modal screens: questions, help, filter."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Final

from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.screen import ModalScreen
from textual.widgets import Input, Static

if TYPE_CHECKING:
    from textual import events
    from textual.app import ComposeResult

_KEYS: Final = """\
Up Down PgUp PgDn   select a row, or scroll the log
Home End            first or last row; start or end of the log
Tab                 choose between the table and the log for these keys
/                   show only rows with a name: a part of it, or a pattern
o, O                sort by another column; reverse the order
Enter               show only lines of the selected row, or all lines again
l                   show only lines of a level and above, up to fatal
Esc                 show all rows and all lines again
r                   restart a container or process, reload a composable node
x                   stop a container or process, unload a composable node
s                   start a container or process, load a composable node
q, Ctrl-C           leave; the session continues"""


class Question(ModalScreen[bool]):
    """Confirmation of an operation; only ``y`` confirms."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y", "answer(True)", "yes"),
        Binding("n,escape,q,enter,ctrl+c", "answer(False)", "no"),
    ]

    def __init__(self, question: str) -> None:
        super().__init__()
        self._question = question

    def compose(self) -> ComposeResult:
        with Vertical():
            yield Static(self._question, markup=False)
            yield Static("y yes   n no", markup=False)

    def action_answer(self, answer: bool) -> None:
        self.dismiss(answer)


class Help(ModalScreen[None]):
    """List of the keys."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,q,question_mark,enter,space,ctrl+c", "app.pop_screen", "close")
    ]

    def compose(self) -> ComposeResult:
        with VerticalScroll() as frame:
            frame.border_subtitle = "Up Down scroll   Esc close"
            yield Static(_KEYS, markup=False)


class FilterPrompt(ModalScreen[str]):
    """Input of the pattern of names, applied while it is typed."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape", "clear", "all", priority=True)]

    def __init__(self, pattern: str) -> None:
        super().__init__()
        self._input = Input(pattern, compact=True, max_length=200, select_on_focus=False)

    def compose(self) -> ComposeResult:
        with Horizontal():
            yield Static("names: ", markup=False)
            yield self._input

    def on_mount(self) -> None:
        self.set_focus(self._input)

    def on_key(self, event: events.Key) -> None:
        """Insert a key that was typed before the input had the focus."""
        if event.character and event.is_printable:
            self._input.insert_text_at_cursor(event.character)
            event.stop()

    def action_clear(self) -> None:
        self.dismiss("")

    def on_input_submitted(self, event: Input.Submitted) -> None:
        self.dismiss(event.value)

"""What Textual needs to know of the screen: where lines stand, how they look, what is asked."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Final

from rich.segment import Segment
from rich.style import Style
from textual.binding import Binding, BindingType
from textual.containers import Vertical, VerticalScroll
from textual.screen import ModalScreen
from textual.strip import Strip
from textual.widget import Widget
from textual.widgets import Static

from play_launch.cli.top.drawing import KEYS, Look

if TYPE_CHECKING:
    from collections.abc import Callable

    from textual.app import ComposeResult

    from play_launch.cli.top.drawing import Line
    from play_launch.cli.top.operations import Proposal

# The terminal's own colours, and nothing that only a colour says.
_STYLES: Final = {
    Look.PLAIN: Style(),
    Look.TITLE: Style(bold=True, reverse=True),
    Look.QUIET_TITLE: Style(bold=True, underline=True),
    Look.STRONG: Style(bold=True),
    Look.QUIET: Style(dim=True),
    Look.GOOD: Style(color="green"),
    Look.BUSY: Style(color="yellow"),
    Look.BAD: Style(color="red", bold=True),
}
_WITHOUT_COLOUR: Final = {look: style.without_color for look, style in _STYLES.items()}
_SELECTED: Final = Style(reverse=True)


class Pane(Widget):
    """Lines that somebody else draws, for the size that there is."""

    DEFAULT_CSS = "Pane { height: 1; width: 100%; }"

    def __init__(self, draw: Callable[[int, int], list[Line]], name: str) -> None:
        """Draw with a function of width and height, in cells.

        Args:
            draw: Gives the lines from the top.
            name: Also its id.
        """
        super().__init__(id=name)
        self._draw = draw
        self._lines: list[Line] = []
        self.has_colours = True
        self.selected_line: int | None = None
        """Counted from the top."""

    def draw_again(self) -> None:
        """Show what is there by now."""
        self._lines = self._draw(self.size.width, self.size.height)
        self.refresh()

    def on_resize(self) -> None:
        """Draw for another size."""
        self.draw_again()

    def render_line(self, y: int) -> Strip:
        """Give one line to Textual."""
        if y >= len(self._lines):
            return Strip.blank(self.size.width)
        over = _SELECTED if y == self.selected_line else Style()
        styles = _STYLES if self.has_colours else _WITHOUT_COLOUR
        return Strip([Segment(text, styles[look] + over) for text, look in self._lines[y]])

    def texts(self) -> list[str]:
        """What is shown, without looks."""
        return ["".join(text for text, _ in line) for line in self._lines]


class Question(ModalScreen[bool]):
    """Asks before something is done; only a yes does it."""

    DEFAULT_CSS = """
    Question { align: center middle; background: transparent; }
    Question > Vertical { width: 60; max-width: 90%; height: auto; border: ascii ansi_default;
                          padding: 0 1; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y", "answer(True)", "yes"),
        Binding("n,escape,q,enter,ctrl+c", "answer(False)", "no"),
    ]

    def __init__(self, proposal: Proposal) -> None:
        """Ask about an operation."""
        super().__init__()
        self._proposal = proposal

    def compose(self) -> ComposeResult:
        """Show question and keys."""
        with Vertical():
            yield Static(self._proposal.question, markup=False)
            yield Static("y yes   n no", markup=False)

    def action_answer(self, answer: bool) -> None:
        """Give the answer to whoever asked."""
        self.dismiss(answer)


class Help(ModalScreen[None]):
    """Lists the keys."""

    DEFAULT_CSS = """
    Help { align: center middle; background: transparent; }
    Help > VerticalScroll { width: 76; max-width: 100%; height: auto; max-height: 100%;
                            border: ascii ansi_default; padding: 0 1; scrollbar-size: 0 0; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,q,question_mark,enter,space,ctrl+c", "close", "close")
    ]

    def compose(self) -> ComposeResult:
        """Show the table of keys."""
        with VerticalScroll() as frame:
            frame.border_subtitle = "Up Down scroll   Esc close"
            for key, does in KEYS:
                yield Static(f"{key:<13} {does}", markup=False)

    def action_close(self) -> None:
        """Go back."""
        self.dismiss(None)

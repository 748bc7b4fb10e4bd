"""What the screen is about to show: rows, lines, and what a person chose. It draws nothing."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, Final

from msgspec.structs import replace

from play_launch.cli.top.cells import clean
from play_launch.cli.top.log_lines import LastLines, LogBuffer, LogFilter, line_of, scrolled
from play_launch.cli.top.operations import DONE, Proposal, Refusal, Wish, proposal
from play_launch.cli.top.rows import Order, Row, Subject, matching, ordered, place_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from play_launch.control.client import Hello

_LONGEST_PATTERN: Final = 200
_ENDS_TYPING: Final = {"enter": False, "escape": True}
"""Keys, and whether they take the pattern back."""
_TAKES_BACK: Final = {"backspace": -1, "ctrl+h": -1, "ctrl+u": 0}
"""Keys, and what they leave."""


class Model:
    """All of it, in memory that is bounded."""

    def __init__(self, hello: Hello) -> None:
        """Begin with an empty table."""
        self.hello = hello
        self.rows: list[Row] = []
        """As declared."""
        self.by_subject: dict[Subject, Row] = {}
        self.has_rows = False
        """Whether the session has said what there is."""
        self.order = Order.DECLARED
        self.is_reversed = False
        self.pattern = ""
        """Of names, as a person wrote it."""
        self.is_typing = False
        """Whether keys are a part of it."""
        self.shown: list[Row] = []
        """What the pattern leaves, in order."""
        self.place = 0
        """Of the selected one of these."""
        self._selected: Subject | None = None
        self.buffer = LogBuffer()
        self.last = LastLines()
        self.filter = LogFilter()
        self.log_end: int | None = None
        """The number behind the last line that is shown; None: whatever comes is shown."""
        self.message = ""
        """What came of what a person asked for; clean."""
        self.silence = 0.0
        """Seconds without an answer."""

    @property
    def is_tree(self) -> bool:
        """Whether nodes stand below their containers."""
        return self.order is Order.DECLARED and not self.is_reversed

    @property
    def selected(self) -> Row | None:
        """The selected row."""
        return self.shown[self.place] if self.shown else None

    @property
    def age_s(self) -> float:
        """Seconds since the session began."""
        return max(time.time() - self.hello.started_ns / 1e9, 0.0)

    # What the session says.

    def take_rows(self, rows: Sequence[Row]) -> None:
        """See what there is by now; the selection stays with its subject."""
        self.rows = list(rows)
        self.by_subject = {row.subject: row for row in rows}
        self.has_rows = True
        self.last.declare(rows)
        self._arrange()

    def take_line(self, event: Mapping[str, Any]) -> None:
        """See a line; raises KeyError, TypeError, ValueError."""
        line = line_of(event)
        if line is not None:
            self.buffer.append(line)
            self.last.see(line)

    def take_outcome(self, done: Proposal, failure: str) -> None:
        """See what came of an operation."""
        name = clean(done.subject.name)
        self.message = clean(
            f"{done.operation} {name} failed: {failure}"
            if failure
            else f"{name}: {DONE[done.operation]}"
        )

    # What a person chooses.

    def move(self, rows: int) -> None:
        """Select a row further down, or up where negative."""
        self.place = max(0, min(self.place + rows, len(self.shown) - 1))
        self._selected = None if self.selected is None else self.selected.subject

    def sort(self, order: Order, *, is_reversed: bool) -> None:
        """Sort by something else."""
        self.order, self.is_reversed = order, is_reversed
        self._arrange()

    def choose(self, pattern: str) -> None:
        """Show only what is called so."""
        self.pattern = pattern
        self._arrange()

    def type(self, key: str, text: str) -> None:
        """Take a key as a part of the pattern, or as its end.

        Args:
            key: Textual's name of it; empty where a text was pasted.
            text: What it writes; empty where it writes nothing.
        """
        if key in _ENDS_TYPING:
            self.is_typing = False
            if _ENDS_TYPING[key]:
                self.choose("")
        elif key in _TAKES_BACK:
            self.choose(self.pattern[: _TAKES_BACK[key]])
        else:
            self.choose((self.pattern + clean(text))[:_LONGEST_PATTERN])

    def propose(self, wish: Wish) -> Proposal | Refusal:
        """Say what a key would do to the selected row."""
        if self.selected is None:
            return Refusal("nothing is selected")
        return proposal(wish, self.selected, self.by_subject)

    def only_selected(self) -> None:
        """Show lines of the selected row only; of all again, when that is so already."""
        row = self.selected
        subject = None if row is None or row.subject == self.filter.subject else row.subject
        self._show_lines(replace(self.filter, subject=subject))

    def next_level(self) -> None:
        """Show lines of the next level and above."""
        self._show_lines(replace(self.filter, level=self.filter.level.next()))

    def all_again(self) -> None:
        """Show all rows, and lines of all of them; the level stays."""
        self._show_lines(replace(self.filter, subject=None))
        self.choose("")

    def scroll(self, lines: int) -> None:
        """Show later lines, or earlier ones where negative."""
        self.log_end = scrolled(self.buffer, self.filter, self.log_end, lines)

    def _show_lines(self, wanted: LogFilter) -> None:
        self.filter = wanted
        self.log_end = None

    def _arrange(self) -> None:
        chosen = matching(self.rows, self.pattern)
        self.shown = ordered(chosen, self.order, is_reversed=self.is_reversed)
        self.place = place_of(self._selected, self.shown, self.place)
        self._selected = None if self.selected is None else self.selected.subject

"""The numbers by which words about one load are distinguished from those about another."""

from __future__ import annotations


class AttemptNumbers:
    """Numbers for load attempts, unique in the supervisor's life and never 0."""

    def __init__(self) -> None:
        self.upcoming = 1

    def use(self) -> None:
        """The upcoming number is taken."""
        self.upcoming += 1

"""How a process ended."""

from __future__ import annotations

import os
import signal as signals
from dataclasses import dataclass
from typing import Final

UNKNOWN_STATUS: Final = -1
"""Exit status that is unknown: its parent was killed, or another process reaped the child."""


@dataclass(frozen=True, slots=True, repr=False)
class Exit:
    """The end of a process: an exit status, or the number of the signal that killed it.

    `code` is 0 where a signal ended it, `signal` is 0 where none did. It is `UNKNOWN_STATUS` where
    its exit status is unknown: its guard was killed, or another process reaped it.
    `hint` is what the machine has to do with it.
    """

    code: int = 0
    signal: int = 0
    core_dumped: bool = False
    hint: str = ""

    @property
    def ok(self) -> bool:
        """Whether it ended with status 0."""
        return self.code == 0 and self.signal == 0

    @property
    def is_lost(self) -> bool:
        """Whether the exit status is unknown."""
        return self.code == UNKNOWN_STATUS

    @classmethod
    def of(cls, si_code: int, si_status: int) -> Exit:
        """Translate what waitid(2) reported."""
        if si_code == os.CLD_EXITED:
            return cls(code=si_status)
        return cls(signal=si_status, core_dumped=si_code == os.CLD_DUMPED)

    @classmethod
    def lost(cls) -> Exit:
        """Return an exit with unknown status."""
        return cls(code=UNKNOWN_STATUS)

    @property
    def signal_name(self) -> str:
        """``SIGSEGV``; empty where no signal ended it."""
        if not self.signal:
            return ""
        try:
            return signals.Signals(self.signal).name
        except ValueError:  # most of the real-time signals have no name of their own
            return f"SIGRTMIN+{self.signal - signals.SIGRTMIN}"

    def __str__(self) -> str:
        if self.is_lost:
            return "ended, with an unknown exit status"
        hint = f": {self.hint}" if self.hint else ""
        if not self.signal:
            return f"exited with status {self.code}{hint}"
        core = ", core dumped" if self.core_dumped else ""
        return f"exited with signal {self.signal} ({self.signal_name}{core}){hint}"

    def __repr__(self) -> str:
        return f"<Exit: {self}>"

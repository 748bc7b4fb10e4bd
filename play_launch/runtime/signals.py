"""What ends a run: signals, and other requests to stop."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
from typing import TYPE_CHECKING, Final, Self

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType, TracebackType

_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_MOST_PENDING: Final = 2
"""The first requests the stop, a second one skips to the next stop signal."""
_log = logging.getLogger(__name__)


class StopRequests:
    """The first request stops the system in order; a second signal skips to the next stop signal.

    Several crashes of one moment may each request the stop, and so may a crash and a signal: these
    are no second signal.

    Belongs to the thread of the event loop: pass signals on with ``loop.call_soon_threadsafe``.
    """

    def __init__(self) -> None:
        self.requested = asyncio.Event()
        self.hurry = asyncio.Event()
        self.signum: int | None = None
        """The signal of the first request; None where it was none."""
        self.reason = ""
        self.on_request: Callable[[], None] = lambda: None
        """Called with the first request."""
        self._signals = 0

    def request(self, signum: int | None = None, reason: str = "") -> None:
        """Request the stop; a second signal skips to the next stop signal."""
        self._signals += signum is not None
        if self.requested.is_set():
            if self._signals > 1:
                self.hurry.set()
            return
        self.signum = signum
        self.reason = reason or (f"signal {signum}" if signum is not None else "requested")
        self.on_request()
        self.requested.set()


class RunSignals:
    """Holds SIGINT, SIGTERM and SIGHUP from before the recording begins until after it is closed.

    ``loop.add_signal_handler`` covers only the life of the loop: a signal just before or after it
    would kill the process and leave a recording that was never closed.
    """

    def __init__(self) -> None:
        """Prepare; ``with`` takes the signals."""
        self._pending: list[signal.Signals] = []
        self._deliver: Callable[[signal.Signals], object] | None = None
        self._before: dict[signal.Signals, object] = {}

    def __enter__(self) -> Self:
        for signum in _SIGNALS:
            # nohup ignores SIGHUP for us, and that is meant. SIGINT is ignored in the background
            # jobs of scripts, which is a shell's default and no intention.
            if signum is signal.SIGHUP and signal.getsignal(signum) is signal.SIG_IGN:
                continue
            self._before[signum] = signal.signal(signum, self._on_signal)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for signum, handler in self._before.items():
            signal.signal(signum, handler)  # type: ignore[arg-type]

    @contextlib.contextmanager
    def delivered_to(self, request: Callable[[int], None]) -> Iterator[None]:
        """Call ``request(signum)`` in the running loop, first for what came before it ran."""
        loop = asyncio.get_running_loop()

        def on_signal(signum: signal.Signals) -> None:
            request(signum)
            _log.warning("%s: shutting down; Ctrl-C again to force", signum.name)

        self._deliver = lambda signum: loop.call_soon_threadsafe(on_signal, signum)
        for signum in self._pending:
            on_signal(signum)
        try:
            yield
        finally:
            self._deliver = None

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        signum = signal.Signals(number)
        if self._deliver is not None:
            self._deliver(signum)
        elif len(self._pending) < _MOST_PENDING:
            self._pending.append(signum)

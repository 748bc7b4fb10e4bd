"""Loads the libraries of components in scratch processes, before a container gets them."""

from __future__ import annotations

import logging
import os
from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Final

import anyio
from msgspec import DecodeError, Struct, field
from msgspec.json import Decoder
from msgspec.structs import replace

from play_launch.process.exit import Exit
from play_launch.runtime.ports import StartError
from play_launch.supervisor.events import Stream
from play_launch.supervisor.inputs import ProbeResult

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from play_launch.config.model import ComposableNodeConfig, ContainerConfig
    from play_launch.process.lines import Line
    from play_launch.runtime.ports import Launcher, ManagedProcess
    from play_launch.runtime.publisher import Publisher

_log = logging.getLogger(__name__)

_REPORT_INTERVAL: Final = 10.0
"""Seconds between two reports of a library that is still being loaded."""
_GONE_LIMIT: Final = 10.0
"""Seconds from the end of a scratch process to the end of its children and its output."""
_LAST_LINES: Final = 100
"""Lines of its stdout that are kept: the result is the last one, but for what the library's own
threads and exit handlers write."""
_UNUSABLE: Final = frozenset({64, 125, 126, 127})
"""Exit codes of a program that did not understand its arguments, or was never executed."""
_QUOTES: Final = 4
"""Quotation marks up to the end of the last whole entry of a list that was cut."""


class _Output(Struct):
    """What one scratch process writes: its result is on stdout, all else goes to the recording."""

    publish: Callable[[Stream, Sequence[Line]], None]
    result: deque[str] = field(default_factory=partial(deque, maxlen=_LAST_LINES))

    def __call__(self, stream: Stream, lines: Sequence[Line]) -> None:
        if stream is Stream.STDOUT:
            self.result.extend(line.text for line in lines)
        else:
            self.publish(stream, lines)


class LibraryProbes:
    """Runs scratch processes, a bounded number at a time; one for all containers of a run."""

    def __init__(
        self, launcher: Launcher, publisher: Publisher, *, places: int | None = None
    ) -> None:
        """Take what starts processes; loading is CPU time and reading, so one a CPU by default."""
        self._launcher = launcher
        self._publisher = publisher
        self._places = anyio.Semaphore(places or max(2, os.cpu_count() or 1))

    async def probe(
        self, container: ContainerConfig, node: ComposableNodeConfig
    ) -> ProbeResult | None:
        """Load the library of a node; None when that could not be tried.

        When this is cancelled, the scratch process is killed first.
        """
        name, limit = node.declared_full_name, container.probe_timeout
        async with self._places:
            output = _Output(
                lambda stream, lines: self._publisher.publish_output(
                    container.full_name, process.pid, stream, lines
                )
            )
            try:
                process = await self._launcher.start_probe(container, node, output)
            except StartError as error:
                _log.warning("%s: its library is not probed: %s", name, error)
                return None
            try:
                with anyio.move_on_after(limit) as scope:
                    await _wait(process, name, limit)
            finally:
                process.kill()
                await _gone(process)
        if scope.cancelled_caught:
            late = f"its library was still being loaded after {limit:g} s"
            return ProbeResult(loads=False, error=late)
        exit_ = await process.wait()
        return read_probe(output.result, exit_code=exit_.code, signal=exit_.signal)


async def _wait(process: ManagedProcess, name: str, limit: float) -> None:
    began = anyio.current_time()
    while True:
        with anyio.move_on_after(_REPORT_INTERVAL):
            await process.wait()
            return
        text = "%s: its library has been loading in a scratch process (pid %d) for %.0f s of %.0f s"
        _log.warning(text, name, process.pid, anyio.current_time() - began, limit)


async def _gone(process: ManagedProcess) -> None:
    with anyio.move_on_after(_GONE_LIMIT, shield=True) as scope:
        await process.gone()
    if scope.cancelled_caught:
        _log.error("the scratch process %d does not end", process.pid)


_decode: Final = Decoder(ProbeResult).decode


def read_probe(lines: Iterable[str], *, exit_code: int = 0, signal: int = 0) -> ProbeResult | None:
    """Read the end of a scratch process; None when it never was one.

    Args:
        lines: What it wrote to standard output; a library may write there as well.
        exit_code: Its exit status; 0 when a signal ended it.
        signal: The signal that ended it; 0 when none did.
    """
    found = [result for line in lines if (result := _read(line))]
    if not found and exit_code in _UNUSABLE:
        return None
    result = found[-1] if found else ProbeResult()
    number = signal or result.signal
    # Without a result it did not come to its end, whatever its status: exit() in an initialiser.
    loads = bool(found) and exit_code == 0 and number == 0
    error = result.error or f"the process that loaded it {Exit(exit_code, number)}"
    error = "" if loads else error
    return replace(result, loads=loads, error=error, exit_code=exit_code, signal=number)


def _read(line: str) -> ProbeResult | None:
    """Decode a line; one that was cut for its length loses the last entry of its backtrace."""
    text, end = line, len(line)
    for _ in range(1 + _QUOTES if line.startswith("{") else 0):
        try:
            result = _decode(text)
        except DecodeError:
            end = line.rfind('"', 0, end)
            text = line[: end + 1] + "]}"
        else:
            return result if result.library else None
    return None

"""Loads the libraries of components in scratch processes, before a container gets them."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import signal as signals
from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct, field

from play_launch.runtime.ports import StartError
from play_launch.supervisor.events import Stream
from play_launch.supervisor.inputs import ProbeResult

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from play_launch.config.model import ComposableNodeConfig, ContainerConfig
    from play_launch.process.lines import Line
    from play_launch.runtime.ports import Launcher, ManagedProcess
    from play_launch.runtime.publisher import Publisher

_log = logging.getLogger(__name__)


class ProbeLimits(Struct, frozen=True, kw_only=True):
    """Seconds."""

    report_interval: float = 10.0
    """Between two reports of a library that is still being loaded."""
    gone: float = 10.0
    """From the end of a scratch process to the end of its children and its output."""


PROBE_LIMITS: Final = ProbeLimits()


def default_places() -> int:
    """How many libraries are probed at the same time: loading one is CPU time and reading."""
    return max(2, os.cpu_count() or 1)


_LAST_LINES: Final = 100
"""Lines of a scratch process's stdout that are kept: its result is the last one, but for what the
library's own threads and exit handlers write."""


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
        self,
        launcher: Launcher,
        publisher: Publisher,
        *,
        places: int | None = None,
        limits: ProbeLimits = PROBE_LIMITS,
    ) -> None:
        """Take what starts processes; ``places`` is `default_places` where it is None."""
        self._launcher = launcher
        self._publisher = publisher
        self._places = asyncio.Semaphore(places or default_places())
        self._limits = limits

    async def library_of(self, container: ContainerConfig, node: ComposableNodeConfig) -> str:
        """Name the library of a node, or else the component; what is equal is probed once."""
        found = await self._launcher.library_of(container, node)
        return found or f"{node.package} {node.plugin}"

    async def probe(
        self, container: ContainerConfig, node: ComposableNodeConfig
    ) -> ProbeResult | None:
        """Load the library of a node; None when that could not be tried.

        When this is cancelled, the scratch process is killed first.
        """
        async with self._places:
            output = _Output(
                lambda stream, lines: self._publisher.publish_output(
                    container.full_name, process.pid, stream, lines
                )
            )
            try:
                process = self._launcher.start_probe(container, node, output)
            except StartError as error:
                _log.warning("%s: its library is not probed: %s", node.declared_full_name, error)
                return None
            try:
                in_time = await self._wait(
                    process, node.declared_full_name, container.probe_timeout
                )
            finally:
                process.kill()
                await self._gone(process)
        if not in_time:
            return overdue(container.probe_timeout)
        exit_ = await process.wait()
        return read_probe(output.result, exit_code=exit_.code, signal=exit_.signal)

    async def _wait(self, process: ManagedProcess, name: str, limit: float) -> bool:
        """Wait for the end; False when it does not come within ``limit`` seconds."""
        loop = asyncio.get_running_loop()
        began = loop.time()
        left = limit
        while left > 0:
            try:
                async with asyncio.timeout(min(left, self._limits.report_interval)):
                    await process.wait()
            except TimeoutError:
                took = loop.time() - began
                left = limit - took
                _log.warning(
                    "%s: its library has been loading in a scratch process (pid %d) for %.0f s, "
                    "of at most %.0f s",
                    name,
                    process.pid,
                    took,
                    limit,
                )
            else:
                return True
        return False

    async def _gone(self, process: ManagedProcess) -> None:
        try:
            async with asyncio.timeout(self._limits.gone):
                await process.gone()
        except TimeoutError:
            _log.error("the scratch process %d does not end", process.pid)


UNUSABLE: Final = frozenset({64, 125, 126, 127})
"""Exit codes of a program that did not understand its arguments, or was never executed."""


_QUOTES: Final = 4
"""Quotation marks up to the end of the last whole entry of a list that was cut."""


def read_probe(lines: Iterable[str], *, exit_code: int = 0, signal: int = 0) -> ProbeResult | None:
    """Read the end of a scratch process; None when it never was one.

    Args:
        lines: What it wrote to standard output; a library may write there as well.
        exit_code: Its exit status; 0 when a signal ended it.
        signal: The signal that ended it; 0 when none did.
    """
    result = _last_object(lines)
    if result is None and exit_code in UNUSABLE:
        return None
    number = signal or _number(result, "signal")
    # Without a word it did not come to its end, whatever its status is: exit() in an initialiser.
    loads = result is not None and exit_code == 0 and number == 0
    ending = f"ended with {_name(number)}" if number else f"exited with status {exit_code}"
    return ProbeResult(
        loads=loads,
        library=_text(result, "library"),
        error="" if loads else _text(result, "error") or f"the process that loaded it {ending}",
        exit_code=exit_code,
        signal=number,
        modules=_texts(result, "modules"),
        backtrace=_texts(result, "backtrace"),
    )


def overdue(seconds: float) -> ProbeResult:
    """Return what is found when it was killed because it took too long."""
    return ProbeResult(loads=False, error=f"its library was still being loaded after {seconds:g} s")


def _last_object(lines: Iterable[str]) -> Mapping[str, Any] | None:
    found = None
    for line in lines:
        if line.startswith("{"):
            for text in _readings(line):
                value = _object(text)
                if "library" in value:
                    found = value
                    break
    return found


def _readings(line: str) -> Iterator[str]:
    """Give the line, and what it was if it has been cut in its backtrace, being too long."""
    yield line
    end = len(line)
    for _ in range(_QUOTES):
        end = line.rfind('"', 0, end)
        yield line[: end + 1] + "]}"


def _object(text: str) -> Mapping[str, Any]:
    try:
        value = json.loads(text)
    except ValueError:
        return {}
    return value if isinstance(value, dict) else {}


def _number(result: Mapping[str, Any] | None, name: str) -> int:
    value = result.get(name) if result else None
    return value if isinstance(value, int) and value > 0 else 0


def _text(result: Mapping[str, Any] | None, name: str) -> str:
    value = result.get(name) if result else None
    return value if isinstance(value, str) else ""


def _texts(result: Mapping[str, Any] | None, name: str) -> tuple[str, ...]:
    value = result.get(name) if result else None
    return tuple(map(str, value)) if isinstance(value, list) else ()


def _name(number: int) -> str:
    try:
        return f"signal {number} ({signals.Signals(number).name})"
    except ValueError:
        return f"signal {number}"

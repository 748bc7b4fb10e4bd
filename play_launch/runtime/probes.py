"""Loads the libraries of components in scratch processes, before a container gets them again."""

from __future__ import annotations

import logging
from collections import defaultdict, deque
from typing import TYPE_CHECKING, Final

import anyio
from msgspec import DecodeError
from msgspec.json import Decoder
from msgspec.structs import replace

from play_launch.process.exit import Exit
from play_launch.runtime.launcher import StartError
from play_launch.supervisor.events import Stream
from play_launch.supervisor.inputs import Probed, ProbeResult

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from play_launch.config.model import ComposableNodeConfig, ContainerConfig
    from play_launch.config.node_key import NodeKey
    from play_launch.process.lines import Line
    from play_launch.runtime.launcher import ManagedProcess
    from play_launch.runtime.system import System

_log = logging.getLogger(__name__)

_REPORT_INTERVAL: Final = 10.0
"""Seconds between two reports of a library that is still being loaded."""
_GONE_TIMEOUT: Final = 10.0
"""Seconds from the exit of a scratch process to the end of its descendants and its output."""
_LAST_LINES: Final = 100
"""Lines of its stdout that are kept: the result is the last one, but for what the library's own
threads and exit handlers write."""
_UNUSABLE: Final = frozenset({64, 125, 126, 127})
"""Exit codes of a program that did not understand its arguments, or was never executed."""
_QUOTES: Final = 4
"""Quotation marks up to the end of the last whole entry of a list that was cut."""


async def probe_nodes(system: System, container: ContainerConfig, keys: Sequence[NodeKey]) -> None:
    """Probe the libraries of these nodes, several at a time, and post the results."""
    groups: defaultdict[str, list[ComposableNodeConfig]] = defaultdict(list)
    for key in keys:
        if key in system.world.nodes:
            node = system.world.nodes[key].config
            library = await system.launcher.library_of(container, node)
            groups[library or f"{node.package} {node.plugin}"].append(node)
    async with anyio.create_task_group() as tasks:
        for group in groups.values():
            tasks.start_soon(_probe_library, system, container, group)


async def _probe_library(
    system: System, container: ContainerConfig, group: list[ComposableNodeConfig]
) -> None:
    """Probe the nodes of one library, in most cases by the first of them."""
    while group:
        first = group[0]
        finding = await probe_library(system, container, first)
        # Another error may be that of this class alone.
        is_about_all = finding is None or finding.loads or finding.signal != 0
        settled = [node for node in group if is_about_all or node.plugin == first.plugin]
        group = [node for node in group if node not in settled]
        for node in settled:
            known = system.world.nodes.get(node.key)
            if known is not None and known.config is node:  # else it was declared anew
                system.post(Probed(node.key, finding))


async def probe_library(
    system: System, container: ContainerConfig, node: ComposableNodeConfig
) -> ProbeResult | None:
    """Load the library of a node, if a slot is free; None when that could not be tried.

    When this is cancelled, the scratch process is killed first.
    """
    name, limit = node.declared_full_name, container.probe_timeout
    stdout: deque[str] = deque(maxlen=_LAST_LINES)

    def on_output(stream: Stream, lines: Sequence[Line]) -> None:
        if stream is Stream.STDOUT:
            stdout.extend(line.text for line in lines)
        else:
            system.publisher.publish_output(container.full_name, process.pid, stream, lines)

    async with system.probe_slots:
        try:
            process = await system.launcher.start_probe(container, node, on_output)
        except StartError as error:
            _log.warning("%s: its library is not probed: %s", name, error)
            return None
        try:
            with anyio.move_on_after(limit) as scope:
                await _wait(process, name, limit)
        finally:
            process.kill()
            with anyio.move_on_after(_GONE_TIMEOUT, shield=True) as exiting:
                await process.gone()
            if exiting.cancelled_caught:
                _log.error("the scratch process %d does not exit", process.pid)
    if scope.cancelled_caught:
        return ProbeResult(error=f"its library was still being loaded after {limit:g} s")
    exit_ = await process.wait()
    return read_probe(stdout, exit_code=exit_.code, signal=exit_.signal)


async def _wait(process: ManagedProcess, name: str, limit: float) -> None:
    began = anyio.current_time()
    while True:
        with anyio.move_on_after(_REPORT_INTERVAL):
            await process.wait()
            return
        text = "%s: its library has been loading in a scratch process (pid %d) for %.0f s of %.0f s"
        _log.warning(text, name, process.pid, anyio.current_time() - began, limit)


_decode: Final = Decoder(ProbeResult).decode


def read_probe(lines: Iterable[str], *, exit_code: int = 0, signal: int = 0) -> ProbeResult | None:
    """Read the result of a scratch process; None if the program did not run as one.

    Args:
        lines: Its standard output; a library may write there as well.
        exit_code: Its exit status; 0 when a signal ended it.
        signal: The signal that ended it; 0 when none did.
    """
    found = [result for line in lines if (result := _read(line))]
    if not found and exit_code in _UNUSABLE:
        return None
    result = found[-1] if found else ProbeResult()
    number = signal or result.signal
    # Without a result it exited early, whatever its status: exit() in an initialiser.
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

"""``play-launch status``: all that a session knows about one container, node or process."""

from __future__ import annotations

import json
import shlex
import sys
import time
from typing import TYPE_CHECKING, Any, Final

from play_launch.cli import options
from play_launch.cli.connection import connected
from play_launch.cli.output import duration, printable
from play_launch.supervisor.exit_code import ExitCode

if TYPE_CHECKING:
    from collections.abc import Iterator

_UP: Final = frozenset({"loaded", "running"})
_SECOND: Final = 1_000_000_000


def status(
    names: options.Units, session: options.Session = None, as_json: options.Json = False
) -> int:
    """Show all about a container, node or process: state, process, restarts, resources, output.

    Exits with 3 if one of them is neither running nor loaded.
    """
    with connected(session) as client:
        found = client.ask("status", {"names": names})
    if as_json:
        sys.stdout.write(f"{json.dumps(found)}\n")
    else:
        texts = ("\n".join(_lines(each, time.time_ns())) for each in found)
        sys.stdout.write("\n\n".join(texts) + "\n")
    is_up = all(each["state"] in _UP for each in found)
    return ExitCode.OK if is_up else ExitCode.NODES_MISSING


def _lines(unit: dict[str, Any], now_ns: int) -> Iterator[str]:
    of = f" of {unit['container']}" if unit["container"] else ""
    yield printable(f"{unit['name']} - {unit['kind']}{of}", colour=False)
    for title, text in _fields(unit, now_ns):
        if text:
            yield printable(f"{title:>10}: {text}", colour=False)
    for each in unit["last_restarts"]:
        yield printable(f"{'':12}{_clock(each['stamp_ns'])} {each['cause']}", colour=False)
    if unit["output"]:
        yield ""
    for each in unit["output"]:
        yield printable(f"{_clock(each['stamp_ns'])} {each['text']}", colour=False)


def _fields(unit: dict[str, Any], now_ns: int) -> Iterator[tuple[str, str]]:
    since_ns, state = unit["since_ns"], unit["state"]
    if since_ns is not None:
        state += f" since {_clock(since_ns, with_date=True)} ({duration(now_ns - since_ns)} ago)"
    yield "State", f"{state}: {unit['reason']}" if unit["reason"] else state
    if managed := unit.get("managed"):
        reason = f": {managed['reason']}" if managed["reason"] else ""
        yield "Lifecycle", f"{managed['state']}{reason}"
    yield "Wanted", "" if unit["wanted"] else "no, stopped or unloaded by an operator"
    yield "Waits for", unit["waits_for"]
    yield "Declared", unit["declared"]
    yield "Process", _process(unit)
    yield "Command", shlex.join(unit["command"])
    yield "Usage", _usage(unit)
    yield "Resources", ", ".join(f"{name} {value}" for name, value in unit["resources"].items())
    crashes = f", {unit['crashes']} crashes" if unit["crashes"] else ""
    yield "Restarts", f"{unit['restarts']}{crashes}"


def _process(unit: dict[str, Any]) -> str:
    if unit["pid"] is not None:
        return f"pid {unit['pid']}"
    if unit["signal"]:
        return f"ended by signal {unit['signal']}"
    return "" if unit["exit_code"] is None else f"exited with {unit['exit_code']}"


def _usage(unit: dict[str, Any]) -> str:
    found = []
    if unit["cpu_percent"] is not None:
        found.append(f"CPU {unit['cpu_percent']:.1f} %")
    if unit["memory_bytes"] is not None:
        found.append(f"memory {unit['memory_bytes'] / 1e6:,.1f} MB ({unit['memory_kind']})")
    return ", ".join(found)


def _clock(stamp_ns: int, *, with_date: bool = False) -> str:
    form = "%Y-%m-%d %H:%M:%S" if with_date else "%H:%M:%S"
    return time.strftime(form, time.localtime(stamp_ns / _SECOND))

"""``play-launch status``: all that a session knows about one container, node or process."""

from __future__ import annotations

import json
import shlex
import time
from typing import TYPE_CHECKING, Any, Final

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.connection import connected
from play_launch.cli.output import clock, counted, duration, printable, say, size

if TYPE_CHECKING:
    from collections.abc import Iterator

_UP: Final = frozenset({"loaded", "running"})


def status(
    names: options.Units, session: options.Session = None, as_json: options.Json = False
) -> int:
    """Show all about a container, node or process: state, process, restarts, resources, output.

    Exits with 3 if one of them is neither running nor loaded.
    """
    with connected(session) as client:
        found = client.ask("status", {"names": names})
    if as_json:
        say(json.dumps(found))
    else:
        texts = ("\n".join(_lines(each, time.time_ns())) for each in found)
        say("\n\n".join(texts))
    is_up = all(each["state"] in _UP for each in found)
    return ExitCode.OK if is_up else ExitCode.NODES_MISSING


def _lines(unit: dict[str, Any], now_ns: int) -> Iterator[str]:
    of = f" of {unit['container']}" if unit["container"] else ""
    yield printable(f"{unit['name']} - {unit['kind']}{of}")
    for title, text in fields(unit, now_ns):
        if text:
            yield printable(f"{title:>10}: {text}")
    for each in unit["last_restarts"]:
        yield printable(f"{'':12}{clock(each['stamp_ns'])} {each['cause']}")
    if unit["output"]:
        yield ""
    for each in unit["output"]:
        yield printable(f"{clock(each['stamp_ns'])} {each['text']}")


def fields(unit: dict[str, Any], now_ns: int) -> Iterator[tuple[str, str]]:
    """Yield titles and texts, some of them empty, of a result of ``status``."""
    since_ns, state = unit["since_ns"], unit["state"]
    if since_ns is not None:
        since = clock(since_ns, "%Y-%m-%d %H:%M:%S")
        state += f" since {since} ({duration(now_ns - since_ns)} ago)"
    yield "State", f"{state}: {unit['reason']}" if unit["reason"] else state
    yield "Machine", unit.get("machine", "")
    if (managed := unit.get("managed")) and managed["state"] != "absent":
        reason = f": {managed['reason']}" if managed["reason"] else ""
        yield "Lifecycle", f"{managed['state']}{reason}"
    yield "Wanted", "" if unit["wanted"] else "no, stopped or unloaded by an operator"
    yield "Waits for", unit["waits_for"]
    yield "Declared", unit["declared"]
    yield "Process", _process(unit)
    yield "Command", shlex.join(unit["command"])
    yield "Usage", _usage(unit)
    yield "Resources", ", ".join(f"{name} {value}" for name, value in unit["resources"].items())
    crashes = f", {counted(unit['crashes'], 'crash')}" if unit["crashes"] else ""
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
        found.append(f"memory {size(unit['memory_bytes'])} ({unit['memory_kind']})")
    return ", ".join(found)

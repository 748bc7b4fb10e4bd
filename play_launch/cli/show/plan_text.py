"""A plan and its outcomes, as they come over the socket, in lines for people."""

from __future__ import annotations

import json
from collections import Counter
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_SIGNS: Final = {"remove": "-", "add": "+", "load": "+", "start": "+"}
_COLOURS: Final = {"-": "\x1b[31m", "+": "\x1b[32m", "~": "\x1b[33m"}
_WHY: Final = {
    "nothing": "taken over at once",
    "set": "the node is asked to take it; else it is reloaded or restarted",
    "reload": "read when the node is loaded",
    "restart": "read when the process is started",
    "next run": "not changed while the session runs: from the next replay on",
}
_COUNTED: Final = {"+": "to add", "~": "to change", "-": "to remove"}
_LONGEST_VALUE: Final = 120


def plan_lines(
    plan: Mapping[str, Any], *, colour: bool, applying: str | None = None
) -> Iterator[str]:
    """Describe all that differs; the last line counts.

    ``applying`` is the file that is being applied meanwhile: what is compared is from before.
    """
    if applying is not None:
        yield f"{applying} is being applied; compared with the configuration from before"
    counts: Counter[str] = Counter()
    for step in plan["steps"]:
        sign = _SIGNS.get(step["action"], "~")
        if step["action"] != "keep":
            counts[sign] += 1
        yield from _step(step, sign, colour=colour)
    if not plan["steps"]:
        yield "nothing differs" if applying is None else "nothing else differs"
        return
    numbers = [f"{counts[sign]} {what}" for sign, what in _COUNTED.items()]
    yield ", ".join(numbers)


def _step(step: Mapping[str, Any], sign: str, *, colour: bool) -> Iterator[str]:
    name = step["name"] or "(session)"
    covered = ", with its container" if step["covered"] else ""
    reason = f": {step['reason']}" if step["reason"] else ""
    start, end = (_COLOURS[sign], "\x1b[0m") if colour else ("", "")
    yield f"{start}{sign}{end} {name} ({step['kind']}): {step['action']}{covered}{reason}"
    for change in step["changes"]:
        before, after = _value(change["before"]), _value(change["after"])
        yield f"    {change['path']}: {before} -> {after}  ({_WHY[change['need']]})"


def outcome_line(outcome: Mapping[str, Any]) -> str:
    """Say what became of a step."""
    step = outcome["step"]
    name = step["name"] or "(session)"
    reason = f": {outcome['reason']}" if outcome["reason"] else ""
    took = f" after {outcome['seconds']:.2f} s" if outcome["result"] != "skipped" else ""
    return f"{name}: {step['action']} {outcome['result']}{took}{reason}"


def _value(value: Any) -> str:
    if value is None:
        return "(none)"
    if isinstance(value, dict) and value.keys() == {"type", "value"}:
        return f"{_short(value['value'])} ({value['type']})"
    return _short(value)


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _LONGEST_VALUE else f"{text[: _LONGEST_VALUE - 1]}…"

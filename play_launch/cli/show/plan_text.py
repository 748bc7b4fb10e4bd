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
    "set": "set at run time; reloaded or restarted if the node rejects it",
    "reload": "read when the node is loaded",
    "restart": "read when the process is started",
    "next run": "not changed while the session runs: from the next replay on",
}
_COUNTED: Final = {"+": "to add", "~": "to change", "-": "to remove"}
_RULES: Final = "start_rules."
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
    come_or_go = {each["name"] for each in plan["steps"] if each["action"] in {"add", "remove"}}
    for step in plan["steps"]:
        changes = _of_the_rest(step["changes"], come_or_go)
        if step["changes"] and not changes:
            continue
        sign = _SIGNS.get(step["action"], "~")
        if step["action"] != "keep":
            counts[sign] += 1
        yield from _step({**step, "changes": changes}, sign, colour=colour)
    if not plan["steps"]:
        yield "nothing differs" if applying is None else "nothing else differs"
        return
    numbers = [f"{counts[sign]} {what}" for sign, what in _COUNTED.items()]
    yield ", ".join(numbers)


def _step(step: Mapping[str, Any], sign: str, *, colour: bool) -> Iterator[str]:
    name = f"{step['name']} ({step['kind']})" if step["name"] else step["kind"]
    covered = ", with its container" if step["covered"] else ""
    reason = f": {step['reason']}" if step["reason"] else ""
    start, end = (_COLOURS[sign], "\x1b[0m") if colour else ("", "")
    yield f"{start}{sign}{end} {name}: {step['action']}{covered}{reason}"
    for change in step["changes"]:
        path, before, after = change["path"], change["before"], change["after"]
        unit = _waiting(path)
        value = _awaited if unit else _value
        if unit:
            path = f"{unit} {'start_delay' if path.endswith('.delay') else 'depends_on'}"
        yield f"    {path}: {value(before)} -> {value(after)}  ({_WHY[change['need']]})"


def _of_the_rest(changes: list[dict[str, Any]], come_or_go: set[str]) -> list[dict[str, Any]]:
    """Leave out what is said already: that what comes or goes has its start rules with it."""
    return [each for each in changes if _waiting(each["path"]) not in come_or_go]


def _waiting(path: str) -> str:
    """Give the unit whose start rule, or a part of it, a path leads to; else nothing."""
    if not path.startswith(_RULES):
        return ""
    return path.removeprefix(_RULES).removesuffix(".dependencies").removesuffix(".delay")


def _awaited(rule: Any) -> str:
    """Put a start rule into words, or its dependencies; a delay is in seconds."""
    from play_launch.config.dependency import Condition, Dependency  # noqa: PLC0415

    delay = rule["delay"] if isinstance(rule, dict) else 0.0
    found = rule["dependencies"] if isinstance(rule, dict) else rule
    if not isinstance(found, list):
        return _value(rule)
    words = [
        str(
            Dependency(
                condition=Condition(each["condition"]), unit=each["unit"], subject=each["subject"]
            )
        )
        + ("" if each["timeout"] == "never" else f", at most {each['timeout']:g} s")
        + (", else start" if each["on_timeout"] == "start" else "")
        for each in found
    ]
    return "; ".join([*words, *([f"{delay:g} s more"] if delay else [])]) or "(none)"


def outcome_line(outcome: Mapping[str, Any]) -> str:
    """Format the result of a step."""
    step = outcome["step"]
    name = step["name"] or step["kind"]
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

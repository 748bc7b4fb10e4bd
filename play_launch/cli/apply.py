"""``play-launch diff`` and ``play-launch apply``."""

from __future__ import annotations

import json
import os
import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.connection import connected
from play_launch.cli.output import duration, is_terminal, printable, report, say, wants_colour
from play_launch.control.protocol import OperationError
from play_launch.launch_files.configuration.request import Containers

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from play_launch.control.client import ControlClient

_NOWHERE: Final = Path("/launch file")
"""Where a configuration that is no file stands, so that all paths in it are absolute."""


ConfigTarget = Annotated[
    list[str],
    options.argument(
        "CONFIG [NAME:=VALUE]...",
        "The YAML file, a launch file of ROS, or a package and a launch file; then arguments.",
        "launch_files",
    ),
]
ContainerType = Annotated[
    Containers, typer.Option(help="Containers of a launch file, as for launch.")
]


def diff(
    target: ConfigTarget,
    container_type: ContainerType = Containers.SAME,
    session: options.Session = None,
    as_json: options.Json = False,
) -> int:
    """Print what apply would change; exits with 1 if anything differs, with 2 after an error."""
    with connected(session, failed=ExitCode.USAGE) as client:
        compared = _compared(client, _configuration(target, container_type), as_json=as_json)
    differs = compared["plan"]["steps"] or compared["applying"] is not None
    return ExitCode.NODE_FAILED if differs else ExitCode.OK


def apply(  # noqa: PLR0917 - options, by name
    target: ConfigTarget,
    container_type: ContainerType = Containers.SAME,
    timeout: Annotated[
        float, options.time("Limit for each step.", "--timeout", default="60s")
    ] = 60.0,
    rollback_on_failure: Annotated[
        bool,
        typer.Option(
            "--rollback-on-failure", help="If a step fails, apply the previous configuration again."
        ),
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the changes only, as diff does.")
    ] = False,
    session: options.Session = None,
    as_json: options.Json = False,
) -> int:
    """Change a session to match a configuration; what does not differ continues to run."""
    with connected(session) as client:
        request = _configuration(target, container_type)
        if dry_run:
            _compared(client, request, as_json=as_json)
            return ExitCode.OK
        request |= {"timeout": timeout, "rollback_on_failure": rollback_on_failure}
        return _apply(client, request, as_json=as_json)


def _compared(client: ControlClient, request: dict[str, Any], *, as_json: bool) -> Any:
    """Request and print what a configuration would change."""
    compared = client.ask("apply", {**request, "dry_run": True})
    if as_json:
        say(json.dumps({**compared["plan"], "applying": compared["applying"]}))
    else:
        _print_plan(compared["plan"], compared["applying"])
    return compared


def _apply(client: ControlClient, request: dict[str, Any], *, as_json: bool) -> int:
    try:
        for message in client.stream("apply", request):
            if "result" in message:
                if as_json:
                    say(json.dumps(message["result"]["applied"]))
                return ExitCode.OK
            if "plan" in message and not as_json:
                _print_plan(message["plan"])
            elif "step" in message and not as_json:
                say(printable(outcome_line(message["step"])))
    except OperationError as error:
        if as_json and "applied" in error.details:
            say(json.dumps(error.details["applied"]))
        raise
    report("the session ended before everything was applied")
    return ExitCode.NODE_FAILED


def _configuration(target: list[str], container_type: Containers) -> dict[str, Any]:
    """Name the configuration for the session, with environment and directory of this process."""
    named = [each for each in target if ":=" not in each]
    environment = dict(os.environ)
    if _is_launch_file(named):
        path, text = _evaluated(target, container_type)
        return {"path": path, "text": text, "environment": environment}
    path, *arguments = target
    return {"path": os.path.abspath(path), "arguments": arguments, "environment": environment}  # noqa: PTH100 - without resolving links


def _is_launch_file(named: list[str]) -> bool:
    from play_launch.launch_files.find import is_launch_file  # noqa: PLC0415 - takes its time

    path = Path(named[0]) if named else None
    if path is not None and path.is_file():
        return is_launch_file(path)
    return len(named) != 1


def _evaluated(target: list[str], container_type: Containers) -> tuple[str, str]:
    """Convert a launch file as `launch` does, but without other files; return name and text."""
    from play_launch.cli.target import (  # noqa: PLC0415 - takes its time
        USUAL_TIMEOUT,
        evaluated,
        report_losses,
    )
    from play_launch.launch_files.configuration.request import Options  # noqa: PLC0415
    from play_launch.launch_files.configuration.write import written  # noqa: PLC0415

    name, description = evaluated(target, USUAL_TIMEOUT)
    chosen = Options(containers=container_type, folder=_NOWHERE)
    made = written(description, chosen, "")
    report_losses(made)
    return str(_NOWHERE / f"{name}.yaml"), made.text


def _print_plan(plan: Any, applying: str | None = None) -> None:
    colour = is_terminal(sys.stdout) and wants_colour(sys.stdout)
    for line in plan_lines(plan, colour=colour, applying=applying):
        say(printable(line, colour=colour))


# Plans and results, as they come over the socket.

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
        # What comes or goes has its start rules with it.
        changes = [each for each in step["changes"] if _waiting(each["path"]) not in come_or_go]
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
    step = outcome["step"]
    name = step["name"] or step["kind"]
    reason = f": {outcome['reason']}" if outcome["reason"] else ""
    seconds, is_over = outcome["seconds"], outcome["result"] != "skipped"
    took = f" after {duration(round(seconds * 1e9))}" if is_over else ""
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

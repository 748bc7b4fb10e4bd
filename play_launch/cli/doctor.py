"""``play-launch doctor``, ``play-launch version``: what this machine can do, what is installed."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import asdict
from pathlib import Path
from shutil import get_terminal_size
from textwrap import wrap
from typing import TYPE_CHECKING, Final

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.output import BOLD, GREEN, RED, RESET, YELLOW, counted, say, wants_colour

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from play_launch.doctor.check_result import CheckResult

_COLOURS: Final = {"ok": GREEN, "warn": YELLOW, "fail": RED}


def doctor(as_json: options.Json = False) -> int:
    """Check this machine: what works, what does not, the impact, and the fix.

    The container program is started once; nothing is changed. Exits with 1 if no system can be
    started here.
    """
    found = examine()
    failed = any(each.level.value == "fail" for each in found)
    if as_json:
        values = {"can_run": not failed, "findings": [asdict(each) for each in found]}
        say(json.dumps(values, ensure_ascii=False))
    else:
        say("\n".join(lines(found, colour=wants_colour(sys.stdout))))
    return ExitCode.NODE_FAILED if failed else ExitCode.OK


def examine() -> list[CheckResult]:
    """Run all checks; takes a second, most of it for starting two processes."""
    from play_launch.doctor import machine, ros  # noqa: PLC0415 - slow

    rmw, found = ros.ros()
    return [
        ros.python(),
        ros.packages(),
        *found,
        machine.kernel(),
        machine.proc(),
        machine.control_groups(),
        machine.protection_keys(),
        machine.address_space(),
        machine.open_files(),
        machine.processes(),
        machine.core_dumps(),
        machine.real_time(),
        machine.nice_values(),
        machine.locked_memory(),
        *machine.shared_memory(rmw),
        machine.loopback(os.environ),
        machine.receive_buffers(),
        machine.discovery(os.environ, rmw),
        machine.domain(os.environ),
        machine.ssh_config(Path.home() / ".ssh/config"),
        machine.recordings(),
    ]


def lines(results: Sequence[CheckResult], *, colour: bool) -> Iterator[str]:
    subjects = max(len(each.subject) for each in results)
    indent = 6 + subjects + 2
    room = max(get_terminal_size((120, 24)).columns - indent, 20)
    for each in results:
        paint, bold, end = (_COLOURS[each.level], BOLD, RESET) if colour else ("", "", "")
        first, *more = wrap(each.says, room) or [""]
        yield f"{paint}{each.level:<4}{end}  {each.subject:<{subjects}}  {first}".rstrip()
        for style, text in (
            ("", more),
            ("", wrap(f"impact: {each.impact}", room) if each.impact else ()),
            (bold, wrap(f"fix: {each.fix}", room) if each.fix else ()),
        ):
            yield from (f"{' ' * indent}{style}{line}{end if style else ''}" for line in text)
    yield ""
    failed = [each.subject for each in results if each.level.value == "fail"]
    warned = sum(each.level.value == "warn" for each in results)
    if failed:
        yield f"No system can be started here: {', '.join(failed)}."
    else:
        warnings = counted(warned, "warning") if warned else "no warnings"
        yield f"Systems can be started here; {warnings}."


def version(as_json: options.Json = False) -> None:
    """Print versions for a bug report: play-launch, Python packages, ROS, the container program."""
    from play_launch.container.ros import (  # noqa: PLC0415
        MixedInstallationError,
        NotInstalledError,
        component_container,
        ros_installation,
    )
    from play_launch.recording.environment import host_facts, versions  # noqa: PLC0415

    found = versions()
    own = found.pop("play-launch-py", "not installed as a package")
    try:
        ros = ros_installation().source.value
    except (NotInstalledError, MixedInstallationError) as error:
        ros = f"unusable: {error}"
    try:
        container = str(component_container())
    except NotInstalledError:
        container = ""
    facts = host_facts()
    values = {
        "play-launch": own,
        **found,
        "ros": ros,
        "ros_distro": os.environ.get("ROS_DISTRO", ""),
        "component_container": container,
        "system": ", ".join(str(facts[key]) for key in ("distribution", "kernel", "machine")),
    }
    if as_json:
        say(json.dumps(values, ensure_ascii=False))
        return
    width = max(len(name) for name in values)
    for name, value in values.items():
        say(f"{name:<{width}}  {value or 'none'}")

"""Whatever answers a question answers it in JSON as well, if ``--json`` asks for that."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from play_launch.cli.app import COMMANDS, CONTROL, command_of
from tests.support.replay import COMMAND, finished, replaying
from tests.support.scenes import TALKER_AND_SLEEPER
from tests.support.waiting import until

CHANGES_ONLY = {"daemon patch", "daemon run", "daemon start", "daemon stop", "daemon unpatch"}
WRITES_A_FILE = {
    *(
        "completion",
        "export",
        "init",
        "kubernetes",
        "layout",
        "manual",
        "recover",
        "report",
        "schema",
    ),
    "systemd-unit",
}
"""Or prints what is not ours: a script, the layout of another tool, a schema, a unit."""
SYSTEM = f"""{TALKER_AND_SLEEPER}
record:
  before_crash: {{topics: [/chatter], seconds: 5 s}}
"""


def leaves(command: Any, path: str) -> Iterator[tuple[str, Any]]:
    below = getattr(command, "commands", None)
    if below is None:
        yield path, command
    for name, each in (below or {}).items():
        yield from leaves(each, f"{path} {name}")


def test_every_command_that_answers_has_json() -> None:
    without = {
        path
        for each in COMMANDS.values()
        for path, command in leaves(command_of(each), each.name)
        if not any("--json" in parameter.opts for parameter in command.params)
    }
    assert without == CHANGES_ONLY | WRITES_A_FILE | FOR_PEOPLE


FOR_PEOPLE = {"top", "web"}
FOLLOWING = {"diagnostics"}
"""Prints JSON until the session ends."""

SESSION_COMMANDS = {each.name for each in COMMANDS.values() if each.group == CONTROL}
ASKED = {
    "ps": [],
    "status": ["talker"],
    "events": [],
    "logs": [],
    "wait": [],
    "stop": ["sleeper"],
    "start": ["sleeper"],
    "restart": ["sleeper"],
    "unload": ["talker"],
    "load": ["talker"],
    "reload": ["talker"],
    "signal": ["CONT", "sleeper"],
    "diff": ["system.yaml"],
    "apply": ["system.yaml"],
    "param": ["get", "talker", "rate"],
    "param set": ["talker", "rate", "11.0"],
    "param dump": ["talker"],
    "snapshot": [],
    "expect": [],
    "shutdown": [],
}


def test_all_verbs_for_a_running_session_print_json(
    tmp_path: Path,
) -> None:
    assert {verb.partition(" ")[0] for verb in ASKED} == SESSION_COMMANDS - FOR_PEOPLE - FOLLOWING
    (tmp_path / "system.yaml").write_text(SYSTEM, encoding="utf-8")
    with replaying(tmp_path / "system.yaml", tmp_path / "logs") as replay:
        session = str(tmp_path / "logs" / "latest")

        def ask(verb: str, arguments: list[str]) -> subprocess.CompletedProcess[str]:
            command = [str(COMMAND), *verb.split(), *arguments, "--json", "--session", session]
            return finished(command, cwd=tmp_path)

        replay.read_until_states({"/talker": "loaded"})
        until(lambda: ask("wait", ["--for", "ready"]).returncode == 0, "the system")
        until(lambda: ask("snapshot", []).returncode == 0, "what holds topics")
        for verb, arguments in ASKED.items():
            done = ask(verb, arguments)
            assert done.returncode == 0, (verb, done.stderr)
            lines = done.stdout.splitlines()
            assert lines, verb
            for line in lines:
                assert isinstance(json.loads(line), dict | list), (verb, line)

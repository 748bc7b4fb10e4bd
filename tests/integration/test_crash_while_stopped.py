"""What crashes while the system is stopped in order is a failure: exit code and table say so."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.support.replay import COMMAND


@pytest.mark.parametrize(("signal", "code"), [("SEGV", 1), ("ABRT", 1), ("KILL", 0), ("TERM", 0)])
def test_a_process_that_crashes_is_a_failure_and_one_that_is_killed_is_none(
    signal: str, code: int, tmp_path: Path
) -> None:
    faulty = f"trap 'kill -{signal} $$' INT; echo ready; while :; do sleep 0.05; done"
    nodes = [
        {"name": "faulty", "command": ["bash", "-c", faulty]},
        {
            "name": "last",
            "command": ["true"],
            "on_exit": "shutdown",
            "depends_on": [{"name": "faulty", "log": "ready"}],
        },
    ]
    config = tmp_path / "config.yaml"
    # No time limit is to end it before its handler does.
    limits = {"sigint": "60 s"}
    config.write_text(json.dumps({"version": 1, "stop": limits, "nodes": nodes}), encoding="utf-8")
    run = subprocess.run(
        [str(COMMAND), "replay", str(config), "--log-dir", str(tmp_path / "logs")],
        check=False,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert run.returncode == code, run.stdout
    assert (f"stopped: exited with signal {'11' if signal == 'SEGV' else '6'}" in run.stdout) == (
        code == 1
    )


@pytest.mark.parametrize(
    ("container_type", "how", "code", "text"),
    [
        ("isolated", "segv", 1, "crashed when stopped: /bad"),
        ("isolated_mt", "exception", 1, "crashed when stopped: /bad"),
        ("isolated", "kill", 0, ""),
        ("standard", "segv", 1, "stopped: exited with signal 11"),
        ("mt", "abrt", 1, "stopped: exited with signal 6"),
    ],
)
def test_a_destructor_that_faults_is_a_failure(
    container_type: str, how: str, code: int, text: str, tmp_path: Path
) -> None:
    def component(name: str, plugin: str, **parameters: Any) -> dict[str, Any]:
        plugin = f"play_launch_demo::{plugin}"
        return {
            "package": "play_launch_demo",
            "plugin": plugin,
            "name": name,
            "parameters": parameters,
        }

    bad = component("bad", "Crasher", how=how, in_destructor=True)
    nodes = [bad, component("good", "Talker")]
    loaded = [{"name": "bad"}, {"name": "good"}]
    system = {
        "version": 1,
        "containers": [
            {"name": "box", "container_type": container_type, "composable_nodes": nodes}
        ],
        "nodes": [
            {"name": "last", "command": ["true"], "on_exit": "shutdown", "depends_on": loaded}
        ],
    }
    config = tmp_path / "config.yaml"
    config.write_text(json.dumps(system), encoding="utf-8")
    run = subprocess.run(
        [str(COMMAND), "replay", str(config), "--log-dir", str(tmp_path / "logs")],
        check=False,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert run.returncode == code, run.stdout
    assert text in run.stdout, run.stdout
    if container_type.startswith("isolated"):
        assert "lost" not in run.stdout, run.stdout
        assert ("/bad crashed: " in run.stdout) == (code == 1), run.stdout

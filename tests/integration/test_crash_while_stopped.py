"""What crashes while the system is stopped in order is a failure: exit code and table say so."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.replay import run
from tests.support.scenes import container, node, written


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
    # No time limit is to end it before its handler does.
    config = written(tmp_path, stop={"sigint": "60 s"}, nodes=nodes)
    done = run("replay", str(config), "--log-dir", str(tmp_path / "logs"))
    assert done.returncode == code, done.stdout
    assert (f"stopped: exited with signal {'11' if signal == 'SEGV' else '6'}" in done.stdout) == (
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
    bad = node("bad", "Crasher", parameters={"how": how, "in_destructor": True})
    loaded = [{"name": "bad"}, {"name": "good"}]
    last = {"name": "last", "command": ["true"], "on_exit": "shutdown", "depends_on": loaded}
    box = container("box", bad, node("good"), container_type=container_type)
    config = written(tmp_path, containers=[box], nodes=[last])
    done = run("replay", str(config), "--log-dir", str(tmp_path / "logs"))
    assert done.returncode == code, done.stdout
    assert text in done.stdout, done.stdout
    if container_type.startswith("isolated"):
        assert "lost" not in done.stdout, done.stdout
        assert ("/bad crashed: " in done.stdout) == (code == 1), done.stdout

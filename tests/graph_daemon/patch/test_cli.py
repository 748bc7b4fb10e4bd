"""``play-launch daemon patch | unpatch``: what is told, and the exit codes."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence

import pytest
from typer.testing import CliRunner, Result

from play_launch.cli.daemon import daemon_app
from play_launch.graph_daemon.patch import install
from play_launch.graph_daemon.patch.manifest import PACKAGE
from tests.graph_daemon.patch.conftest import Ros

Run = Callable[..., Result]


@pytest.fixture
def run(ros: Ros, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run a verb with the stand-in's Python; its ros2cli is taken for a known one."""
    defaults = install.plan_patch.__kwdefaults__
    assert defaults is not None
    monkeypatch.setitem(defaults, "known", ros.known)

    def call(*arguments: str, python: Sequence[str] = ("--python", str(ros.python))) -> Result:
        return CliRunner().invoke(daemon_app, [*arguments, *python])

    return call


def test_a_dry_run_shows_everything_and_changes_nothing(run: Run, ros: Ros) -> None:
    before = ros.tree()
    shown = run("patch", "--dry-run")
    assert shown.exit_code == 0
    assert ros.tree() == before
    assert f"ros2cli 0.32.2 (jazzy) in {ros.ros2cli}" in shown.output
    assert f"would write in {ros.site}:" in shown.output
    run("patch")
    for name in ros.tree().keys() - before.keys() - {f"{PACKAGE}/manifest.json"}:
        assert f"  {name} (" in shown.output


def test_there_and_back(run: Run, ros: Ros) -> None:
    before = ros.tree()
    patched = run("patch")
    assert patched.exit_code == 0
    assert f"written to {ros.site} and verified" in patched.output
    assert "ros2 daemon stop" in patched.output

    after = ros.tree()
    again = run("patch")
    assert again.exit_code == 0
    assert "nothing to do" in again.output
    shown = run("unpatch", "--dry-run")
    assert shown.exit_code == 0
    assert f"would remove from {ros.site}" in shown.output
    assert ros.tree() == after

    unpatched = run("unpatch")
    assert unpatched.exit_code == 0
    assert ros.tree() == before
    again = run("unpatch")
    assert again.exit_code == 0
    assert "not patched" in again.output


def test_edits_are_kept_without_force(run: Run, ros: Ros) -> None:
    run("patch")
    path = ros.site / PACKAGE / "calling.py"
    path.write_text("# mine\n", encoding="utf-8")
    for verb in ("patch", "unpatch"):
        refused = run(verb)
        assert refused.exit_code == 2
        assert str(path) in refused.output
    assert path.read_text(encoding="utf-8") == "# mine\n"
    assert run("unpatch", "--force").exit_code == 0
    assert not path.exists()


def test_what_does_not_work_ends_with_1(run: Run, ros: Ros) -> None:
    path = ros.ros2cli / "daemon" / "__init__.py"
    path.write_text(path.read_text(encoding="utf-8") + "\nraise OSError('broken')\n")
    before = ros.tree()
    failed = run("patch")
    assert failed.exit_code == 1
    assert "broken" in failed.output
    assert ros.tree() == before


def test_what_is_left_of_a_removed_ros2cli_can_be_taken_away(run: Run, ros: Ros) -> None:
    before = ros.tree()
    run("patch")
    shutil.rmtree(ros.ros2cli)
    for path in ros.site.glob("ros2cli-*"):
        shutil.rmtree(path)
    assert run("patch").exit_code == 2
    assert run("unpatch").exit_code == 0
    assert ros.tree() == {n: c for n, c in before.items() if not n.startswith("ros2cli")}


def test_without_ros2_there_is_advice(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    for verb in ("patch", "unpatch"):
        lost = run(verb, python=())
        assert lost.exit_code == 2
        assert "source your ROS 2 first" in lost.output

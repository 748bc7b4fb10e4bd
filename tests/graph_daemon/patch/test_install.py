"""Putting the overlay in place and taking it away: all or nothing, and nothing else."""

from __future__ import annotations

import dataclasses
import fcntl
import json
import os
import shutil
from pathlib import Path

import pytest

from play_launch.graph_daemon.patch import PatchError, VerificationError, install
from play_launch.graph_daemon.patch.install import Action, PatchPlan, overlays, plan_patch, remove
from play_launch.graph_daemon.patch.manifest import PACKAGE, STARTER
from tests.graph_daemon.patch.conftest import Ros, known_of, write_release

MARKS = """
import ros2cli.daemon, ros2cli.node.network_aware, ros2cli.xmlrpc.local_server
import sys
print([getattr(sys.modules[n], "__play_launch__", None) for n in (
    "ros2cli.daemon", "ros2cli.node.network_aware", "ros2cli.xmlrpc.local_server")])
"""
PATCHED = "['calling', 'checking', 'serving']"
STOCK = "[None, None, None]"


def plan(ros: Ros, *, force: bool = False) -> PatchPlan:
    return plan_patch(ros.target(), force=force, known=ros.known)


def patch(ros: Ros) -> None:
    plan(ros).carry_out()


def unpatch(ros: Ros, *, force: bool = False) -> None:
    ((place, manifest),) = overlays(ros.target())
    remove(place, manifest, force=force)


def test_patching_adds_files_and_changes_none(ros: Ros) -> None:
    before = ros.tree()
    planned = plan(ros)
    assert (planned.action, planned.place, planned.distribution) == (
        Action.WRITE,
        ros.site,
        "jazzy",
    )
    assert ros.tree() == before
    planned.carry_out()
    after = ros.tree()
    assert after.items() > before.items()
    assert after.keys() - before.keys() == {*planned.contents, f"{PACKAGE}/manifest.json"}
    assert ros.run(MARKS) == PATCHED


def test_unpatching_restores_the_folder(ros: Ros) -> None:
    before = ros.tree()
    patch(ros)
    unpatch(ros)
    assert ros.tree() == before
    assert not (ros.site / PACKAGE).exists()
    assert ros.run(MARKS) == STOCK
    assert overlays(ros.target()) == []


def test_a_second_patch_finds_nothing_to_do(ros: Ros) -> None:
    patch(ros)
    before = {path: path.stat().st_mtime_ns for path in ros.site.rglob("*.py")}
    again = plan(ros)
    assert again.action is Action.NOTHING
    again.carry_out()
    assert {path: path.stat().st_mtime_ns for path in ros.site.rglob("*.py")} == before


def test_other_programs_of_that_python_are_left_alone(ros: Ros) -> None:
    patch(ros)
    loaded = ros.run("import sys; print([n for n in sys.modules if 'play_launch' in n])")
    assert loaded == f"['{PACKAGE}']"


def test_a_newer_overlay_replaces_an_older_one(ros: Ros) -> None:
    older = plan(ros)
    contents = older.contents | {f"{PACKAGE}/gone.py": b"# of an older release\n"}
    dataclasses.replace(older, contents=contents).carry_out()
    newer = plan(ros)
    assert newer.action is Action.REPLACE
    newer.carry_out()
    assert not (ros.site / PACKAGE / "gone.py").exists()
    assert plan(ros).action is Action.NOTHING


@pytest.mark.parametrize("name", [f"{PACKAGE}/serving.py", STARTER])
def test_a_lost_file_is_written_again(ros: Ros, name: str) -> None:
    patch(ros)
    (ros.site / name).unlink()
    assert plan(ros).action is Action.REPLACE
    patch(ros)
    assert ros.run(MARKS) == PATCHED


def test_an_updated_ros2cli_is_left_alone_until_it_is_patched_again(ros: Ros) -> None:
    patch(ros)
    helpers = ros.ros2cli / "helpers.py"
    helpers.write_text(helpers.read_text(encoding="utf-8") + "\n# newer\n", encoding="utf-8")
    assert ros.run(MARKS) == STOCK
    assert plan(ros).action is Action.REPLACE
    patch(ros)
    assert ros.run(MARKS) == PATCHED


def test_a_removed_overlay_disturbs_no_python(ros: Ros) -> None:
    patch(ros)
    shutil.rmtree(ros.site / PACKAGE)
    assert ros.run(MARKS) == STOCK


@pytest.mark.parametrize("name", [f"{PACKAGE}/serving.py", f"{PACKAGE}/own.py", STARTER])
def test_what_somebody_has_edited_stays(ros: Ros, name: str) -> None:
    patch(ros)
    path = ros.site / name
    path.write_bytes((path.read_bytes() if path.exists() else b"") + b"\n# mine\n")
    before = ros.tree()
    for act in (unpatch, plan):
        with pytest.raises(PatchError, match=rf"edited or added.*{path.name}.*--force"):
            act(ros)
    assert ros.tree() == before
    unpatch(ros, force=True)
    assert not (ros.site / PACKAGE).exists()
    assert not (ros.site / STARTER).exists()


def test_with_force_an_edited_overlay_is_written_anew(ros: Ros) -> None:
    patch(ros)
    (ros.site / PACKAGE / "serving.py").write_text("# mine\n", encoding="utf-8")
    forced = plan(ros, force=True)
    assert forced.action is Action.REPLACE
    forced.carry_out()
    assert ros.run(MARKS) == PATCHED


@pytest.mark.parametrize(
    ("file", "code", "reason"),
    [
        ("daemon/__init__.py", "raise RuntimeError('no middleware')", "no middleware"),
        ("xmlrpc/local_server.py", "del get_local_ipaddrs", "serving failed"),
        ("daemon/__init__.py", "RequestHandler.rpc_paths = ('/elsewhere/',)", "a call was answer"),
        ("daemon/__init__.py", "import os; os._exit(3)", "ended with status 3"),
    ],
)
def test_what_does_not_work_is_taken_back(ros: Ros, file: str, code: str, reason: str) -> None:
    # Beside the definitions that are known; only trying it shows that.
    path = ros.ros2cli / file
    path.write_text(path.read_text(encoding="utf-8") + f"\n{code}\n", encoding="utf-8")
    before = ros.tree()
    with pytest.raises(VerificationError, match=reason):
        patch(ros)
    assert ros.tree() == before
    assert not list(ros.site.glob(f"{PACKAGE}*"))


def test_a_replacement_that_does_not_work_leaves_the_old_one(ros: Ros) -> None:
    patch(ros)
    before = ros.tree()
    broken = {f"{PACKAGE}/serving.py": b"def apply(module): raise KeyError('broken')\n"}
    planned = plan(ros)
    planned = dataclasses.replace(
        planned, action=Action.REPLACE, contents=planned.contents | broken
    )
    with pytest.raises(VerificationError, match="broken"):
        planned.carry_out()
    assert ros.tree() == before
    assert ros.run(MARKS) == PATCHED


def test_an_overlay_that_fails_leaves_ros2_usable(ros: Ros) -> None:
    patch(ros)
    (ros.site / PACKAGE / "serving.py").write_text("raise OSError('torn')\n", encoding="utf-8")
    assert ros.run(MARKS) == "['calling', 'checking', \"serving failed: OSError('torn')\"]"


def test_an_interrupted_patch_is_taken_back(ros: Ros, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(_target: object) -> None:
        raise KeyboardInterrupt

    before = ros.tree()
    monkeypatch.setattr(install, "verify", interrupted)
    with pytest.raises(KeyboardInterrupt):
        patch(ros)
    assert ros.tree() == before


def test_what_a_killed_run_left_is_swept_away(ros: Ros) -> None:
    for rest in (f"{PACKAGE}.new", f"{PACKAGE}.old"):
        (ros.site / rest).mkdir()
        (ros.site / rest / "half.py").touch()
    patch(ros)
    assert not list(ros.site.glob(f"{PACKAGE}.new*")) + list(ros.site.glob(f"{PACKAGE}.old*"))


def test_files_are_readable_for_everybody(ros: Ros) -> None:
    mask = os.umask(0o077)
    try:
        patch(ros)
    finally:
        os.umask(mask)
    for name in [STARTER, f"{PACKAGE}/__init__.py", f"{PACKAGE}/manifest.json"]:
        assert (ros.site / name).stat().st_mode & 0o777 == 0o644
    assert (ros.site / PACKAGE).stat().st_mode & 0o777 == 0o755


def test_want_of_permissions_is_reported_with_the_fix(
    ros: Ros, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Tests may run as root, whom modes do not stop.
    def refuse(path: Path, content: bytes) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    before = ros.tree()
    monkeypatch.setattr(install, "_write_file", refuse)
    with pytest.raises(PatchError, match=r"sudo.*--user"):
        patch(ros)
    assert ros.tree() == before
    assert not list(ros.site.glob(f"{PACKAGE}*"))


def test_want_of_permissions_stops_unpatching_before_it_begins(
    ros: Ros, monkeypatch: pytest.MonkeyPatch
) -> None:
    patch(ros)
    before = ros.tree()
    monkeypatch.setattr(os, "access", lambda *_arguments: False)
    with pytest.raises(PatchError, match=r"with sudo.*ROS\)$"):
        unpatch(ros)
    assert ros.tree() == before


def test_two_at_once_do_not_mix(ros: Ros) -> None:
    descriptor = os.open(ros.site, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        with pytest.raises(PatchError, match="another patch or unpatch is at work"):
            patch(ros)
    finally:
        os.close(descriptor)


def test_folders_that_were_made_go_again(ros: Ros, tmp_path: Path) -> None:
    target = dataclasses.replace(ros.target(), user_site=tmp_path / "a" / "b")
    planned = plan_patch(target, for_user=True, known=ros.known)
    with pytest.raises(VerificationError):
        planned.carry_out()  # Nothing reads that folder.
    assert not (tmp_path / "a").exists()


def test_for_the_user_alone(ros: Ros) -> None:
    with pytest.raises(PatchError, match="leave --user away"):
        plan_patch(ros.target(), for_user=True, known=ros.known)


def test_unknown_releases_are_refused(ros: Ros) -> None:
    write_release(ros.site, "0.40.0")
    before = ros.tree()
    with pytest.raises(PatchError, match=r"ros2cli 0\.40\.0 is not known"):
        patch(ros)
    assert ros.tree() == before


def test_an_overlay_can_be_removed_when_ros2cli_is_no_longer_known(ros: Ros) -> None:
    patch(ros)
    write_release(ros.site, "0.40.0")
    unpatch(ros)
    assert not (ros.site / PACKAGE).exists()


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda text: "{", "damaged"),
        (lambda text: "[]", "damaged"),
        (lambda text: text.replace('"format": 1', '"format": 2'), "newer play-launch"),
        (lambda text: text.replace(f"{PACKAGE}/serving.py", "../../etc/passwd"), "damaged"),
        (lambda text: text.replace(f"{PACKAGE}/serving.py", f"{PACKAGE}/.."), "damaged"),
        (lambda text: text.replace('"files"', '"pages"'), "damaged"),
        (None, "without its manifest"),
    ],
)
def test_a_damaged_manifest_is_not_acted_on(ros: Ros, damage: object, reason: str) -> None:
    patch(ros)
    path = ros.site / PACKAGE / "manifest.json"
    if callable(damage):
        path.write_text(damage(path.read_text(encoding="utf-8")), encoding="utf-8")
    else:
        path.unlink()
    before = ros.tree()
    for act in (unpatch, plan):
        with pytest.raises(PatchError, match=reason):
            act(ros)
    assert ros.tree() == before
    if path.exists():
        # Without a manifest that can be read, the hook does nothing, too.
        assert ros.run(MARKS) in {PATCHED, STOCK}


def test_the_manifest_lists_what_was_done(ros: Ros) -> None:
    patch(ros)
    facts = json.loads((ros.site / PACKAGE / "manifest.json").read_text(encoding="utf-8"))
    assert facts["ros2cli"]["version"] == "0.32.2"
    assert facts["ros2cli"]["distribution"] == "jazzy"
    assert set(facts["ros2cli"]["files"]) == set(known_of(ros.ros2cli).files)
    assert facts["written_by"].startswith("play-launch")

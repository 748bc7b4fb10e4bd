"""What `replay` starts before it reads its configuration, and what becomes of it."""

from __future__ import annotations

import json
import os
import subprocess
import time
from pathlib import Path
from typing import Any

import psutil
import pytest
import yaml

from play_launch.container.ros import component_container
from play_launch.runtime import prestart as head_start
from play_launch.runtime.prestart import kinds_of_containers
from tests.support.replay import COMMAND, Replay, replaying

PROGRAM = component_container()


def container(name: str, kind: str, **settings: Any) -> dict[str, Any]:
    node = {
        "package": "play_launch_demo",
        "plugin": "play_launch_demo::Talker",
        "name": f"n_{name}",
    }
    return {"name": name, "container_type": kind, "composable_nodes": [node], **settings}


def written(path: Path, *containers: dict[str, Any]) -> Path:
    path.write_text(yaml.safe_dump({"version": 1, "containers": list(containers)}), "utf-8")
    return path


def address_of(process: psutil.Process) -> str:
    """Where its program is in memory: the same in all forks of one zygote."""
    lines = Path(f"/proc/{process.pid}/maps").read_text(encoding="utf-8").splitlines()
    return next(line for line in lines if line.endswith(str(PROGRAM))).partition("-")[0]


def running_containers(replay: Replay, *names: str) -> dict[str, psutil.Process]:
    replay.read_until_states({f"/n_{name}": "loaded" for name in names})
    found: dict[str, psutil.Process] = {}
    for process in replay.descendants():
        arguments = process.cmdline()
        found |= {name: process for name in names if f"__node:={name}" in arguments}
    return found


@pytest.mark.parametrize("library", ["librclcpp.so", "librcl.so"])
def test_a_program_with_rclcpp_is_not_linked_in_vain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, library: str
) -> None:
    program = tmp_path / "component_container"
    program.write_bytes(b"#!/bin/sh\nexit 0\n#\0" + library.encode() + b"\0")
    program.chmod(0o755)
    monkeypatch.setattr(head_start, "component_container", lambda: program)
    head_start.begin(written(tmp_path / "system.yaml", container("c", "isolated")))
    begun = head_start.take()
    assert begun.guard is not None
    for zygote in begun.zygotes:
        zygote.close()
    begun.guard.close()
    assert len(begun.zygotes) == (library == "librcl.so")


def is_left(replay: Replay) -> bool:
    return any(each.cmdline()[1:2] == ["--zygote"] for each in replay.descendants())


def has_left(replay: Replay) -> bool:
    deadline = time.monotonic() + 10
    while is_left(replay) and time.monotonic() < deadline:
        time.sleep(0.01)
    return not is_left(replay)


def test_containers_of_both_kinds_are_forked_and_then_the_zygotes_leave(tmp_path: Path) -> None:
    config = written(
        tmp_path / "both.yaml",
        *(container(f"s{i}", "standard") for i in range(2)),
        *(container(f"i{i}", "isolated") for i in range(2)),
        container("other", "standard", environment={"MALLOC_ARENA_MAX": "3"}),
    )
    with replaying(config, tmp_path / "logs") as replay:
        found = running_containers(replay, "s0", "s1", "i0", "i1", "other")
        at = {name: address_of(process) for name, process in found.items()}
        assert at["s0"] == at["s1"] != at["other"]
        assert at["i0"] == at["i1"] != at["s0"]
        assert found["other"].environ()["MALLOC_ARENA_MAX"] == "3"
        assert "LD_PRELOAD" in found["i0"].environ()
        assert "LD_PRELOAD" not in found["s0"].environ()
        assert has_left(replay)
        # Started again, it is executed: where it is in memory changes.
        found["s1"].kill()
        replay.read_until(
            lambda event: event["event"] == "node" and event["state"] == "loading", "the restart"
        )
        again = running_containers(replay, "s1")["s1"]
        assert address_of(again) != at["s0"]


def test_it_can_be_switched_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PLAY_LAUNCH_ZYGOTE", "0")
    config = written(tmp_path / "off.yaml", *(container(f"c{i}", "standard") for i in range(2)))
    with replaying(config, tmp_path / "logs") as replay:
        found = running_containers(replay, "c0", "c1")
        assert address_of(found["c0"]) != address_of(found["c1"])


def refused(config: Path, **environment: str) -> tuple[int, str, str]:
    done = subprocess.run(
        [COMMAND, "replay", config],
        env={**os.environ, **environment},
        check=False,
        capture_output=True,
        text=True,
        timeout=60,
    )
    return done.returncode, done.stdout, done.stderr


def test_what_is_no_file_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.yaml"
    os.mkfifo(pipe)
    result = subprocess.run(
        [COMMAND, "replay", str(pipe)], check=False, capture_output=True, text=True, timeout=60
    )
    assert result.returncode == 2
    assert "is no regular file" in result.stderr


def test_a_mistake_in_the_configuration_leaves_nothing(tmp_path: Path) -> None:
    config = written(tmp_path / "bad.yaml", container("c", "standard", no_such_setting=1))
    mark = f"{tmp_path}"
    with_zygote = refused(config, MARK_OF_THIS_TEST=mark)
    assert with_zygote == refused(config, PLAY_LAUNCH_ZYGOTE="0")
    assert with_zygote[0] == 2
    deadline = time.monotonic() + 10
    while (left := marked(mark)) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not left


def marked(mark: str) -> list[psutil.Process]:
    found = []
    for process in psutil.process_iter():
        try:
            if process.environ().get("MARK_OF_THIS_TEST") == mark:
                found.append(process)
        except psutil.Error:
            continue
    return found


@pytest.mark.parametrize(
    ("text", "kinds"),
    [
        ("version: 1\nnodes: []", []),
        ("containers: [{name: a}]", [False]),
        ("containers: [{name: a, container_type: mt}]", [False]),
        ("containers: [{name: a, container_type: stock}]", []),
        ("containers:\n- container_type: 'isolated_mt'\n", [True]),
        (json.dumps({"containers": [{"container_type": "isolated"}]}), [True]),
        ("containers:\n- container_type: isolated\n- container_type: standard", [False, True]),
    ],
)
def test_the_text_says_which_containers_there_will_be(text: str, kinds: list[bool]) -> None:
    assert kinds_of_containers(text.encode()) == kinds

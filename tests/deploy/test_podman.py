"""Manifests for Kubernetes, run by Podman: an image of this machine's own files."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

import play_launch
from tests.support.replay import COMMAND, finished, run
from tests.support.waiting import until

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.skipif(
    not all(map(shutil.which, ("podman", "runc", "catatonit"))) or os.geteuid() != 0,
    reason="needs podman with runc and catatonit, and root",
)
IMAGE = "localhost/play-launch-test:1"
CONTAINER = "robot-pod-0-play-launch"
SYSTEM = """\
version: 1
name: robot
environment: {ROS_AUTOMATIC_DISCOVERY_RANGE: LOCALHOST}
containers:
  - name: sense
    container_type: isolated
    composable_nodes:
      - {package: play_launch_demo, plugin: "play_launch_demo::Talker", name: talker,
         parameters: [talker.yaml]}
nodes:
  - {name: plan, command: [sleep, "1000"]}
"""
# What a machine without systemd, with control groups of version 1, or without some right needs.
SETTINGS = """\
[containers]
default_ulimits = ["nofile=16384:16384", "nproc=30000:30000"]
[engine]
runtime = "runc"
events_logger = "file"
cgroup_manager = "cgroupfs"
"""


class Podman:
    """Podman with a storage of its own."""

    def __init__(self, folder: Path, run_root: str) -> None:
        (folder / "containers.conf").write_text(SETTINGS)
        self._options = {"env": {**os.environ, "CONTAINERS_CONF": f"{folder}/containers.conf"}}
        self._words = ["podman", "--root", folder / "store", "--runroot", run_root]

    def __call__(
        self, *words: object, code: int | None = 0, **options: Any
    ) -> subprocess.CompletedProcess[str]:
        return finished([*self._words, *words], code=code, **self._options, **options)


@pytest.fixture
def podman(tmp_path: Path) -> Iterator[Podman]:
    image = tmp_path / "image.tar"
    with tarfile.open(image, "w") as archive:
        for name in ("tmp", "proc", "dev", "sys", "usr", "etc"):
            entry = tarfile.TarInfo(name)
            entry.type, entry.mode = tarfile.DIRTYPE, 0o755
            archive.addfile(entry)
        for name in ("bin", "sbin", "lib", "lib64"):
            entry = tarfile.TarInfo(name)
            entry.type, entry.linkname = tarfile.SYMTYPE, f"usr/{name}"
            archive.addfile(entry)
        for name in ("etc/ld.so.cache", "etc/passwd"):
            content = Path("/", name).read_bytes()
            entry = tarfile.TarInfo(name)
            entry.size = len(content)
            archive.addfile(entry, io.BytesIO(content))
    with tempfile.TemporaryDirectory() as run_root:  # at most 50 characters
        made = Podman(tmp_path, run_root)
        path = f"ENV PATH={COMMAND.parent}:/usr/bin"
        made("import", "--change", path, image, IMAGE)
        yield made
        made("pod", "rm", "--force", "--all")
        made("rmi", "--force", "--all")


def manifest(folder: Path) -> Path:
    """What `kubernetes` writes, with this machine's files for those that the image lacks."""
    # Podman makes no folders for the files of a ConfigMap.
    (folder / "talker.yaml").write_text("/**:\n  ros__parameters: {rate: 1.0}\n")
    (folder / "system.yaml").write_text(SYSTEM)
    run("kubernetes", folder / "system.yaml", "--image", IMAGE, "-o", folder / "k8s", code=0)
    documents = list(yaml.safe_load_all((folder / "k8s/system.yaml").read_text()))
    pod = documents[1]["spec"]["template"]["spec"]
    code = Path(play_launch.__file__).parent.parent
    for number, path in enumerate(dict.fromkeys(["/usr", sys.prefix, sys.base_prefix, str(code)])):
        name = f"machine{number}"
        pod["volumes"].append({"name": name, "hostPath": {"path": path}})
        mount = {"name": name, "mountPath": path, "readOnly": True}
        pod["containers"][0]["volumeMounts"].append(mount)
    (recordings,) = (each for each in pod["volumes"] if each["name"] == "recordings")
    recordings["hostPath"]["path"] = str(folder / "recordings")
    written = folder / "play.yaml"
    written.write_text(yaml.safe_dump_all(documents))
    return written


def test_a_pod_runs_the_system_and_stops_it_in_order(tmp_path: Path, podman: Podman) -> None:
    podman("kube", "play", manifest(tmp_path))
    # Podman 4.3 runs no probes by itself; these are theirs.
    probe = ("exec", CONTAINER, "play-launch", "wait", "--for", "loaded", "--timeout", "1s")
    until(lambda: podman(*probe, code=None).returncode == 0, "the readiness probe")
    podman("exec", CONTAINER, "play-launch", "ps")
    podman("pod", "stop", "--time", "30", "robot-pod-0")
    ended = json.loads(podman("inspect", CONTAINER).stdout)[0]["State"]
    assert ended["ExitCode"] == 143
    recording = next((tmp_path / "recordings").glob("*-robot/session.mcap"))
    assert "Nothing was wrong" in run("explain", recording, code=0).stdout

"""Kubernetes manifests, as the schemas of Kubernetes see them."""

from __future__ import annotations

import importlib.util
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.support.replay import finished, run

SYSTEM = """\
version: 1
name: My Robot
machines: {main: {local: true}, vision: {}}
include: more.yaml
environment: {ROS_DOMAIN_ID: "5"}
stop: {ask: 1 s, sigint: 1 s, sigterm: 1 s}
containers:
  - name: sense
    machine: vision
    container_type: isolated
    resources: {scheduler: {policy: fifo, priority: 10}}
    composable_nodes:
      - {package: play_launch_demo, plugin: "play_launch_demo::Talker", name: talker,
         parameters: [params/params.yaml]}
nodes:
  - {name: plan, command: [sleep, "${arg:seconds:-9}"], depends_on: [{node: talker}]}
"""


def written(folder: Path, text: str, *words: str, code: int = 0) -> str:
    (folder / "more.yaml").write_text("version: 1\n")
    (folder / "params").mkdir()
    (folder / "params/params.yaml").write_text("/**:\n  ros__parameters: {rate: 1.0}\n")
    (folder / "system.yaml").write_text(text)
    done = run("kubernetes", folder / "system.yaml", *words, code=code)
    return done.stdout + done.stderr


def documents(text: str) -> list[dict[str, Any]]:
    return list(yaml.safe_load_all(text))


def test_each_machine_is_a_deployment_with_its_part(tmp_path: Path) -> None:
    config, main, vision = documents(written(tmp_path, SYSTEM, "seconds:=7", "--image", "robot:2"))
    assert config["kind"] == "ConfigMap"
    assert len(config["data"]) == 3
    assert [each["metadata"]["name"] for each in (main, vision)] == [
        "my-robot-main",
        "my-robot-vision",
    ]
    pod = vision["spec"]["template"]["spec"]
    (container,) = pod["containers"]
    assert container["image"] == "robot:2"
    words = ["play-launch", "replay", "--quiet", "--watch", "--machine", "vision"]
    assert container["command"][:6] == words
    assert container["command"][-1] == "seconds:=7"
    assert pod["nodeSelector"] == {"play-launch/machine": "vision"}
    assert container["securityContext"]["capabilities"]["add"] == ["SYS_NICE"]
    assert "securityContext" not in main["spec"]["template"]["spec"]["containers"][0]
    assert pod["terminationGracePeriodSeconds"] > 3
    # The files lie where the command looks for them.
    paths = {f"/etc/play_launch/{each['path']}" for each in pod["volumes"][0]["configMap"]["items"]}
    assert container["command"][6] in paths
    assert "/etc/play_launch/params/params.yaml" in paths


def test_the_files_of_the_config_map_are_a_configuration_that_is_accepted(tmp_path: Path) -> None:
    config, _, vision = documents(written(tmp_path, SYSTEM))
    items = vision["spec"]["template"]["spec"]["volumes"][0]["configMap"]["items"]
    for item in items:
        path = tmp_path / "mounted" / item["path"]
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(config["data"][item["key"]])
    source = tmp_path / "mounted/system.yaml"
    assert "1 container with 1 node" in run("check", source, "--machine", "vision", code=0).stdout


def test_files_of_a_package_are_those_of_the_image(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    share = tmp_path / "prefix/share"
    for path in ("ament_index/resource_index/packages/other", "other/more.yaml"):
        (share / path).parent.mkdir(parents=True)
        (share / path).write_text("/**:\n  ros__parameters: {rate: 2.0}\n")
    monkeypatch.setenv(
        "AMENT_PREFIX_PATH", f"{tmp_path}/prefix:{os.environ.get('AMENT_PREFIX_PATH', '')}"
    )
    named = SYSTEM.replace("/params.yaml]", '/params.yaml, "$(find-pkg-share other)/more.yaml"]')
    config, *_ = documents(written(tmp_path, named))
    assert sorted(config["data"]) == ["more.yaml", "params_params.yaml", "system.yaml"]


@pytest.mark.parametrize(
    ("change", "words", "kind"),
    [
        ("", ("--fleet",), "DaemonSet"),
        ("duration: 30 s\n", (), "Job"),
        ("", (), "Deployment"),
    ],
)
@pytest.mark.parametrize("version", ["1.30", "1.36"])
def test_kubernetes_accepts_them(
    tmp_path: Path, change: str, words: tuple[str, ...], kind: str, version: str
) -> None:
    found = documents(written(tmp_path, SYSTEM + change, *words))
    assert [each["kind"] for each in found] == ["ConfigMap", kind, kind]
    if importlib.util.find_spec("kubernetes_validate") is None:
        pytest.skip("needs kubernetes-validate, which has the schemas")
    import kubernetes_validate

    for each in found:
        kubernetes_validate.validate(each, version, strict=True)


@pytest.mark.parametrize(
    ("image", "name", "tag"),
    [
        ("registry/robot:2", "registry/robot", "2"),
        ("registry:5000/robot", "registry:5000/robot", "latest"),
        ("registry:5000/robot:2", "registry:5000/robot", "2"),
    ],
)
def test_a_folder_gets_an_overlay(tmp_path: Path, image: str, name: str, tag: str) -> None:
    written(tmp_path, SYSTEM, "--output", str(tmp_path / "k8s"), "--image", image)
    overlay = yaml.safe_load((tmp_path / "k8s/kustomization.yaml").read_text())
    assert set(overlay["resources"]) == {"system.yaml", "namespace.yaml"}
    assert overlay["images"] == [{"name": name, "newName": name, "newTag": tag}]
    assert documents((tmp_path / "k8s/system.yaml").read_text())


def test_pods_that_would_not_find_each_other_are_warned_of(tmp_path: Path) -> None:
    local = SYSTEM.replace('"5"', '"5", ROS_AUTOMATIC_DISCOVERY_RANGE: LOCALHOST')
    assert "its nodes find none of other machines" in written(tmp_path, local)


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    output = tmp_path / "system.yaml/k8s"
    assert f"{output}: Not a directory" in written(tmp_path, SYSTEM, "-o", str(output), code=1)


@pytest.mark.skipif(not shutil.which("kubectl"), reason="needs kubectl, which has kustomize")
def test_kustomize_moves_all_to_another_namespace_and_image(tmp_path: Path) -> None:
    folder = tmp_path / "k8s"
    written(tmp_path, SYSTEM, "--output", str(folder), "--image", "registry/robot:1")
    overlay = folder / "kustomization.yaml"
    changed = overlay.read_text().replace("namespace: my-robot", "namespace: fleet")
    overlay.write_text(changed.replace("newTag: '1'", "newTag: '2'"))
    built = finished(["kubectl", "kustomize", folder], code=0).stdout
    namespace, *others = sorted(documents(built), key=lambda each: each["kind"] != "Namespace")
    assert (namespace["kind"], namespace["metadata"]["name"]) == ("Namespace", "fleet")
    assert {each["metadata"]["namespace"] for each in others} == {"fleet"}
    pods = [each["spec"]["template"]["spec"] for each in others if each["kind"] == "Deployment"]
    images = [each["image"] for pod in pods for each in pod["containers"]]
    assert images == ["registry/robot:2"] * 2


@pytest.mark.parametrize(
    ("change", "words", "expected"),
    [
        (("{node: talker}", "talker"), (), "wait for a topic, service or node"),
        (("include: more.yaml", "duration: 3 s"), ("--fleet",), "is no DaemonSet"),
        (("include: more.yaml", "discovery: {by: peers}"), (), "set ROS_STATIC_PEERS"),
        (("vision: {}", "vision: {copy: [nothing]}"), (), "there is no"),
        (("name: sense", "nme: sense"), (), "nothing was written"),
        (("seconds:-9", "seconds:-8"), ("--image", "robot@sha256:1", "-o", "k8s"), "give a tag"),
    ],
)
def test_what_cannot_run_there_is_refused(
    tmp_path: Path, change: tuple[str, str], words: tuple[str, ...], expected: str
) -> None:
    assert change[0] in SYSTEM
    assert expected in written(tmp_path, SYSTEM.replace(*change), *words, code=2)

"""The configuration comes back from a recording as it was, and what differs is named."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from msgspec.structs import replace

from play_launch.cli.recorded_system import differences
from play_launch.config.description import describe
from play_launch.config.load import load_config
from play_launch.config.problems import ConfigError
from play_launch.postmortem.recorded_config import RecordedConfig, recorded_config
from play_launch.recording.bag import BagWriter
from play_launch.recording.environment import versions
from play_launch.recording.session import SessionDescription, write_head

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.config.model import ReplayConfig

CONFIG = """version: 1
containers:
  - name: box
    composable_nodes:
      - package: play_launch_demo
        plugin: play_launch_demo::Talker
        name: talker
        parameters: [{rate: 2.0}, FILE, other/params.yaml]
nodes:
  - {name: job, package: no_such_package, executable: job}
"""
PARAMETERS = "/**:\n  ros__parameters: {%s: 1}\n"


def head(path: Path, config: ReplayConfig, environ: Mapping[str, str], *, finished: bool) -> Path:
    writer = BagWriter(path)
    description = SessionDescription(
        name=config.name,
        config_name=config.source.name,
        config_text=config.text,
        parameter_files=[(file.path.name, file.text) for file in config.parameter_files],
        resolved_config=json.dumps(describe(config)),
        argv=("play-launch",),
        environ=environ,
    )
    write_head(writer, description, "id", now=1)
    if finished:
        writer.close()
        return path
    writer.flush()
    writer.abandon()
    return path.with_name(f"{path.name}.active")


@pytest.fixture
def config(tmp_path: Path) -> ReplayConfig:
    """A system whose two parameter files have one name, in different folders."""
    folder = tmp_path / "robot"
    for name, key in (("params.yaml", "a"), ("other/params.yaml", "b")):
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(PARAMETERS % key)
    file = folder / "robot.yaml"
    file.write_text(CONFIG.replace("FILE", str(folder / "params.yaml")))
    return load_config(file)


@pytest.mark.parametrize("finished", [True, False])
def test_it_is_the_same_without_the_original_files(
    tmp_path: Path, config: ReplayConfig, finished: bool
) -> None:
    bag = head(tmp_path / "x.mcap", config, {}, finished=finished)
    (tmp_path / "robot").rename(tmp_path / "elsewhere")
    found = recorded_config(bag)
    assert found.config == config
    assert found.resolved == json.loads(json.dumps(describe(config)))


def test_files_below_another_home_are_found_by_their_names(
    tmp_path: Path, config: ReplayConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(config.source.parent))
    config.source.write_text(CONFIG.replace("FILE", "~/params.yaml"))
    bag = head(tmp_path / "x.mcap", load_config(config.source), {}, finished=True)
    monkeypatch.setenv("HOME", "/home/somebody_else")
    (tmp_path / "robot").rename(tmp_path / "elsewhere")
    (container,) = recorded_config(bag).config.containers
    names = {parameter.name for parameter in container.composable_nodes[0].parameters}
    assert names == {"rate", "a", "b"}


def test_a_recording_without_a_configuration_is_refused(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "x.mcap")
    writer.close()
    with pytest.raises(ConfigError, match="is an MCAP recording; give the YAML"):
        recorded_config(tmp_path / "x.mcap")


def test_a_cut_head_is_refused(tmp_path: Path, config: ReplayConfig) -> None:
    whole = head(tmp_path / "x.mcap", config, {}, finished=True).read_bytes()
    for size in (0, 5, 20, 100, 300):
        (tmp_path / "x.mcap").write_bytes(whole[:size])
        with pytest.raises(ConfigError):
            recorded_config(tmp_path / "x.mcap")


def recorded(tmp_path: Path, config: ReplayConfig, **environ: str) -> RecordedConfig:
    return recorded_config(head(tmp_path / "x.mcap", config, environ, finished=True))


def test_what_differs_here_is_named(tmp_path: Path, config: ReplayConfig) -> None:
    found = recorded(tmp_path, config, RMW_IMPLEMENTATION="rmw_x", ROS_DOMAIN_ID="5", EDITOR="vi")
    here = {"RMW_IMPLEMENTATION": "rmw_x", "ROS_DOMAIN_ID": "5"}
    (text,) = differences(found, here, versions())
    assert text.startswith("package no_such_package is not installed here")
    texts = list(differences(found, {"ROS_DOMAIN_ID": "6"}, {}))
    assert "RMW_IMPLEMENTATION was 'rmw_x', here it is not set" in texts
    assert "ROS_DOMAIN_ID was '5', here it is '6'" in texts
    assert any(text.startswith("play-launch-py: recorded with ") for text in texts)
    assert not any("EDITOR" in text for text in texts)


def test_what_this_version_resolves_in_another_way_is_named(
    tmp_path: Path, config: ReplayConfig
) -> None:
    found = recorded(tmp_path, config)
    then = json.loads(json.dumps(found.resolved))
    then["containers"][0]["probe_timeout"] = 1234.5
    then["key_of_an_older_version"] = 1
    texts = list(differences(replace(found, resolved=then), {}, versions()))
    now = found.config.containers[0].probe_timeout
    assert f"containers[0].probe_timeout was 1234.5, here it is {now}" in texts
    assert len(texts) == 2  # and the package

"""What follows the evaluation, from records of real ones; the evaluation itself where launch is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from play_launch.config.load import load_config
from play_launch.launch_files.configuration.request import Options
from play_launch.launch_files.configuration.write import written
from tests.launch_files import recorded
from tests.launch_files.writing import load
from tests.support.launch import needs_launch
from tests.support.replay import replaying

PAGE = Path(__file__).resolve().parents[2] / "docs" / "launch-files.md"
BLOCK = re.compile(r"<!-- (?:file|written): (\S+) -->\n```\w+\n(.*?)```", re.DOTALL)


@pytest.mark.parametrize("name", recorded.NAMES)
def test_a_record_becomes_this_configuration(name: str) -> None:
    expected = (recorded.FOLDER / name / "robot.yaml").read_text(encoding="utf-8")
    assert recorded.configuration(name) == expected


@needs_launch
@pytest.mark.parametrize("name", recorded.OWN)
def test_launch_gives_what_was_recorded(name: str) -> None:
    expected = (recorded.FOLDER / name / "record.json").read_text(encoding="utf-8")
    assert recorded.record(name) == expected


def test_replay_brings_up_what_was_recorded(tmp_path: Path) -> None:
    made = written(recorded.description("robot"), Options(folder=tmp_path), "From x.")
    config = load(made, tmp_path)
    talker, listener = config.containers[0].composable_nodes
    assert {each.name: each.value.value for each in talker.parameters} == {
        "rate": 20.0,
        "prefix": "from the file",
    }
    assert dict(listener.remappings) == {"chatter": "/words"}
    # The same for all three is said once.
    assert made.text.count("ROBOT") == 1
    assert config.containers[0].environment["ROBOT"] == "small"
    with replaying(tmp_path / "written.yaml", tmp_path / "log") as replay:
        replay.read_until_states(recorded.NODES)


def test_a_file_in_which_nothing_was_changed_is_named(tmp_path: Path) -> None:
    found = recorded.description("costmaps")
    assert "p.yaml" in written(found, Options(folder=tmp_path), "").text
    inline = written(found, Options(folder=tmp_path, inline=True), "")
    assert "p.yaml" not in inline.text
    (tmp_path / "inline.yaml").write_text(inline.text, encoding="utf-8")
    (server,) = load_config(tmp_path / "inline.yaml").nodes
    assert {each.name for each in server.parameters} == {"everywhere", "a", "b"}


def test_the_page_shows_a_recorded_launch_file() -> None:
    (file, text), (same, configuration) = BLOCK.findall(PAGE.read_text(encoding="utf-8"))
    assert file == same == "robot.launch.xml"
    folder = recorded.FOLDER / "page"
    assert text == (folder / file).read_text(encoding="utf-8")
    heading = f"From {file}, by play-launch dump."
    made = written(recorded.description("page"), Options(folder=folder), heading)
    assert configuration == made.text

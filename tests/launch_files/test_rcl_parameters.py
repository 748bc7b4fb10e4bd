"""Parameter files, read by rcl and by ourselves."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pytest

from play_launch.config.model import ParameterSection, ParameterValue
from play_launch.config.problems import Report
from play_launch.launch_files.parameters import read_sections
from play_launch.launch_files.records import ParameterFile
from play_launch.launch_files.ros_launch.rcl_parameters import RclParameters, RclParametersError

Found = dict[str, dict[str, ParameterValue]]


def plain(sections: Iterable[ParameterSection]) -> Found:
    return {
        section.pattern: {each.name: each.value for each in section.parameters}
        for section in sections
    }


def by_rcl(path: Path) -> Found | None:
    reader = RclParameters()
    try:
        reader.add_file(path)
        return plain(reader.sections())
    except RclParametersError:
        return None
    finally:
        reader.close()


def by_ourselves(path: Path) -> Found | None:
    report = Report()
    found = dict(read_sections(ParameterFile(str(path)), report))
    return None if len(report) else found


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("parameters") / "p.yaml"


def test_sections(path: Path) -> None:
    text = """
/**: {ros__parameters: {a: 1, deep: {er: [1.5, 2.5]}}}
n: {ros__parameters: {a: text, b: true}}
/space: {"*": {ros__parameters: {bytes: [1]}}, m: {ros__parameters: {c: 1}}}
"""
    path.write_text(text)
    found = by_rcl(path)
    assert found == by_ourselves(path)
    assert list(found or ()) == ["/**", "/n", "/space/*", "/space/m"]


def test_rules_are_merged_with_files_in_the_order_of_the_sections(path: Path) -> None:
    path.write_text("/**: {ros__parameters: {a: 2, b: 3}}\n")
    reader = RclParameters()
    reader.add_rule("n:a:=1")
    reader.add_file(path)
    reader.add_rule("b:=4")
    # With another type rcl keeps both, and rclcpp takes the first of its list of types.
    reader.add_rule("a:=three")
    found = {
        pattern: {name: each.value for name, each in values.items()}
        for pattern, values in plain(reader.sections()).items()
    }
    reader.close()
    assert list(found.items()) == [("/n", {"a": 1}), ("/**", {"a": 2, "b": 4})]


@pytest.mark.parametrize("rule", ["", "a", ":=1", "n::=1", "a:=[1, 2.5]", "a:={b: 1}"])
def test_rules_that_rcl_refuses(rule: str) -> None:
    reader = RclParameters()
    with pytest.raises(RclParametersError):
        reader.add_rule(rule)
    reader.close()


def test_a_file_that_is_none(path: Path) -> None:
    reader = RclParameters()
    with pytest.raises(RclParametersError, match="opening"):
        reader.add_file(path.with_name("nowhere.yaml"))
    reader.close()

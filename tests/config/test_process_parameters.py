"""`process_parameters`: sections for all nodes of a process, and the file that it gets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.config.load import load_config
from play_launch.config.model import (
    FOR_ALL,
    ContainerConfig,
    ParameterConfig,
    ParameterSection,
    ProcessConfig,
    ReplayConfig,
)
from play_launch.config.problems import ConfigError
from play_launch.config.resolve.parameter_files import matches
from play_launch.container.parameter_files import parameter_file_of
from play_launch.launch_files.configuration.request import Options
from play_launch.launch_files.configuration.write import written
from play_launch.launch_files.parameters import take_sections
from play_launch.launch_files.records import (
    Description,
    LaunchedProcess,
    ProgramKind,
)
from play_launch.launch_files.ros_launch.rcl_parameters import RclParameters
from tests.container.channel.values import FILE_VALUES
from tests.launch_files.values import shown


def load(folder: Path, entry: str) -> ReplayConfig:
    path = folder / "robot.yaml"
    path.write_text(f"version: 1\n{entry}", encoding="utf-8")
    return load_config(path)


def mistakes(folder: Path, entry: str) -> str:
    with pytest.raises(ConfigError) as caught:
        load(folder, entry)
    return str(caught.value)


def plain(sections: tuple[ParameterSection, ...]) -> dict[str, dict[str, Any]]:
    return {
        section.pattern: {each.name: each.value.value for each in section.parameters}
        for section in sections
    }


PROCESS = "nodes:\n- package: p\n  executable: e\n  name: server\n  process_parameters: "


def test_files_and_mappings_are_put_together(tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_text(
        "server: {ros__parameters: {a: 1, none: []}}\n"
        "costmap: {costmap: {ros__parameters: {size: 2}}}\n"
        "/empty: {ros__parameters: {}}\n"
    )
    (process,) = load(
        tmp_path, f"{PROCESS}[p.yaml, {{/costmap/costmap: {{deep: {{er: 1.0}}}}, '/**': {{b: x}}}}]"
    ).nodes
    assert plain(process.process_parameters) == {
        "/server": {"a": 1},
        "/costmap/costmap": {"size": 2, "deep.er": 1.0},
        "/**": {"b": "x"},
    }
    assert list(plain(process.process_parameters)) == ["/server", "/costmap/costmap", "/**"]


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("p.yaml", "put the file into a list"),
        ("[[]]", "expected a mapping of names of nodes to parameters, or the path"),
        ("{server: 1}", "expected parameter names and values"),
        ("{a b: {x: 1}}", "is not the full name of a node, nor a pattern"),
        ("{server: {x: []}}", "an empty list has no type"),
        ("[missing.yaml]", "missing.yaml"),
    ],
)
def test_mistakes(value: str, message: str, tmp_path: Path) -> None:
    assert message in mistakes(tmp_path, PROCESS + value)


def test_a_container_that_runs_already_takes_none(tmp_path: Path) -> None:
    begin = "containers:\n- {name: c, container_type: stock, attach: true, "
    assert "not for attach: true" in mistakes(tmp_path, begin + "process_parameters: {a: {b: 1}}}")
    assert "not for attach: true" in mistakes(tmp_path, begin + "on_exit: shutdown}")
    found = mistakes(tmp_path, "containers:\n- {name: c, on_exit: ignore}")
    assert "containers have restart and shutdown" in found


def test_sources_of_an_included_file_come_first(tmp_path: Path) -> None:
    (tmp_path / "base.yaml").write_text(f"version: 1\n{PROCESS}{{/a: {{x: 1, y: 1}}}}")
    config = load(tmp_path, f"include: base.yaml\n{PROCESS}{{/a: {{x: 2}}}}")
    assert plain(config.nodes[0].process_parameters) == {"/a": {"x": 2, "y": 1}}


PATTERNS = st.sampled_from([FOR_ALL, "/a/n", "/a/*", "/**/n", "/costmap/costmap", "/other", "/*"])
SECTIONS = st.dictionaries(
    PATTERNS,
    st.dictionaries(st.sampled_from("xyz"), FILE_VALUES, min_size=1),
    max_size=5,
)
UNITS = st.sampled_from(
    [
        LaunchedProcess(package="p", executable="e", name="n", namespace="/a"),
        LaunchedProcess(package="p", executable="e"),
        LaunchedProcess(command=["e"]),
        LaunchedProcess(
            kind=ProgramKind.CONTAINER,
            package="rclcpp_components",
            executable="component_container",
            name="n",
            namespace="/a",
        ),
    ]
)


def of_node(sections: list[ParameterSection], name: str) -> dict[str, str]:
    """Return what a node of that name takes, as rclcpp does it."""
    found = {}
    for section in sections:
        if matches(section.pattern, name):
            found.update({each.name: shown(each.value) for each in section.parameters})
    return found


@given(SECTIONS, UNITS)
def test_each_node_gets_what_it_would_get_of_ros(
    tmp_path_factory: pytest.TempPathFactory, drawn: dict[str, Any], unit: LaunchedProcess
) -> None:
    sections = [
        ParameterSection(pattern, tuple(map(ParameterConfig, values, values.values())))
        for pattern, values in drawn.items()
    ]
    take_sections(unit, sections)
    folder = tmp_path_factory.getbasetemp()
    made = written(Description(units=[unit]), Options(folder=folder), "From x.")
    assert not [each for each in made.losses if not each.is_note]
    (folder / "made.yaml").write_text(made.text, encoding="utf-8")
    config = load_config(folder / "made.yaml")
    members: list[ContainerConfig | ProcessConfig] = [*config.containers, *config.nodes]
    (member,) = members
    (folder / "parameters.yaml").write_text(parameter_file_of(member) or "{}", encoding="utf-8")
    reader = RclParameters()
    reader.add_file(folder / "parameters.yaml")
    back = list(reader.sections())
    reader.close()
    names = ["/a/n", "/other", "/costmap/costmap", "/b/c/d", "/a/m", "/n"]
    if not member.process_parameters:
        # Without any for others, the node's own are for all that happen to be in its process.
        names = [unit.full_name or "/other"]
    for name in names:
        assert of_node(back, name) == of_node(sections, name), made.text

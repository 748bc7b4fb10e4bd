"""What dumps of another program become, and that nothing of them is lost in silence."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from play_launch.config.compose import Reading, compose
from play_launch.config.description import describe
from play_launch.config.load import load_config
from play_launch.config.model import ParameterType, ReplayConfig
from play_launch.config.problems import ConfigError, Report
from play_launch.config.substitutions import Lookup, substitute
from play_launch.config.tree import Cursor, Mapping
from play_launch.launch_files.configuration.write import Written
from play_launch.launch_files.configuration.yaml_text import yaml_text
from play_launch.launch_files.importing.fields import typed_values
from play_launch.launch_files.importing.read import NotImportableError, import_system
from tests.launch_files.importing.autoware_like import (
    CONTAINERS,
    PER_CONTAINER,
    launch_dump,
    system_model,
)
from tests.support.loopback_network import permitted
from tests.support.replay import COMMAND, replaying

FORMATS = ("record.json", "system_model.yaml")


def write(folder: Path, name: str, *, stand_in: bool = False) -> Path:
    path = folder / name
    if name.endswith(".json"):
        path.write_text(json.dumps(launch_dump(stand_in=stand_in)), encoding="utf-8")
    else:
        path.write_text(yaml.safe_dump(system_model(stand_in=stand_in)), encoding="utf-8")
    return path


def loaded(imported: Written, folder: Path) -> ReplayConfig:
    path = folder / "imported.yaml"
    path.write_text(imported.text, encoding="utf-8")
    return load_config(path)


def dumped(folder: Path, **lists: Any) -> Written:
    path = folder / "record.json"
    path.write_text(json.dumps({"node": [], **lists}), encoding="utf-8")
    return import_system(path)


def lost(imported: Written) -> list[str]:
    return [f"{each.where}: {each.what}" for each in imported.losses if not each.is_note]


@pytest.mark.parametrize("name", FORMATS)
def test_a_large_system_becomes_a_configuration(name: str, tmp_path: Path) -> None:
    imported = import_system(write(tmp_path, name))
    assert not imported.problems
    assert lost(imported) == []
    config = loaded(imported, tmp_path)
    assert len(config.containers) == CONTAINERS
    assert all(len(each.composable_nodes) == PER_CONTAINER for each in config.containers)
    by_name = {each.full_name: each for each in config.containers}
    assert by_name["/area_0/container_0"].container_type == "mt"
    node = by_name["/area_1/container_1"].composable_nodes[0]
    types = {each.name: each.value.type for each in node.parameters}
    assert types == {
        "rate": ParameterType.DOUBLE,
        "use_sim_time": ParameterType.BOOL,
        "gains": ParameterType.DOUBLE_ARRAY,
    }
    assert node.remappings == (("chatter", "/area/lane_1"),)
    assert [each.value.value for each in node.extra_arguments] == [True]
    assert config.nodes[0].full_name == "/system/monitor"


def test_both_formats_become_the_same(tmp_path: Path) -> None:
    first, second = (loaded(import_system(write(tmp_path, name)), tmp_path) for name in FORMATS)

    def meaning(config: ReplayConfig) -> Any:
        found = describe(config)
        containers: Any = found["containers"]
        return {each["full_name"]: each["container_type"] for each in containers}

    assert meaning(first) == meaning(second)


def test_parameters_are_evaluated_as_rcl_does(tmp_path: Path) -> None:
    named = "/a/n: {ros__parameters: {x: 2}}\n/other: {ros__parameters: {z: 1}}\n"
    sources = [
        {"kind": "inline", "name": "x", "value": "1"},
        {"kind": "file", "content": named},
        {"kind": "inline", "name": "x", "value": "3"},
    ]
    node = {"executable": "e", "package": "p", "name": "n", "namespace": "/a", "cmd": []}
    imported = dumped(tmp_path, node=[{**node, "param_sources": sources}])
    process = loaded(imported, tmp_path).nodes[0]
    (parameter,) = process.parameters
    # The section for all was mentioned before that for this node.
    assert (parameter.name, parameter.value.value) == ("x", 2)
    assert [each.pattern for each in process.process_parameters] == ["/**", "/other"]
    assert lost(imported) == []


def test_what_a_configuration_refuses_in_a_file_is_reported_with_its_line(tmp_path: Path) -> None:
    content = "/**:\n  ros__parameters:\n    a: yes\n    b: 1\n"
    node = {"executable": "e", "package": "p", "name": "n", "namespace": "/a"}
    sources = [{"kind": "file", "content": content}]
    imported = dumped(tmp_path, node=[{**node, "param_sources": sources}])
    (only,) = lost(imported)
    assert "its parameter file:3:" in only
    (parameter,) = loaded(imported, tmp_path).nodes[0].parameters
    assert (parameter.name, parameter.value.value) == ("b", 1)


def test_what_has_no_place_is_reported(tmp_path: Path) -> None:
    node = {
        "executable": "$(var program)",
        "package": "p",
        "name": "n",
        "namespace": "/",
        "args": ["$(var missing)"],
        "ros_args": ["-r", "__node:=other", "--log-level", "debug"],
        "remaps": [["a", "b"], ["a", "c"], ["x*", "y"]],
        "params": [["empty", ""]],
        "novelty": 5,
    }
    imported = dumped(
        tmp_path,
        node=[node, {**node, "novelty": None}, {"executable": "x", "name": "raw"}],
        variables={"program": "real"},
        expected_graph={"topics": {}},
        load_node=[{"package": "p", "plugin": "p::C", "target_container_name": "/far"}],
    )
    found = "\n".join(lost(imported))
    for text in (
        "a variable without a value: $(var missing)",
        "__node:=other: a name that its arguments give",
        "the remapping x*:=y",
        "the parameter empty has no value",
        "the field novelty is not understood",
        "a second node is called /n",
        "neither a package nor a command",
        "expected_graph",
    ):
        assert text in found
    config = loaded(imported, tmp_path)
    assert config.nodes[0].executable == "real"
    assert config.nodes[0].arguments == ("$(var missing)",)
    assert config.nodes[0].remappings == (("a", "b"),)
    assert config.containers[0].attach


@pytest.mark.parametrize(
    "content", ["", "{", "[]", "{}", "a: [", "node: 5", "\x00", '{"node": 1}', "[" * 100_000]
)
def test_what_is_no_dump_is_refused(content: str, tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(NotImportableError):
        import_system(path)
    with pytest.raises(NotImportableError):
        import_system(tmp_path / "missing.json")


KEYS = st.text(min_size=1, max_size=8).filter(lambda key: "$" not in key)
"""A key takes no substitution, and none can be escaped in it."""
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=5),
    lambda below: st.lists(below, max_size=3) | st.dictionaries(st.text(max_size=5), below),
    max_leaves=8,
)
RECORDS = st.dictionaries(
    st.sampled_from(
        [
            "name",
            "namespace",
            "package",
            "executable",
            "params",
            "remaps",
            "env",
            "args",
            "cmd",
            "plugin",
            "node_name",
            "target_container_name",
            "param_sources",
            "respawn",
            "scope",
        ]
    ),
    JSON | st.text(max_size=8) | st.lists(st.tuples(st.text(max_size=4), st.text(max_size=4))),
)


@given(
    st.fixed_dictionaries(
        {"node": st.lists(RECORDS | JSON, max_size=2)},
        optional={
            "container": st.lists(RECORDS, max_size=2),
            "load_node": st.lists(RECORDS, max_size=2),
        },
    )
)
def test_any_dump_becomes_something(tmp_path_factory: pytest.TempPathFactory, dump: Any) -> None:
    path = tmp_path_factory.getbasetemp() / "any.json"
    path.write_text(json.dumps(dump), encoding="utf-8")
    import_system(path)


@given(st.dictionaries(KEYS, st.text(max_size=12), max_size=4))
def test_texts_are_read_as_they_were_written(values: dict[str, str]) -> None:
    report = Report()
    lookup = Lookup(lambda _: None, lambda _: None, str)
    reading = Reading(substitute=lambda text: substitute(text, lookup))
    root = compose(yaml_text({"at": values}), "x", report, reading)
    assert isinstance(root, Mapping)
    found = {entry.key: Cursor(entry.value, "", report).string for entry in _entries(root)}
    assert found == values


def _entries(root: Mapping) -> Any:
    below = root.value("at")
    assert isinstance(below, Mapping)
    return below.entries


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("5", ParameterType.INTEGER),
        ("5.", ParameterType.DOUBLE),
        ("1e3", ParameterType.DOUBLE),
        ("True", ParameterType.BOOL),
        ("yes", ParameterType.STRING),
        ("['a', b]", ParameterType.STRING_ARRAY),
        ("[1, 2.5]", ParameterType.DOUBLE_ARRAY),
        ("[", ParameterType.STRING),
    ],
)
def test_types(text: str, kind: ParameterType) -> None:
    values = typed_values("x", text)
    assert values is not None
    assert [each.type for each in values.values()] == [kind]


def test_the_command(tmp_path: Path) -> None:
    source, target = write(tmp_path, "record.json"), tmp_path / "robot.yaml"
    command = [str(COMMAND), "import", str(source)]
    done = subprocess.run(
        [*command, "-o", str(target), "--json", "--strict"],
        check=True,
        capture_output=True,
        text=True,
    )
    assert json.loads(done.stdout)["containers"] == CONTAINERS
    load_config(target)
    source.write_text(json.dumps({"node": [], "novelty": 1, "load_node": []}))
    for options, code in (([], 2), (["--strict"], 2)):
        shown = subprocess.run([*command, *options], check=False, capture_output=True, text=True)
        assert shown.returncode == code
        assert "not carried over: (top level): the field novelty" in shown.stderr
    with pytest.raises(ConfigError):
        load_config(source)


@pytest.mark.parametrize("name", FORMATS)
def test_an_imported_system_replays(name: str, tmp_path: Path) -> None:
    imported = import_system(write(tmp_path, name, stand_in=True))
    config = loaded(imported, tmp_path)
    wanted = {
        str(node.declared_full_name): "loaded"
        for container in config.containers
        for node in container.composable_nodes
    }
    assert len(wanted) == CONTAINERS * PER_CONTAINER
    network = permitted()
    with replaying(tmp_path / "imported.yaml", tmp_path / "log", in_a_network=network) as replay:
        replay.read_until_states(wanted)

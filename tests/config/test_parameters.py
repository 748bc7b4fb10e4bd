"""Types of parameters: decided by how a value is written, and kept."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from play_launch.config.load import load_config, parse_config
from play_launch.config.model import ParameterType, ParameterValue
from play_launch.config.problems import ConfigError
from play_launch.config.resolve.parameter_files import matches

NAMES = st.from_regex(r"[a-z][a-z_]{0,8}", fullmatch=True)
TEXT = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20)
INTEGERS = st.integers(-(2**63), 2**63 - 1)
DOUBLES = st.floats(allow_nan=True, allow_infinity=True)


def read(yaml_value: str) -> ParameterValue:
    """Return the parameter written as `yaml_value`."""
    text = f"version: 1\nnodes:\n- command: [x]\n  parameters:\n    p: {yaml_value}\n"
    (parameter,) = parse_config(text.encode(), Path("demo.yaml")).nodes[0].parameters
    return parameter.value


@pytest.mark.parametrize(
    ("written", "kind", "value"),
    [
        ("true", ParameterType.BOOL, True),
        ("FALSE", ParameterType.BOOL, False),
        ("7", ParameterType.INTEGER, 7),
        ("-0", ParameterType.INTEGER, 0),
        ("0x1F", ParameterType.INTEGER, 31),
        ("0o17", ParameterType.INTEGER, 15),
        ("9223372036854775807", ParameterType.INTEGER, 2**63 - 1),
        ("1.0", ParameterType.DOUBLE, 1.0),
        ("1e3", ParameterType.DOUBLE, 1000.0),
        (".inf", ParameterType.DOUBLE, math.inf),
        ("-.INF", ParameterType.DOUBLE, -math.inf),
        ("!!float 1", ParameterType.DOUBLE, 1.0),
        ('"true"', ParameterType.STRING, "true"),
        ("'1.0'", ParameterType.STRING, "1.0"),
        ('""', ParameterType.STRING, ""),
        ('"yes"', ParameterType.STRING, "yes"),
        ("!!str 5", ParameterType.STRING, "5"),
        ("10:30", ParameterType.STRING, "10:30"),
        ("2024-05-01", ParameterType.STRING, "2024-05-01"),
        ("1_000", ParameterType.STRING, "1_000"),
        ("1.2.3", ParameterType.STRING, "1.2.3"),
        ("'010'", ParameterType.STRING, "010"),
        ("!!binary aGVsbG8=", ParameterType.BYTE_ARRAY, b"hello"),
        ("!byte_array [0, 255]", ParameterType.BYTE_ARRAY, b"\x00\xff"),
        ("!byte_array []", ParameterType.BYTE_ARRAY, b""),
        ("[true, false]", ParameterType.BOOL_ARRAY, (True, False)),
        ("[1, 2]", ParameterType.INTEGER_ARRAY, (1, 2)),
        ("[1.0, .inf]", ParameterType.DOUBLE_ARRAY, (1.0, math.inf)),
        ("!double_array [1, 2.5]", ParameterType.DOUBLE_ARRAY, (1.0, 2.5)),
        ('[a, "1"]', ParameterType.STRING_ARRAY, ("a", "1")),
        ("!bool_array []", ParameterType.BOOL_ARRAY, ()),
        ("!integer_array []", ParameterType.INTEGER_ARRAY, ()),
        ("!double_array []", ParameterType.DOUBLE_ARRAY, ()),
        ("!string_array []", ParameterType.STRING_ARRAY, ()),
    ],
)
def test_types(written: str, kind: ParameterType, value: object) -> None:
    parameter = read(written)
    assert parameter == ParameterValue(kind, value)  # type: ignore[arg-type]
    assert type(parameter.value) is type(value)


def test_not_a_number() -> None:
    value = read(".nan")
    assert value.type is ParameterType.DOUBLE
    assert math.isnan(value.value)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("written", "fragment"),
    [
        ("089", "write 89, or quote it"),
        ("-017", "write -17, or quote it"),
        ("00", "write 0 or 0o0"),
        ("[yes]", 'write true or "yes"'),
        ("[n]", 'write false or "n"'),
        ("~", "no value is given"),
        ("[1, ~]", "no value is given"),
        ("!string_array [1]", 'quote it: "1"'),
        ("!integer_array [1.5]", "does not belong into !integer_array"),
        ("!string_array x", "belongs to a list"),
        ("!string_array {a: b}", "belongs to a list"),
        ("[{a: 1}]", "cannot hold a mapping in a list"),
        ("[!!binary AA==]", "must have one type"),
        ('"a\\0b"', "NUL"),
        ("-9223372036854775809", "64-bit"),
        ("!!float 0x" + "f" * 390, "larger than any double"),
        ("!double_array [" + "9" * 400 + "]", "64-bit"),
        ("!!timestamp 2024-05-01", "the tag !!timestamp is not supported"),
        ("!!set {a}", "the tag !!set is not supported"),
    ],
)
def test_refused(written: str, fragment: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read(written)
    assert fragment in str(caught.value)


class _Dumper(yaml.SafeDumper):
    """Writes tuples as lists with the tag that keeps empty ones typed."""


def _write_array(dumper: yaml.SafeDumper, value: ParameterValue) -> yaml.Node:
    items = value.value
    assert isinstance(items, tuple)
    tag = f"!{value.type.name.lower()}" if not items else "tag:yaml.org,2002:seq"
    return dumper.represent_sequence(tag, items, flow_style=True)


def _write_value(dumper: yaml.SafeDumper, value: ParameterValue) -> yaml.Node:
    if isinstance(value.value, tuple):
        return _write_array(dumper, value)
    return dumper.represent_data(value.value)


def _write_text(dumper: yaml.SafeDumper, value: str) -> yaml.Node:
    return dumper.represent_scalar("tag:yaml.org,2002:str", value, style='"')


def _write_double(dumper: yaml.SafeDumper, value: float) -> yaml.Node:
    text = (
        repr(value)
        if math.isfinite(value)
        else (".nan" if value != value else f"{value:+}"[0] + ".inf")
    )
    return dumper.represent_scalar("tag:yaml.org,2002:float", text)


_Dumper.add_representer(ParameterValue, _write_value)
_Dumper.add_representer(str, _write_text)
_Dumper.add_representer(float, _write_double)

VALUES = st.one_of(
    st.builds(ParameterValue, st.just(ParameterType.BOOL), st.booleans()),
    st.builds(ParameterValue, st.just(ParameterType.INTEGER), INTEGERS),
    st.builds(ParameterValue, st.just(ParameterType.DOUBLE), DOUBLES),
    st.builds(ParameterValue, st.just(ParameterType.STRING), TEXT),
    st.builds(ParameterValue, st.just(ParameterType.BYTE_ARRAY), st.binary(max_size=20)),
    *(
        st.builds(ParameterValue, st.just(kind), st.lists(of, max_size=4).map(tuple))
        for kind, of in (
            (ParameterType.BOOL_ARRAY, st.booleans()),
            (ParameterType.INTEGER_ARRAY, INTEGERS),
            (ParameterType.DOUBLE_ARRAY, DOUBLES),
            (ParameterType.STRING_ARRAY, TEXT),
        )
    ),
)


@given(st.dictionaries(NAMES, VALUES, min_size=1, max_size=5), st.booleans())
def test_values_of_all_types_survive_yaml(
    values: dict[str, ParameterValue], allow_unicode: bool
) -> None:
    document = {"version": 1, "nodes": [{"command": ["x"], "parameters": values}]}
    text = yaml.dump(document, Dumper=_Dumper, allow_unicode=allow_unicode, sort_keys=False)
    (node,) = parse_config(text.encode(), Path("demo.yaml")).nodes
    # repr, because nan is not equal to itself and -0.0 is equal to 0.0
    assert [(one.name, repr(one.value)) for one in node.parameters] == [
        (name, repr(value)) for name, value in values.items()
    ]


@given(st.dictionaries(NAMES, st.dictionaries(NAMES, INTEGERS, min_size=1), min_size=1))
def test_nested_names_are_joined_with_dots(nested: dict[str, dict[str, int]]) -> None:
    document = {"version": 1, "nodes": [{"command": ["x"], "parameters": nested}]}
    (node,) = parse_config(yaml.dump(document).encode(), Path("demo.yaml")).nodes
    assert {one.name: one.value.value for one in node.parameters} == {
        f"{outer}.{inner}": value
        for outer, below in nested.items()
        for inner, value in below.items()
    }


@pytest.mark.parametrize(
    ("pattern", "name", "matching"),
    [
        ("/**", "/a", True),
        ("/**", "/a/b/c", True),
        ("/*", "/a", True),
        ("/*", "/a/b", False),
        ("/a/*", "/a/b", True),
        ("/a/**", "/a/b/c", True),
        ("/**/c", "/c", True),
        ("/**/c", "/a/b/c", True),
        ("/**/c", "/a/c/b", False),
        ("/*/c", "/a/c", True),
        ("/**/b/*/d", "/b/b/c/d", True),
        ("/a", "/a/b", False),
        ("/a/b", "/a", False),
    ],
)
def test_sections_of_parameter_files(pattern: str, name: str, matching: bool) -> None:
    assert matches(pattern, name) is matching


def load_with_file(directory: Path, content: str, node: str) -> dict[str, object]:
    (directory / "file.yaml").write_text(content)
    config = directory / "demo.yaml"
    config.write_text(f"version: 1\nnodes:\n- {{command: [x], {node}parameters: [file.yaml]}}\n")
    (process,) = load_config(config).nodes
    return {one.name: one.value.value for one in process.parameters}


@pytest.mark.parametrize("section", ["/ns/a", "ns/a", "/ns", "ns"])
def test_names_in_parameter_files_nest(tmp_path: Path, section: str) -> None:
    below = (
        "{a: {ros__parameters: {x: 1}}}" if section.endswith("ns") else "{ros__parameters: {x: 1}}"
    )
    found = load_with_file(tmp_path, f"{section}: {below}\n", "name: a, namespace: ns, ")
    assert found == {"x": 1}


def test_an_unnamed_node_takes_what_is_for_all(tmp_path: Path) -> None:
    assert load_with_file(tmp_path, "/**: {ros__parameters: {x: 1}}\n", "") == {"x": 1}


def test_an_empty_parameter_file_gives_nothing(tmp_path: Path) -> None:
    assert load_with_file(tmp_path, "# nothing\n", "") == {}
    assert load_with_file(tmp_path, "---\n", "") == {}


@pytest.mark.parametrize(
    ("content", "beginning"),
    [
        ("ros__parameters: {a: 1}\n", "1:1: ros__parameters: ros__parameters needs a node name"),
        ("/a: {ros__parameters: 5}\n", "1:23: /a.ros__parameters: expected parameter names"),
        ("/a b: {ros__parameters: {}}\n", '1:1: "/a b": "/a b" is neither'),
        ("- 1\n", "1:1: (top level): expected node names"),
        ("/a: {ros__parameters: {b: 1}\n", "2:1: (yaml): did not find expected"),
        ("/a:\n  ros__parameters: {}\n  ros__parameters: {}\n", "3:3: /a.ros__parameters: the key"),
    ],
)
def test_problems_inside_of_parameter_files(tmp_path: Path, content: str, beginning: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_with_file(tmp_path, content, "name: a, ")
    assert str(caught.value).startswith(f"{tmp_path / 'file.yaml'}:{beginning}")


def test_a_parameter_file_that_is_no_text(tmp_path: Path) -> None:
    (tmp_path / "file.yaml").write_bytes(b"/a:\n  \xff\n")
    config = tmp_path / "demo.yaml"
    config.write_text("version: 1\nnodes:\n- {command: [x], parameters: [file.yaml, ./]}\n")
    with pytest.raises(ConfigError) as caught:
        load_config(config)
    in_config, in_file = caught.value.problems
    assert "is a directory" in in_config.message
    assert (in_config.line, in_config.column, in_config.path) == (3, 42, "nodes[0].parameters[1]")
    assert (Path(in_file.file).name, in_file.line, in_file.column) == ("file.yaml", 2, 3)

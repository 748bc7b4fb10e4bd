"""Parameters keep their types all the way, also through a file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from play_launch.config.model import ParameterConfig, ParameterType, ParameterValue
from play_launch.container.parameter_files import (
    ParameterFileError,
    parameter_file_text,
)
from tests.container.channel.values import FILE_VALUES
from tests.support.ros import begin

NAMES = st.from_regex(r"[a-z][a-z0-9_]{0,8}(\.[a-z][a-z0-9_]{0,8}){0,2}", fullmatch=True)


def parameter(kind: ParameterType, value: Any, name: str = "p") -> ParameterConfig:
    return ParameterConfig(name, ParameterValue(kind, value))


def through_yaml(parameters: list[ParameterConfig]) -> dict[str, Any]:
    text = parameter_file_text([("/**", parameters)])
    loaded: dict[str, Any] = yaml.safe_load(text)["/**"]["ros__parameters"]
    return loaded


@given(FILE_VALUES, NAMES)
def test_a_file_keeps_value_and_type_for_yaml(value: ParameterValue, name: str) -> None:
    (loaded,) = through_yaml([ParameterConfig(name, value)]).values()
    if isinstance(value.value, tuple):
        loaded = tuple(loaded)
        assert [type(item) for item in loaded] == [type(item) for item in value.value]
    assert loaded == value.value
    assert type(loaded) is type(value.value)


@pytest.mark.parametrize(
    ("value", "spelling"),
    [
        (1.0, "1.0"),
        (-0.0, "-0.0"),
        (1e300, "1.0e+300"),
        (1.5e-7, "1.5e-07"),
        (math.inf, ".inf"),
        (-math.inf, "-.inf"),
        (math.nan, ".nan"),
    ],
)
def test_a_double_looks_like_one(value: float, spelling: str) -> None:
    text = parameter_file_text([("/**", [parameter(ParameterType.DOUBLE, value)])])
    assert text.endswith(f'"p": {spelling}\n')


def test_a_later_value_wins() -> None:
    twice = [parameter(ParameterType.INTEGER, 1), parameter(ParameterType.STRING, "2")]
    assert through_yaml(twice) == {"p": "2"}


@pytest.mark.parametrize(
    ("kind", "value", "text"),
    [
        (ParameterType.BYTE_ARRAY, b"\1", "byte array"),
        (ParameterType.STRING_ARRAY, (), "empty array"),
        (ParameterType.DOUBLE, -1e-310, "as a string"),
        (ParameterType.DOUBLE_ARRAY, (1.0, 1e-310), "as a string"),
    ],
)
def test_what_a_file_cannot_say_is_refused(kind: ParameterType, value: Any, text: str) -> None:
    with pytest.raises(ParameterFileError, match=rf"camera\.gain: .*{text}"):
        parameter_file_text([("/**", [parameter(kind, value, "camera.gain")])])


HARD_STRINGS = [
    "true", "1", "1.0", "null", "~", "", " spaces ", "a: b # c", "'", '"', "\\", "[1]", "{a: 1}",
    "line\nline", "tab\t", "bell\a", "\x7f", "\x85", "\u2028", "\ufeff", "ümläut", "😀", "%", "!x",
    "*a", "&a", "long " * 100,
]  # fmt: skip


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(FILE_VALUES, max_size=12))
def test_rcl_reads_what_was_meant(tmp_path: Path, drawn: list[ParameterValue]) -> None:
    check_with_rcl(tmp_path, drawn)


def test_rcl_reads_hard_strings_as_strings(tmp_path: Path) -> None:
    strings = [ParameterValue(ParameterType.STRING, text) for text in HARD_STRINGS]
    array = ParameterValue(ParameterType.STRING_ARRAY, tuple(HARD_STRINGS))
    check_with_rcl(tmp_path, [*strings, array])


def check_with_rcl(directory: Path, drawn: list[ParameterValue]) -> None:
    import rclpy
    from rclpy.node import Node

    wanted = {f"group.p{number}": value for number, value in enumerate(drawn)}
    parameters = [ParameterConfig(name, value) for name, value in wanted.items()]
    path = directory / "parameters.yaml"
    path.write_text(parameter_file_text([("/**", parameters)]), encoding="utf-8")
    context = begin(["--ros-args", "--params-file", str(path)])
    try:
        node = Node(
            "parameter_reader",
            context=context,
            allow_undeclared_parameters=True,
            automatically_declare_parameters_from_overrides=True,
            start_parameter_services=False,
            enable_rosout=False,
        )
        for name, value in wanted.items():
            read = node.get_parameter(name)
            assert read.type_.value == value.type, (name, value)
            got = tuple(read.value) if isinstance(value.value, tuple) else read.value
            assert got == value.value
        node.destroy_node()
    finally:
        rclpy.shutdown(context=context)
        path.unlink()

"""Types of parameters, by the rules of rcl's parser."""

from __future__ import annotations

import math

import pytest

from play_launch.config.model import ParameterType
from play_launch.launch_files.parameters import (
    ParameterTextError,
    read_sections,
    typed,
)


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("5", ParameterType.INTEGER, 5),
        ("-0x10", ParameterType.INTEGER, -16),
        ("010", ParameterType.INTEGER, 8),
        ("08", ParameterType.DOUBLE, 8.0),
        ("9223372036854775808", ParameterType.DOUBLE, 9223372036854775808.0),
        ("1e3", ParameterType.DOUBLE, 1000.0),
        (".5", ParameterType.DOUBLE, 0.5),
        ("-.inf", ParameterType.DOUBLE, -math.inf),
        ("Infinity", ParameterType.DOUBLE, math.inf),
        ("1e999", ParameterType.STRING, "1e999"),
        ("1e-310", ParameterType.STRING, "1e-310"),
        ("0x1p4", ParameterType.DOUBLE, 16.0),
        ("yes", ParameterType.BOOL, True),
        ("N", ParameterType.BOOL, False),
        ("tRUE", ParameterType.STRING, "tRUE"),
        ("null", ParameterType.STRING, "null"),
        ("~", ParameterType.STRING, "~"),
        ("10:30", ParameterType.STRING, "10:30"),
        ("1_000", ParameterType.STRING, "1_000"),
        ("2024-05-01", ParameterType.STRING, "2024-05-01"),
    ],
)
def test_types(text: str, kind: ParameterType, value: object) -> None:
    found = typed(text)
    assert (found.type, found.value) == (kind, value)


def test_sections() -> None:
    text = """
a: {b: {ros__parameters: {x: '1', y: {z: [1, 2]}}}}
/**: {ros__parameters: {x: 1}}
/a/b: {ros__parameters: {x: 2.0}}
"""
    found = {
        section.pattern: {each.name: each.value for each in section.parameters}
        for section in read_sections(text)
    }
    assert found == {"/a/b": {"x": 2.0, "y.z": (1, 2)}, "/**": {"x": 1}}
    assert list(found) == ["/a/b", "/**"]
    assert read_sections("") == []


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("- 1", 1),
        ("a: 1", 1),
        ("ros__parameters: {}", 1),
        ("a:\n  ros__parameters:\n    x: [1, 2.5]", 3),
        ("a: {ros__parameters: {x: []}}", 1),
        ("a: {ros__parameters: {x: [[1]]}}", 1),
        ("a:\n  ros__parameters:\n    x:", 3),
        ("a: {\n", 2),
        ("{a: b: c", 1),
    ],
)
def test_what_rcl_refuses(text: str, line: int) -> None:
    with pytest.raises(ParameterTextError) as error:
        read_sections(text)
    assert error.value.line in (line, 0)

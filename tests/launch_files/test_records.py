"""Records of evaluated launch files, there and back through JSON."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from play_launch.config.model import Autostart, ParameterType, ParameterValue
from play_launch.launch_files import records
from play_launch.launch_files.records import (
    Composable,
    Description,
    EvaluationFailure,
    Event,
    LaunchedProcess,
    LaunchOrigin,
    Parameter,
    ParameterFile,
    Place,
    Section,
    StartCondition,
    Values,
    decode,
    encode,
    typed_value,
)
from tests.launch_files.values import VALUES, shown


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.text(), VALUES)))
def test_parameters_keep_value_and_type(values: list[tuple[str, ParameterValue]]) -> None:
    made = [records.parameter(name, value) for name, value in values]
    unit = LaunchedProcess(parameters=made, sources=[Values(tuple(made), "/n")])
    back = decode(encode(Description(units=[unit])))
    assert isinstance(back, Description)
    assert len(back.units[0].parameters) == len(values)
    for (name, value), record in zip(values, back.units[0].parameters, strict=True):
        assert record.name == name
        assert shown(typed_value(record)) == shown(value)


def test_everything_comes_back() -> None:
    origin = LaunchOrigin(Place("/a.launch.xml", 3), (Place("/b.launch.xml", 7), Place("/c.py")))
    number = Parameter("gain", ParameterType.DOUBLE, 1.0)
    description = Description(
        units=[
            LaunchedProcess(
                id="p1",
                origin=origin,
                package="p",
                executable="e",
                name="n",
                namespace="/a",
                sources=[ParameterFile("/x.yaml"), ParameterFile(text="{}"), Values((number,))],
                parameters=[number],
                for_others=[Section("/other", (number,))],
                remappings=[("a", "b")],
                environment=[("A", "1")],
                unset=["B"],
                prefix=["nice"],
                respawn=True,
                respawn_delay=2.5,
                is_lifecycle=True,
                autostart=Autostart.ACTIVATE,
                start=[
                    StartCondition(event=Event.EXITED, unit="p0"),
                    StartCondition(event=Event.DELAY, seconds=2.0),
                ],
            ),
            Composable(plugin="p::C", container="/c", extra_arguments=[number]),
        ],
        losses=[records.Loss("/a.launch.xml:4", "something")],
        files=["/a.launch.xml"],
        arguments=[records.Argument("x", choices=("1", "2"))],
    )
    assert decode(encode(description)) == description
    first = description.units[0]
    assert first.full_name == "/a/n"
    assert first.described == "/a.launch.xml:3 /a/n"
    assert LaunchedProcess(namespace="/a").full_name == ""


def test_a_failure_shows_the_chain() -> None:
    failure = EvaluationFailure(
        "no such package", LaunchOrigin(Place("/a.xml", 3), (Place("/b.xml", 7),))
    )
    assert decode(encode(failure)) == failure
    assert str(failure) == "/a.xml:3: no such package\n  included from /b.xml:7"
    assert str(EvaluationFailure("it hangs")) == "it hangs"


@pytest.mark.parametrize(
    "content", [b"", b"{}", b"null", b'{"format": 99, "outcome": {"type": "description"}}', b"\xff"]
)
def test_what_is_no_record_is_refused(content: bytes) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - also those of msgspec
        decode(content)


def test_doubles_stay_doubles() -> None:
    record = Parameter("x", ParameterType.DOUBLE, 1)
    assert isinstance(typed_value(record).value, float)
    assert math.isinf(float(str(typed_value(Parameter("x", ParameterType.DOUBLE, "-.inf")).value)))

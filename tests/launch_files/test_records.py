"""Records of evaluated launch files."""

from __future__ import annotations

import msgspec
from hypothesis import given, settings
from hypothesis import strategies as st

from play_launch.config.model import ParameterConfig, ParameterValue
from play_launch.launch_files.records import (
    Description,
    EvaluationFailure,
    LaunchedProcess,
    LaunchOrigin,
    Place,
    Values,
)
from tests.launch_files.values import VALUES, shown


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.text(), VALUES)))
def test_parameters_keep_value_and_type(values: list[tuple[str, ParameterValue]]) -> None:
    made = [ParameterConfig(*each) for each in values]
    unit = LaunchedProcess(parameters=made, sources=[Values(tuple(made), "/n")])
    written = msgspec.msgpack.encode(Description(units=[unit]))
    description = msgspec.msgpack.decode(written, type=Description | EvaluationFailure)
    assert isinstance(description, Description)
    (back,) = description.units
    assert [(each.name, shown(each.value)) for each in back.parameters] == [
        (name, shown(value)) for name, value in values
    ]


def test_a_failure_shows_the_chain() -> None:
    failure = EvaluationFailure(
        "no such package", LaunchOrigin(Place("/a.xml", 3), (Place("/b.xml", 7),))
    )
    assert str(failure) == "/a.xml:3: no such package\n  included from /b.xml:7"
    assert str(EvaluationFailure("it hangs")) == "it hangs"

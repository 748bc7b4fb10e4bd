"""What a load request says reaches the component as upstream's container hands it on."""

from __future__ import annotations

from typing import Any

import pytest
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters
from std_msgs.msg import String

from tests.support.control_peer import StartContainer, parameter
from tests.support.isolated import ALL_MODES, start
from tests.support.ros import LATCHED, Probe

TYPED: dict[str, tuple[int, str, Any]] = {
    "a_bool": (ParameterType.PARAMETER_BOOL, "bool_value", True),
    "an_integer": (ParameterType.PARAMETER_INTEGER, "integer_value", -(2**53) - 1),
    "a_double": (ParameterType.PARAMETER_DOUBLE, "double_value", 1.0),
    "a_string": (ParameterType.PARAMETER_STRING, "string_value", "12"),
    "bytes": (ParameterType.PARAMETER_BYTE_ARRAY, "byte_array_value", [b"\x00", b"\xff"]),
    "bools": (ParameterType.PARAMETER_BOOL_ARRAY, "bool_array_value", [True, False]),
    "integers": (ParameterType.PARAMETER_INTEGER_ARRAY, "integer_array_value", [1, -2]),
    "doubles": (ParameterType.PARAMETER_DOUBLE_ARRAY, "double_array_value", [0.5, 2.0]),
    "strings": (ParameterType.PARAMETER_STRING_ARRAY, "string_array_value", ["", "yes"]),
}
both = pytest.mark.parametrize("mode", ["standard", "isolated"])


@both
def test_parameters_keep_their_types(
    spawn: StartContainer, components: str, mode: str, probe: Probe
) -> None:
    start(spawn, mode)
    given = [
        Parameter(name=name, value=ParameterValue(type=kind, **{field: value}))
        for name, (kind, field, value) in TYPED.items()
    ]
    loaded = probe.load("Options", package=components, parameters=given)
    assert loaded.success, loaded.error_message
    answer = probe.call(
        GetParameters, "/options/get_parameters", GetParameters.Request(names=list(TYPED))
    )
    for value, (name, (kind, field, expected)) in zip(answer.values, TYPED.items(), strict=True):
        assert value.type == kind, name
        got = getattr(value, field)
        assert (list(got) if isinstance(expected, list) else got) == expected, name


@both
def test_names_remappings_and_extra_arguments(
    spawn: StartContainer, components: str, mode: str, probe: Probe
) -> None:
    start(spawn, mode)
    loaded = probe.load(
        "Options",
        package=components,
        node_name="facts",
        node_namespace="/some/where",
        remap_rules=["options:=renamed"],
        log_level=10,
        extra_arguments=[
            parameter("use_intra_process_comms", value=True),
            parameter("unknown_to_upstream", "and not looked at"),
        ],
    )
    assert (loaded.success, loaded.full_node_name) == (True, "/some/where/facts")
    (facts,) = probe.collect(String, "/some/where/renamed", qos=LATCHED)
    assert facts.data.startswith("intra_process=1 global=0 debug=1 pid=")
    listed = probe.nodes()
    assert listed == [("/some/where/facts", loaded.unique_id)]
    gone = probe.unload(loaded.unique_id)
    assert gone.success, gone.error_message


@both
def test_what_is_not_said_is_off(
    spawn: StartContainer, components: str, mode: str, probe: Probe
) -> None:
    start(spawn, mode)
    loaded = probe.load("Options", package=components)
    # The container's own name is a global argument, and not for the components in it.
    assert (loaded.success, loaded.full_node_name) == (True, "/options")
    (facts,) = probe.collect(String, "/options", qos=LATCHED)
    assert facts.data.startswith("intra_process=0 global=0 debug=0 pid=")


@pytest.mark.parametrize("mode", ALL_MODES)
def test_any_number_of_components_may_ignore_their_options(
    spawn: StartContainer, components: str, mode: str, probe: Probe
) -> None:
    container = start(spawn, mode)
    for name in ("one", "another", "third"):
        loaded = probe.load("WithoutOptions", package=components, node_name=name)
        assert (loaded.success, loaded.full_node_name) == (True, "/container"), loaded.error_message
    listed = probe.nodes()
    assert [name for name, _ in listed] == ["/container"] * 3
    for _, unique_id in listed:
        gone = probe.unload(unique_id)
        assert gone.success, gone.error_message
    assert container.shut_down() == 0, container.log.read_text()


@both
def test_global_arguments_are_forwarded_on_request(
    spawn: StartContainer, components: str, mode: str, probe: Probe
) -> None:
    start(spawn, mode)
    loaded = probe.load(
        "Options",
        package=components,
        node_name="mine",
        extra_arguments=[parameter("forward_global_arguments", value=True)],
    )
    assert (loaded.success, loaded.full_node_name) == (True, "/mine")
    (facts,) = probe.collect(String, "/options", qos=LATCHED)
    assert "global=1" in facts.data


@both
def test_the_type_description_service_is_a_parameter(
    spawn: StartContainer, components: str, mode: str, probe: Probe
) -> None:
    start(spawn, mode)
    for name, on in (("with", True), ("without", False)):
        loaded = probe.load(
            "Talker",
            package=components,
            node_name=name,
            parameters=[parameter("start_type_description_service", value=on)],
        )
        assert loaded.success, loaded.error_message
    services = lambda: dict(probe.node.get_service_names_and_types())  # noqa: E731
    probe.spin_until(
        lambda: {"/with/get_type_description", "/without/get_parameters"} <= services().keys(),
        30.0,
        "the services of both",
    )
    assert "/without/get_type_description" not in services()

"""Configurations that differ in everything that a plan looks at."""

from __future__ import annotations

from pathlib import Path
from types import MappingProxyType

from hypothesis import strategies as st

from play_launch.config.model import (
    ComposableNodeConfig,
    ContainerConfig,
    ContainerType,
    OnCrash,
    OnExit,
    ParameterConfig,
    ParameterType,
    ParameterValue,
    ProcessConfig,
    RecordConfig,
    ReplayConfig,
    RestartLimits,
    StopLimits,
)
from play_launch.config.node_key import NodeKey

VALUES = st.sampled_from(
    [
        ParameterValue(ParameterType.INTEGER, 1),
        ParameterValue(ParameterType.DOUBLE, 1.0),
        ParameterValue(ParameterType.DOUBLE, float("nan")),
        ParameterValue(ParameterType.BOOL, True),
        ParameterValue(ParameterType.BYTE_ARRAY, b"\x00\xff"),
        ParameterValue(ParameterType.STRING_ARRAY, ("a", "b")),
    ]
)
PARAMETERS = st.dictionaries(st.sampled_from(["a", "b.c"]), VALUES, max_size=2).map(
    lambda values: tuple(ParameterConfig(name, value) for name, value in values.items())
)
REMAPPINGS = st.sampled_from([(), (("a", "b"),), (("a", "b"), ("c", "d"))])
RESTARTS = st.builds(RestartLimits, max_restarts=st.integers(0, 2))
ENVIRONMENTS = st.dictionaries(st.sampled_from(["A", "B"]), st.sampled_from(["1", "2"])).map(
    MappingProxyType
)
NODES = st.lists(st.sampled_from(["n1", "n2", ""]), unique=True, max_size=3)


@st.composite
def _component(draw: st.DrawFn, container: str, name: str) -> ComposableNodeConfig:
    plugin = draw(st.sampled_from(["demo::Talker", "demo::Listener"]))
    return ComposableNodeConfig(
        package="demo",
        plugin=plugin,
        name=name,
        namespace="",
        key=NodeKey(container, f"/{name}" if name else "/[demo]"),
        parameters=draw(PARAMETERS),
        remappings=draw(REMAPPINGS),
        log_level=draw(st.sampled_from([None, "debug"])),
        on_crash=draw(st.sampled_from(OnCrash)),
        restart=draw(RESTARTS),
        line=draw(st.integers(1, 99)),
    )


@st.composite
def _container(draw: st.DrawFn, name: str) -> ContainerConfig:
    full_name = f"/{name}"
    return ContainerConfig(
        name=name,
        namespace="/",
        full_name=full_name,
        container_type=draw(st.sampled_from([ContainerType.ISOLATED, ContainerType.STANDARD])),
        loading_timeout=draw(st.sampled_from([1.0, 2.0])),
        environment=draw(ENVIRONMENTS),
        restart=draw(RESTARTS),
        composable_nodes=tuple(draw(_component(full_name, each)) for each in draw(NODES)),
        line=draw(st.integers(1, 99)),
    )


@st.composite
def _process(draw: st.DrawFn, name: str) -> ProcessConfig:
    is_named = draw(st.booleans())
    return ProcessConfig(
        name=name if is_named else "",
        namespace="",
        full_name=f"/{name}" if is_named else f"/[{name}]",
        command=(draw(st.sampled_from(["run", "walk"])),),
        parameters=draw(PARAMETERS),
        environment=draw(ENVIRONMENTS),
        on_exit=draw(st.sampled_from(OnExit)),
        restart=draw(RESTARTS),
        line=draw(st.integers(1, 99)),
    )


@st.composite
def configurations(draw: st.DrawFn) -> ReplayConfig:
    """A system of up to three containers and two processes, in any order."""
    members = draw(st.lists(st.sampled_from(["a", "b", "c"]), unique=True))
    processes = draw(st.lists(st.sampled_from(["p", "q"]), unique=True))
    return ReplayConfig(
        name=draw(st.sampled_from(["one", "two"])),
        source=Path("test.yaml"),
        text=b"",
        stop=StopLimits(ask=draw(st.sampled_from([1.0, 2.0]))),
        record=RecordConfig(sync=draw(st.sampled_from([1.0, float("inf")]))),
        containers=tuple(draw(_container(each)) for each in members),
        nodes=tuple(draw(_process(each)) for each in processes),
    )

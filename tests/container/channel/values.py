"""Hypothesis strategies for what travels on the control channel."""

from __future__ import annotations

from hypothesis import strategies as st

from play_launch.config.model import ParameterConfig, ParameterType, ParameterValue
from play_launch.container.messages import (
    Accepted,
    Cancel,
    Hello,
    Incoming,
    Load,
    NodeStatus,
    NodeStatusState,
    Outgoing,
    Query,
    Rejected,
    Shutdown,
    Status,
    Unload,
)
from play_launch.supervisor.events import ComponentEvent, ComponentEventKind
from tests.support.structs import structs

# CDR ends a string with a zero byte, and surrogates are no text.
TEXT = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=20)
TEXTS = st.lists(TEXT, max_size=4).map(tuple)
U8 = st.integers(0, 2**8 - 1)
U16 = st.integers(0, 2**16 - 1)
U32 = st.integers(0, 2**32 - 1)
U64 = st.integers(0, 2**64 - 1)
I32 = st.integers(-(2**31), 2**31 - 1)
I64 = st.integers(-(2**63), 2**63 - 1)
DOUBLE = st.floats(allow_nan=False)

_SCALARS = {
    ParameterType.BOOL: st.booleans(),
    ParameterType.INTEGER: I64,
    ParameterType.DOUBLE: DOUBLE,
    ParameterType.STRING: TEXT,
}
_ARRAYS = {
    ParameterType.BOOL_ARRAY: st.booleans(),
    ParameterType.INTEGER_ARRAY: I64,
    ParameterType.DOUBLE_ARRAY: DOUBLE,
    ParameterType.STRING_ARRAY: TEXT,
}


def values(
    *, min_size: int = 0, byte_arrays: bool = True, double: st.SearchStrategy[float] = DOUBLE
) -> st.SearchStrategy[ParameterValue]:
    scalars = {**_SCALARS, ParameterType.DOUBLE: double}
    arrays = {**_ARRAYS, ParameterType.DOUBLE_ARRAY: double}
    kinds = [st.builds(ParameterValue, st.just(kind), value) for kind, value in scalars.items()]
    kinds += [
        st.builds(
            ParameterValue, st.just(kind), st.lists(item, min_size=min_size, max_size=4).map(tuple)
        )
        for kind, item in arrays.items()
    ]
    if byte_arrays:
        binary = st.binary(max_size=8)
        kinds.append(st.builds(ParameterValue, st.just(ParameterType.BYTE_ARRAY), binary))
    return st.one_of(kinds)


# What a parameter file can hold.
FILE_VALUES = values(
    min_size=1, byte_arrays=False, double=st.floats(allow_nan=False, allow_subnormal=False)
)
PARAMETERS = st.lists(st.builds(ParameterConfig, TEXT, values()), max_size=4).map(tuple)

NODE_STATUS = structs(
    NodeStatus,
    unique_id=U64,
    attempt=U64,
    state=st.sampled_from(NodeStatusState),
    full_node_name=TEXT,
    pid=I32,
    start_time=U64,
    elapsed_ns=I64,
    cpu_time_ns=I64,
    silence_ns=I64,
    note=TEXT,
)
HELLOS = st.builds(
    Hello,
    version=TEXT,
    protocol_version=U16,
    pid=I32,
    start_time=U64,
    full_node_name=TEXT,
    mode=TEXT,
    thread_num=U32,
    backends=TEXTS,
    rmw_implementation=TEXT,
    domain_id=U32,
    mechanism=TEXT,
    notes=TEXTS,
)
INCOMING: st.SearchStrategy[Incoming] = st.one_of(
    HELLOS,
    st.builds(Accepted, attempt=U64, unique_id=U64),
    st.builds(Rejected, attempt=U64, unique_id=U64, reason=TEXT),
    st.builds(
        Status,
        query_id=U64,
        nodes=st.lists(NODE_STATUS, max_size=3).map(tuple),
        dropped_frames=U64,
        crashes=U32,
        undertaken=U32,
        leaked=U32,
        unquiesced=U32,
        dead_locks=TEXTS,
    ),
    st.builds(
        ComponentEvent,
        stamp_ns=st.integers(0, 2**31 * 10**9 - 1),
        kind=st.sampled_from(ComponentEventKind),
        container=st.just("/container"),
        unique_id=U64,
        attempt=U64,
        full_node_name=TEXT,
        package_name=TEXT,
        plugin_name=TEXT,
        error_message=TEXT,
        pid=I32,
        start_time=U64,
        exit_code=I32,
        signal=I32,
        backtrace=TEXTS,
        confirmed_by=TEXT,
    ),
)
OUTGOING: st.SearchStrategy[Outgoing] = st.one_of(
    HELLOS,
    structs(
        Load,
        attempt=U64,
        package_name=TEXT,
        plugin_name=TEXT,
        node_name=TEXT,
        node_namespace=TEXT,
        log_level=U8,
        remap_rules=TEXTS,
        parameters=PARAMETERS,
        extra_arguments=PARAMETERS,
        resources=TEXTS,
        lock_memory=st.booleans(),
    ),
    st.builds(Query, query_id=U64, unique_ids=st.lists(U64, max_size=4).map(tuple)),
    st.builds(Cancel, unique_id=U64),
    st.builds(Unload, unique_id=U64),
    st.builds(Shutdown, reason=TEXT),
)

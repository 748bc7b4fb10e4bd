"""Hypothesis strategies for values of parameters."""

from __future__ import annotations

from hypothesis import strategies as st

from play_launch.config.model import ParameterType, ParameterValue

# CDR ends a string with a zero byte, and surrogates are no text.
TEXT = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=20)
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

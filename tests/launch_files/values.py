"""Values of parameters for property tests."""

from __future__ import annotations

from hypothesis import strategies as st

from play_launch.config.model import ParameterType, ParameterValue

INTEGERS = st.integers(-(2**63), 2**63 - 1)
TEXTS = st.text(st.characters(exclude_characters="\x00", exclude_categories=["Cs"]), max_size=12)


def _arrays(kind: ParameterType, items: st.SearchStrategy[object]) -> st.SearchStrategy[object]:
    return st.builds(ParameterValue, st.just(kind), st.lists(items, max_size=4).map(tuple))


VALUES = st.one_of(
    st.builds(ParameterValue, st.just(ParameterType.BOOL), st.booleans()),
    st.builds(ParameterValue, st.just(ParameterType.INTEGER), INTEGERS),
    st.builds(ParameterValue, st.just(ParameterType.DOUBLE), st.floats()),
    st.builds(ParameterValue, st.just(ParameterType.STRING), TEXTS),
    st.builds(ParameterValue, st.just(ParameterType.BYTE_ARRAY), st.binary(max_size=9)),
    _arrays(ParameterType.DOUBLE_ARRAY, st.floats()),
    _arrays(ParameterType.STRING_ARRAY, TEXTS),
    _arrays(ParameterType.INTEGER_ARRAY, INTEGERS),
    _arrays(ParameterType.BOOL_ARRAY, st.booleans()),
)


def shown(value: object) -> str:
    """Return what tells values apart, NaN and -0.0 included."""
    assert isinstance(value, ParameterValue)
    return repr((value.type, value.value))

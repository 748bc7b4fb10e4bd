"""Whatever bytes come, they are requests or a ControlError, and lines survive any splitting."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.control.protocol import (
    LONGEST_REQUEST,
    Code,
    ControlError,
    LineSplitter,
    Request,
    decode,
    encode,
    flag_argument,
    names_argument,
    request_line,
    request_of,
    seconds_argument,
)

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)
OBJECTS = st.dictionaries(st.text(max_size=8), JSON, max_size=4)
FINITE = st.dictionaries(st.text(max_size=8), st.text() | st.integers(), max_size=4)
NUMBERS = st.integers(0, 2**53)


def refusal(work: Callable[[], object]) -> str:
    """Give the code of the error that it raises, which can be sent; empty when it raises none."""
    try:
        work()
    except ControlError as error:
        return ControlError.of(decode(encode(error.as_object()))).code
    return ""


def cut(data: bytes, places: list[int]) -> list[bytes]:
    ends = sorted({place % (len(data) + 1) for place in places} | {0, len(data)})
    return [data[start:end] for start, end in pairwise(ends)]


@given(st.lists(OBJECTS, max_size=6), st.lists(st.integers(0), max_size=8))
def test_lines_survive_any_splitting(objects: list[dict[str, Any]], places: list[int]) -> None:
    try:
        data = b"".join(encode(each) for each in objects)
    except ValueError:  # an infinity
        return
    splitter = LineSplitter(10**6)
    lines = [line for piece in cut(data, places) for line in splitter.feed(piece)]
    assert [decode(line) for line in lines] == objects


@given(st.integers(1, 50), st.lists(st.binary(max_size=60), max_size=10))
def test_no_line_and_no_rest_is_longer_than_allowed(longest: int, pieces: list[bytes]) -> None:
    splitter = LineSplitter(longest)
    lines = b"".join(pieces).split(b"\n")
    if any(len(line) > longest for line in lines):
        code = refusal(lambda: [line for piece in pieces for line in splitter.feed(piece)])
        assert code == Code.TOO_LONG
    else:
        found = [line for piece in pieces for line in splitter.feed(piece)]
        assert found == [line.strip() for line in lines[:-1] if line.strip()]


@given(st.binary() | JSON.map(lambda value: json.dumps(value).encode()) | FINITE.map(encode))
def test_anything_is_a_request_or_refused(line: bytes) -> None:
    assert refusal(lambda: request_of(line)) in {"", Code.MALFORMED, Code.PROTOCOL}


@given(NUMBERS, st.text(max_size=20), OBJECTS, st.lists(st.text(), max_size=3).map(tuple))
def test_a_request_is_read_as_it_was_written(
    number: int, operation: str, arguments: dict[str, Any], command: tuple[str, ...]
) -> None:
    try:
        line = request_line(Request(number, operation, arguments, command))
    except ValueError:
        return
    assert request_of(line.rstrip(b"\n")) == (number, operation, arguments, command)


@pytest.mark.parametrize(
    "line",
    [
        b"{}",
        b'{"id": -1, "op": "ps"}',
        b'{"id": true, "op": "ps"}',
        b'{"id": 1.0, "op": "ps"}',
        b'{"id": 1}',
        b'{"id": 1, "op": 7}',
        b'{"id": 1, "op": "ps", "arguments": []}',
        b'{"id": 1, "op": "ps", "command": "play-launch ps"}',
        b'{"id": 1, "op": "ps", "arguments": {"a": NaN}}',
        b"[" * 30_000,
        b'{"id": ' + b"9" * 10_000 + b', "op": "ps"}',
        b"GET / HTTP/1.1",
        b"\xff\xfe",
    ],
)
def test_what_is_no_request_is_malformed(line: bytes) -> None:
    with pytest.raises(ControlError) as refused:
        request_of(line)
    assert refused.value.code == Code.MALFORMED


def test_another_version_is_refused() -> None:
    with pytest.raises(ControlError) as refused:
        request_of(b'{"id": 1, "op": "ps", "protocol": 2}')
    assert refused.value.code == Code.PROTOCOL
    assert request_of(b'{"id": 1, "op": "ps", "protocol": 1}').operation == "ps"


def test_a_request_that_is_too_long_is_not_written() -> None:
    with pytest.raises(ControlError) as refused:
        request_line(Request(1, "ps", {"names": ["x" * LONGEST_REQUEST]}))
    assert refused.value.code == Code.TOO_LONG


@given(JSON)
def test_arguments_are_what_they_should_be_or_refused(value: Any) -> None:
    arguments = {"it": value}
    for read in (
        lambda: names_argument(arguments, "it"),
        lambda: seconds_argument(arguments, "it", 1.0),
        lambda: flag_argument(arguments, "it"),
    ):
        assert refusal(read) in {"", Code.BAD_ARGUMENTS}


@given(JSON)
def test_an_error_is_read_whatever_it_holds(found: Any) -> None:
    assert isinstance(ControlError.of(found), ControlError)

"""Any bytes are a request or a OperationError; the tables of the documentation are up to date."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import Struct

from play_launch.control.messages import (
    ActionRequest,
    ChangeRequest,
    EventsRequest,
    Selected,
    SignalRequest,
    WaitRequest,
    read_arguments,
    read_request,
)
from play_launch.control.protocol import PROTOCOL, Code, OperationError, decode, encode
from tests.support.doc_tables import DOCUMENTS, with_tables

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)
ARGUMENTS = [Selected, ActionRequest, SignalRequest, WaitRequest, EventsRequest, ChangeRequest]


def refusal(work: Callable[[], object]) -> str:
    """Return the code of the error that it raises, which can be sent; empty for none."""
    try:
        work()
    except OperationError as error:
        return OperationError.of(decode(encode({**error.as_object()}))).code
    return ""


@given(st.binary() | JSON.map(lambda value: json.dumps(value).encode()))
def test_anything_is_a_request_or_refused(line: bytes) -> None:
    assert refusal(lambda: read_request(line)) in {"", Code.MALFORMED, Code.PROTOCOL}


@pytest.mark.parametrize(
    "line",
    [
        b"{}",
        b'{"id": -1, "op": "ps"}',
        b'{"id": true, "op": "ps"}',
        b'{"id": 1}',
        b'{"id": 1, "op": 7}',
        b'{"id": 1, "op": "ps", "command": "play-launch ps"}',
        b'{"id": 1, "op": "ps", "arguments": {"a": NaN}}',
        b"[" * 30_000,
        b'{"id": ' + b"9" * 10_000 + b', "op": "ps"}',
        b"GET / HTTP/1.1",
        b"\xff\xfe",
    ],
)
def test_anything_else_is_malformed(line: bytes) -> None:
    assert refusal(lambda: read_request(line)) == Code.MALFORMED


@pytest.mark.parametrize("version", [PROTOCOL - 1, PROTOCOL + 1])
def test_another_version_is_refused(version: int) -> None:
    line = b'{"id": 1, "op": "ps", "protocol": %d}' % version
    with pytest.raises(OperationError, match="use the command of the session's version") as refused:
        read_request(line)
    assert refused.value.code == Code.PROTOCOL


@pytest.mark.parametrize("kind", ARGUMENTS)
@given(values=st.dictionaries(st.sampled_from(["names", "timeout", "for", "kinds"]), JSON))
def test_arguments_are_read_or_refused(kind: type[Struct], values: dict[str, Any]) -> None:
    line = json.dumps(values).encode()
    assert refusal(lambda: read_arguments(line, kind)) in {"", Code.BAD_ARGUMENTS}


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"names": []}, "names: expected `array` of length >= 1"),
        ({"names": ["x" * 1001]}, "names[0]: expected `str` of length <= 1000"),
        ({"names": ["x"] * 2001}, "names: expected `array` of length <= 2000"),
        ({"names": ["x"], "timeout": 0}, "timeout: expected `float` > 0.0"),
    ],
)
def test_a_refusal_names_the_argument_and_its_limit(arguments: dict[str, Any], text: str) -> None:
    with pytest.raises(OperationError) as refused:
        read_arguments(json.dumps(arguments).encode(), ActionRequest)
    assert str(refused.value) == text


@given(JSON)
def test_an_error_is_read_whatever_it_holds(found: Any) -> None:
    assert isinstance(OperationError.of(found), OperationError)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_the_tables_of_the_documentation_are_those_of_the_messages(document: Any) -> None:
    text = document.read_text(encoding="utf-8")
    assert with_tables(text) == text, "run python -m tests.support.doc_tables"

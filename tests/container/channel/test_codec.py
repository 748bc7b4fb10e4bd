"""Messages to frames and back, and the framing."""

from __future__ import annotations

import itertools
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.config.model import ParameterConfig, ParameterType, ParameterValue
from play_launch.container.codec import (
    MAX_FRAME_LENGTH,
    ControlError,
    EncodeError,
    Frame,
    FrameDecoder,
    FrameKind,
    decode_message,
    encode_frame,
    encode_message,
)
from play_launch.container.messages import Cancel, Load, Outgoing, Query


def test_an_unknown_kind_of_event_is_an_error() -> None:
    from play_launch_msgs.msg import ComponentEvent
    from rclpy.serialization import serialize_message

    payload = bytes(serialize_message(ComponentEvent(event_type=200)))
    with pytest.raises(ControlError, match="EVENT"):
        decode_message(Frame(FrameKind.EVENT, 1, payload))


@pytest.mark.parametrize(
    "message",
    [
        Cancel(unique_id=-1),
        Cancel(unique_id=2**64),
        Query(query_id=1, unique_ids=(-1,)),
        Load(attempt=1, package_name="p", plugin_name="c", log_level=256),
        Load(
            attempt=1,
            package_name="p",
            plugin_name="c",
            parameters=(ParameterConfig("p", ParameterValue(ParameterType.INTEGER, 2**63)),),
        ),
        Load(attempt=1, package_name="p" * 2**24, plugin_name="c"),
    ],
)
def test_what_does_not_fit_is_an_error_of_ours(message: Outgoing) -> None:
    with pytest.raises(EncodeError, match=type(message).__name__) as caught:
        encode_message(message)
    assert caught.value.message is message


@pytest.mark.parametrize("text", ["a\0b", "\udc80"])
def test_text_that_ros_cannot_hold_is_refused_and_not_changed(text: str) -> None:
    value = ParameterValue(ParameterType.STRING_ARRAY, (text,))
    message = Load(
        attempt=1,
        package_name="p",
        plugin_name="c",
        parameters=(ParameterConfig("p", value),),
    )
    with pytest.raises(EncodeError, match="Load"):
        encode_message(message)


U16 = st.integers(0, 2**16 - 1)
FRAMES = st.lists(st.builds(Frame, U16, U16, st.binary(max_size=40)), max_size=8)
BAD_LENGTH = st.one_of(st.integers(0, 3), st.integers(MAX_FRAME_LENGTH + 1, 2**32 - 1))


def encoded(frames: list[Frame]) -> bytes:
    return b"".join(encode_frame(f.kind, f.payload, version=f.version) for f in frames)


def pieces(data: bytes, cuts: list[int]) -> list[bytes]:
    places = sorted({0, len(data), *(cut % (len(data) + 1) for cut in cuts)})
    return [data[start:end] for start, end in itertools.pairwise(places)]


@given(FRAMES, st.lists(st.integers(0, 10_000), max_size=20))
def test_frames_survive_any_cutting(frames: list[Frame], cuts: list[int]) -> None:
    decoder = FrameDecoder()
    got = [frame for piece in pieces(encoded(frames), cuts) for frame in decoder.feed(piece)]
    assert got == frames
    assert decoder.pending == 0


@given(FRAMES, BAD_LENGTH, st.lists(st.integers(0, 10_000), max_size=5), st.binary(max_size=9))
def test_a_bad_length_ends_the_stream_after_the_good_frames(
    frames: list[Frame], length: int, cuts: list[int], rest: bytes
) -> None:
    decoder = FrameDecoder()
    got: list[Frame] = []
    data = encoded(frames) + struct.pack("<I", length) + rest
    for piece in pieces(data, cuts):
        got += decoder.feed(piece)
    assert got == frames
    assert str(length) in decoder.error
    assert decoder.feed(encoded(frames)) == []


def test_the_largest_frame_passes_and_a_larger_one_does_not() -> None:
    payload = bytes(MAX_FRAME_LENGTH - 4)
    decoder = FrameDecoder()
    assert decoder.feed(encode_frame(2, payload)) == [Frame(2, 1, payload)]
    with pytest.raises(ValueError, match="a frame of"):
        encode_frame(2, payload + b"x")

"""The framing of the control channel."""

from __future__ import annotations

import itertools
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.container.codec import (
    MAX_FRAME_LENGTH,
    Frame,
    FrameDecoder,
    FrameError,
    encode_frame,
)

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


@given(FRAMES)
def test_each_frame_is_given_as_soon_as_it_is_whole(frames: list[Frame]) -> None:
    decoder = FrameDecoder()
    for frame in frames:
        data = encoded([frame])
        for byte in data[:-1]:
            assert decoder.feed(bytes((byte,))) == []
        assert decoder.feed(data[-1:]) == [frame]
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
    assert str(length) in str(decoder.error)
    assert decoder.feed(encoded(frames)) == []


def test_the_layout_is_the_one_agreed_on() -> None:
    assert encode_frame(10, b"\x07") == bytes.fromhex("05000000 0a00 0100 07")


def test_the_largest_frame_passes_and_a_larger_one_does_not() -> None:
    payload = bytes(MAX_FRAME_LENGTH - 4)
    decoder = FrameDecoder()
    assert decoder.feed(encode_frame(2, payload)) == [Frame(2, 1, payload)]
    with pytest.raises(FrameError):
        encode_frame(2, payload + b"x")

"""Packets: what was sent is what is read, and nonsense is refused."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.recording.topic_recorder import link
from play_launch.recording.topic_recorder.link import Kind


@given(st.binary(max_size=100))
def test_nonsense_is_refused(data: bytes) -> None:
    try:
        link.decode(data)
    except link.PacketError:
        return
    assert struct.unpack_from("<I", data)[0] in {1, 2, 3, 4, 5}


def test_what_goes_the_other_way_is_refused() -> None:
    for packet in (link.answer(1, 2), link.packet(Kind.DONE, 1), link.packet(Kind.STOP)):
        with pytest.raises(link.PacketError):
            link.decode(packet)

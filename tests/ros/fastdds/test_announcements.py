"""Announcements are passed on, to their domain, when the participants can hear the answers."""

from __future__ import annotations

import contextlib
import socket
import struct

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from play_launch.ros.fastdds.announcements import Announcements, domain_of

PATIENCE = 60.0
KIND_UDP = 1


def announcement(port: int, *, order: str = "<", before: bytes = b"", note: bytes = b"") -> bytes:
    """One as Fast DDS sends it: a header, perhaps a time, and data with a list of parameters."""
    locator = struct.pack(f"{order}iI", KIND_UDP, port) + bytes(12) + bytes([127, 0, 0, 1])
    parameters = struct.pack(f"{order}HH", 0x32, len(locator)) + locator
    if note:
        parameters = struct.pack(f"{order}HH", 0x2C, len(note)) + note + parameters
    parameters += struct.pack(f"{order}HH", 1, 0)
    little = order == "<"
    payload = bytes([0, 3 if little else 2, 0, 0]) + parameters
    body = struct.pack(f"{order}HH", 0, 16) + bytes(16) + payload
    return (
        b"RTPS" + bytes(16) + before + bytes([0x15, 4 | little])
        + struct.pack(f"{order}H", len(body)) + body
    )  # fmt: skip


TIME = bytes([0x09, 1, 8, 0]) + bytes(8)


@given(
    st.integers(0, 232),
    st.integers(0, 119),
    st.sampled_from("<>"),
    st.sampled_from([b"", TIME]),
    st.integers(0, 64).map(lambda words: bytes(4 * words)),
)
def test_the_port_gives_the_domain(
    domain: int, number: int, order: str, before: bytes, note: bytes
) -> None:
    port = 7400 + 250 * domain + 10 + 2 * number
    assume(port < 65536)
    assert domain_of(announcement(port, order=order, before=before, note=note)) == domain


@given(st.binary(max_size=300) | st.binary(max_size=200).map(lambda rest: b"RTPS" + rest))
def test_whatever_comes_is_read_to_its_end(message: bytes) -> None:
    found = domain_of(message)
    assert found is None or 0 <= found <= 232


@given(st.data())
def test_damaged_ones_do_no_harm(data: st.DataObject) -> None:
    message = bytearray(announcement(7410, before=TIME))
    for _ in range(data.draw(st.integers(1, 4))):
        message[data.draw(st.integers(0, len(message) - 1))] = data.draw(st.integers(0, 255))
    domain_of(bytes(message[: data.draw(st.integers(0, len(message)))]))


@pytest.mark.parametrize("port", [0, 7399, 7400, 7409, 65536, 1 << 31])
def test_a_port_of_no_participant_gives_none(port: int) -> None:
    assert domain_of(announcement(port)) is None


def test_they_wait_while_a_participant_is_made(ros_domain: int) -> None:
    first = 7400 + 250 * ros_domain + 10
    announcements = Announcements(on_loopback=True)
    with contextlib.ExitStack() as sockets:
        ears = []
        # Behind those whom rmw_fastrtps reaches, too.
        for number in (90, 110):
            ear = sockets.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            ear.bind(("127.0.0.1", first + 2 * number))
            ear.setblocking(False)
            ears.append(ear)
        mouth = sockets.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        words = [announcement(first, note=bytes([number] * 4)) for number in range(3)]
        with announcements.held():
            for each in words[:2]:
                mouth.sendto(each, ("127.0.0.1", announcements.port))
            for ear in ears:
                with pytest.raises(BlockingIOError):
                    ear.recv(65536)
        for other in (b"RTPS and nothing else", announcement(1 << 20), announcement(65410)):
            mouth.sendto(other, ("127.0.0.1", announcements.port))
        mouth.sendto(words[2], ("127.0.0.1", announcements.port))
        for ear in ears:
            ear.settimeout(PATIENCE)
            assert [ear.recv(65536) for _ in words] == words

"""The kernel's list of addresses, and when it counts as changed."""

from __future__ import annotations

import asyncio
import socket
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.graph_daemon.server import interfaces
from play_launch.graph_daemon.server.interfaces import (
    InterfaceAddress,
    InterfaceWatch,
    NetlinkError,
    addresses,
    parse_addresses,
)


def message(kind: int, body: bytes) -> bytes:
    length = 16 + len(body)
    return struct.pack("=IHHII", length, kind, 0, 1, 0) + body + b"\0" * (-length % 4)


def attribute(kind: int, value: bytes) -> bytes:
    length = 4 + len(value)
    return struct.pack("=HH", length, kind) + value + b"\0" * (-length % 4)


def address(index: int, *attributes: bytes, scope: int = 0) -> bytes:
    body = struct.pack("=BBBBI", socket.AF_INET, 24, 0, scope, index) + b"".join(attributes)
    return message(20, body)


def test_addresses_are_read() -> None:
    data = (
        address(1, attribute(3, b"lo\0"), attribute(1, b"\x7f\0\0\1"))
        # On a point-to-point link the own one counts.
        + address(2, attribute(1, b"\x0a\0\0\2"), attribute(2, b"\x0a\0\0\1"))
        + address(3, attribute(1, b"\xa9\xfe\0\1"), scope=253)
        + message(16, b"a link, not an address")
    )
    expected = {
        InterfaceAddress(1, socket.AF_INET, b"\x7f\0\0\1"),
        InterfaceAddress(2, socket.AF_INET, b"\x0a\0\0\1"),
    }
    assert parse_addresses(data) == (expected, False)
    assert parse_addresses(data + message(3, b"\0\0\0\0")) == (expected, True)


@given(st.binary(max_size=200) | st.binary(max_size=60).map(lambda body: message(20, body)))
def test_whatever_comes_is_read_or_an_error(data: bytes) -> None:
    try:
        found, _ = parse_addresses(data)
    except NetlinkError:
        return
    assert all(isinstance(entry, InterfaceAddress) for entry in found)


def test_loopback_is_among_the_addresses_of_this_machine() -> None:
    assert socket.inet_aton("127.0.0.1") in {found.address for found in addresses()}


def test_only_another_set_of_addresses_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    one = InterfaceAddress(1, socket.AF_INET, b"\x7f\0\0\1")
    two = InterfaceAddress(2, socket.AF_INET, b"\x0a\0\0\1")
    answers: list[object] = [{one}, {one}, OSError("busy"), {one, two}, {one, two}]

    def listed() -> frozenset[InterfaceAddress]:
        answer = answers.pop(0)
        if isinstance(answer, OSError):
            raise answer
        return frozenset(answer)  # type: ignore[call-overload, no-any-return]

    monkeypatch.setattr(interfaces, "addresses", listed)
    monkeypatch.setattr(interfaces, "SETTLING", 0.01)

    async def scenario() -> None:
        told: list[int] = []
        changed = asyncio.Event()

        def on_change() -> None:
            told.append(len(answers))
            changed.set()

        watch = InterfaceWatch(on_change)
        # The first look finds nothing new, the second fails and is repeated.
        for _ in range(2):
            watch._on_message()
            watch._on_message()
            await asyncio.sleep(0.05)
        await asyncio.wait_for(changed.wait(), 60)
        watch._on_message()
        while answers:
            await asyncio.sleep(0.01)
        watch.close()
        assert told == [1]

    asyncio.run(asyncio.wait_for(scenario(), 60))

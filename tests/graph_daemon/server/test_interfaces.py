"""The kernel's list of addresses, and when it counts as changed."""

from __future__ import annotations

import asyncio
import socket
from types import SimpleNamespace

import psutil
import pytest

from play_launch.graph_daemon.server import interfaces
from play_launch.graph_daemon.server.interfaces import (
    InterfaceAddress,
    InterfaceWatch,
    addresses,
)


def listed(family: int, address: str) -> SimpleNamespace:
    return SimpleNamespace(family=family, address=address)


def test_only_addresses_that_reach_further_than_a_link_count(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = {
        "lo": [listed(socket.AF_INET, "127.0.0.1"), listed(socket.AF_INET6, "::1")],
        "eth0": [
            listed(socket.AF_INET, "10.0.0.2"),
            listed(socket.AF_INET6, "2001:db8::2"),
            listed(socket.AF_INET6, "fe80::1%eth0"),
            listed(socket.AF_PACKET, "00:00:00:00:00:01"),
        ],
        "veth1": [listed(socket.AF_INET, "169.254.7.1"), listed(socket.AF_INET6, "fe80::2%veth1")],
    }
    monkeypatch.setattr(psutil, "net_if_addrs", lambda: found)
    assert addresses() == {
        InterfaceAddress("lo", "127.0.0.1"),
        InterfaceAddress("lo", "::1"),
        InterfaceAddress("eth0", "10.0.0.2"),
        InterfaceAddress("eth0", "2001:db8::2"),
    }


def test_loopback_is_among_the_addresses_of_this_machine() -> None:
    assert "127.0.0.1" in {found.address for found in addresses()}


def test_only_another_set_of_addresses_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    one = InterfaceAddress("lo", "127.0.0.1")
    two = InterfaceAddress("eth0", "10.0.0.1")
    answers: list[object] = [{one}, {one}, OSError("busy"), {one, two}, {one, two}]

    def answer_next() -> frozenset[InterfaceAddress]:
        answer = answers.pop(0)
        if isinstance(answer, OSError):
            raise answer
        return frozenset(answer)  # type: ignore[call-overload, no-any-return]

    monkeypatch.setattr(interfaces, "addresses", answer_next)
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

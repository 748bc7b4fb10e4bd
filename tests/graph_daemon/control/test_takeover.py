"""What a start does about who has the port; real sockets, no ROS."""

from __future__ import annotations

import signal
import socket

import pytest

from play_launch.graph_daemon.contract import DaemonAddress
from play_launch.graph_daemon.control import takeover
from play_launch.graph_daemon.control.background import START_LIMIT
from play_launch.graph_daemon.control.port import (
    PortBusyError,
    end_time_wait,
    listen,
    listen_within,
)
from play_launch.graph_daemon.control.sockets import Holder, time_wait_ports
from play_launch.graph_daemon.control.takeover import (
    Action,
    Kind,
    Occupant,
    PortHeldError,
    decide,
    end,
    look,
)
from tests.graph_daemon.addresses import is_free
from tests.graph_daemon.control.occupants import occupied

HOLDER = Holder(7, ("python3", "-c", "ros2cli.daemon"))
SETTINGS = {"settings": {"ROS_DOMAIN_ID": "3", "RMW_IMPLEMENTATION": "rmw_a"}}


@pytest.fixture(autouse=True)
def _a_free_port(monkeypatch: pytest.MonkeyPatch, address: DaemonAddress) -> None:
    # A daemon that does not answer is hung, however young it is.
    monkeypatch.setattr(takeover, "START_LIMIT", 0.0)
    listen_within(address, 60.0).close()


@pytest.mark.parametrize(
    ("occupant", "restart", "action"),
    [
        (Occupant(Kind.NOBODY), False, Action.START),
        (Occupant(Kind.NOBODY), True, Action.START),
        (Occupant(Kind.OURS, HOLDER, SETTINGS), False, Action.KEEP),
        (Occupant(Kind.OURS, HOLDER, SETTINGS), True, Action.ASK_TO_END),
        (Occupant(Kind.STOCK, HOLDER), False, Action.ASK_TO_END),
        (Occupant(Kind.STOCK, None), True, Action.ASK_TO_END),
        (Occupant(Kind.HUNG, HOLDER), False, Action.KILL),
        (Occupant(Kind.HUNG, Holder(0, ())), False, Action.REFUSE),
        (Occupant(Kind.HUNG, None), True, Action.REFUSE),
        (Occupant(Kind.FOREIGN, HOLDER), False, Action.REFUSE),
        (Occupant(Kind.FOREIGN, None), True, Action.REFUSE),
    ],
)
def test_the_decision(occupant: Occupant, restart: bool, action: Action) -> None:
    decision = decide(occupant, {"ROS_DOMAIN_ID": "3"}, restart=restart)
    assert decision.action is action
    if action in {Action.REFUSE, Action.KILL}:
        assert decision.messages


def test_other_settings_of_a_running_daemon_are_reported() -> None:
    occupant = Occupant(Kind.OURS, HOLDER, SETTINGS)
    caller = {"ROS_DOMAIN_ID": "3", "RMW_IMPLEMENTATION": "rmw_b"}
    assert decide(occupant, caller).messages == (
        "RMW_IMPLEMENTATION: the daemon has rmw_a, here it is rmw_b",
    )
    (unknown,) = decide(Occupant(Kind.OURS, HOLDER), caller).messages
    assert "its process belongs to another user" in unknown


def test_nobody_is_there(address: DaemonAddress) -> None:
    assert look(address).kind is Kind.NOBODY
    end(address, look(address))


def test_a_stock_daemon_is_known_and_asked_to_end(address: DaemonAddress) -> None:
    with occupied("stock", address.port) as process:
        occupant = look(address)
        assert occupant.kind is Kind.STOCK
        assert occupant.holder is not None
        assert occupant.holder.pid == process.pid
        end(address, occupant)
        assert process.wait(60) == 0
        # Also what it closed first does not keep the port.
        assert is_free(address)


def test_a_daemon_that_does_not_end_is_named(address: DaemonAddress) -> None:
    with (
        occupied("stubborn", address.port) as process,
        pytest.raises(PortHeldError, match=f"did not become free .*{process.pid}"),
    ):
        end(address, look(address), limit=0.5)


def test_a_hung_daemon_is_known_by_its_command_and_killed(address: DaemonAddress) -> None:
    with occupied("silent", address.port, "--name", "ros2-daemon") as process:
        occupant = look(address, 0.3)
        assert occupant.kind is Kind.HUNG
        assert decide(occupant, {}).action is Action.KILL
        end(address, occupant)
        assert process.wait(60) == -signal.SIGTERM
        assert is_free(address)


def test_a_stopped_daemon_is_named_without_waiting_for_it(
    address: DaemonAddress, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(takeover, "START_LIMIT", START_LIMIT)
    with occupied("stock", address.port, "--name", "ros2-daemon") as process:
        process.send_signal(signal.SIGSTOP)
        occupant = look(address)
        assert occupant.kind is Kind.HUNG
        assert "SIGSTOP" in occupant.problem
        assert decide(occupant, {}).action is Action.KILL
        end(address, occupant)
        assert process.wait(60) == -signal.SIGKILL


@pytest.mark.parametrize("kind", ["silent", "other"])
def test_anything_else_is_left_alone_and_named(address: DaemonAddress, kind: str) -> None:
    with occupied(kind, address.port) as process:
        occupant = look(address, 1.0)
        assert occupant.kind is Kind.FOREIGN
        decision = decide(occupant, {}, restart=True)
        assert decision.action is Action.REFUSE
        assert f"process {process.pid}" in decision.messages[0]
        with pytest.raises(PortHeldError):
            end(address, occupant)
        assert process.poll() is None


def test_a_port_is_taken_once(address: DaemonAddress) -> None:
    with listen(address), pytest.raises(PortBusyError):
        listen(address)
    assert is_free(address)


def leave_time_wait(address: DaemonAddress, count: int) -> None:
    """Close connections from the side of the port, as ros2cli's daemon does."""
    with listen(address) as listener:
        for _ in range(count):
            with socket.create_connection((address.host, address.port)) as client:
                accepted, _ = listener.accept()
                accepted.shutdown(socket.SHUT_WR)
                assert client.recv(1) == b""
            assert accepted.recv(1) == b""
            accepted.close()


def test_what_closed_connections_leave_is_ended(address: DaemonAddress) -> None:
    leave_time_wait(address, 20)
    assert len(time_wait_ports(address.port)) == 20
    assert not is_free(address)
    listen_within(address, 10.0).close()
    assert time_wait_ports(address.port) == []


def test_ending_them_disturbs_no_living_connection(address: DaemonAddress) -> None:
    leave_time_wait(address, 3)
    end_time_wait(address)
    with listen(address) as listener:
        with socket.create_connection((address.host, address.port)) as client:
            accepted, _ = listener.accept()
            end_time_wait(address)
            client.sendall(b"x")
            assert accepted.recv(1) == b"x"
            # Here the client closes first.
        assert accepted.recv(1) == b""
        accepted.close()
    assert is_free(address)

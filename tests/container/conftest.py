"""Starts the real container; the tests are its supervisor."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
from contextlib import ExitStack
from typing import TYPE_CHECKING

import pytest
from play_launch_msgs.msg import ControlHello

from play_launch.container.environment import child_environment
from play_launch.container.ros import component_container, ros_installation
from play_launch.ros.fastdds.shared_memory import sweep
from tests.support.control_peer import Container, StartContainer

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

OTHER_CONTAINER = "PLAY_LAUNCH_CONTAINER"
"""Environment variable: another container than the installed one, which then gets the environment
as it is."""


def _command_and_environment() -> tuple[str, dict[str, str]]:
    if OTHER_CONTAINER in os.environ:
        return os.environ[OTHER_CONTAINER], dict(os.environ)
    return str(component_container()), child_environment(os.environ, ros_installation())


def _end(container: Container) -> None:
    container.close()
    if container.process.returncode < 0:
        # It had no chance to clean up; that is the supervisor's business then.
        sweep()


@pytest.fixture
def spawn(tmp_path: Path) -> Iterator[StartContainer]:
    """Start containers that end with the test; by default the hello is exchanged already."""
    with ExitStack() as stack:

        def start(
            *arguments: str,
            name: str = "container",
            control: bool = True,
            greet: bool = True,
            failpoints: str = "",
            environment: Mapping[str, str] | None = None,
        ) -> Container:
            command, environ = _command_and_environment()
            environ.update(environment or {})
            misbehaving = ["--failpoints", failpoints] if failpoints else []
            ours: socket.socket | None = None
            theirs: socket.socket | None = None
            if control:
                ours, theirs = socket.socketpair()
                environ["PLAY_LAUNCH_CONTROL_FD"] = str(theirs.fileno())
            log = tmp_path / f"{name}.log"
            with log.open("ab") as output:
                process = subprocess.Popen(
                    [command, *arguments, *misbehaving, "--ros-args", "-r", f"__node:={name}"],
                    env=environ,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    pass_fds=() if theirs is None else (theirs.fileno(),),
                    # Ignored where the tests run under nohup.
                    preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),  # noqa: PLW1509
                )
            container = Container(process, ours, log)
            if theirs is not None:
                container.control_socket = f"socket:[{os.fstat(theirs.fileno()).st_ino}]"
                theirs.close()
            stack.callback(_end, container)
            if control and greet:
                hello = container.receive("the hello")
                assert isinstance(hello, ControlHello)
                container.send(ControlHello(protocol_version=1, version="test"))
            return container

        yield start


@pytest.fixture
def container(spawn: StartContainer) -> Iterator[Container]:
    """A container in the mode standard, which must survive the test."""
    container = spawn()
    yield container
    assert container.process.poll() is None, container.log.read_text()
    container.process.send_signal(signal.SIGTERM)
    assert container.wait() == 0, container.log.read_text()

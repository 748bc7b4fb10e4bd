"""Starts the real container; the tests are its supervisor.

Components come from our SDK (package `play_launch_demo`) and, where `rclcpp_components` is
installed, from rclcpp (package `test_components`). It is on no package index, so with wheels alone
the tests that load rclcpp components are skipped.
"""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

import pytest
from play_launch_msgs.msg import ControlHello

from play_launch.config.substitutions import ament_prefixes
from play_launch.container.environment import child_environment
from play_launch.container.ros import component_container, ros_installation
from play_launch.ros.fastdds.shared_memory import sweep
from tests.support.control_peer import Container, StartContainer
from tests.support.ros import Probe

SOURCES = Path(__file__).parent / "rclcpp_components"


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
            command = str(component_container())
            environ = child_environment(os.environ, ros_installation()) | dict(environment or {})
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


def prefix_of(package: str) -> Path | None:
    """Where a ROS package is installed."""
    for prefix in ament_prefixes(os.environ):
        if (prefix / "share" / package / "package.xml").is_file():
            return prefix
    return None


def missing(packages: Sequence[str]) -> str | None:
    """Why a test that needs these packages cannot run."""
    absent = [package for package in packages if prefix_of(package) is None]
    if not absent:
        return None
    debian = " ".join(f"ros-jazzy-{package.replace('_', '-')}" for package in absent)
    return (
        f"not in AMENT_PREFIX_PATH: {', '.join(absent)} (on Ubuntu: apt install {debian}, and "
        "source /opt/ros/jazzy/setup.bash)"
    )


def pytest_configure(config: pytest.Config) -> None:
    """Declare our marker."""
    config.addinivalue_line("markers", "needs_packages(*names): ROS packages that the test loads")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what cannot run."""
    for item in items:
        if Path(__file__).parent not in item.path.parents:
            continue
        packages = [name for mark in item.iter_markers("needs_packages") for name in mark.args]
        if "components" in getattr(item, "fixturenames", ()) or packages:
            packages.insert(0, "rclcpp_components")
        if (reason := missing(packages)) is not None:
            item.add_marker(pytest.mark.skip(reason=reason))


@pytest.fixture(scope="session")
def backend_is_in() -> None:
    """The container under test loads rclcpp components."""
    line = subprocess.run(
        [component_container(), "--version"],
        env=child_environment(os.environ, ros_installation()),
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    assert "rclcpp" in line.split("components:")[1].split(), (
        "rclcpp_components is installed, but the container was built without it: build and "
        "install it again in this environment"
    )


@pytest.fixture(scope="session")
def built_components(
    tmp_path_factory: pytest.TempPathFactory,
    backend_is_in: None,
) -> Path:
    """Build our test components as a user would; the prefix in which they are installed."""
    folder = tmp_path_factory.mktemp("components")
    prefix = folder / "install"
    cmake = shutil.which("cmake")
    assert cmake is not None, "cmake is not in PATH"
    # The wheels' libraries name more libraries than they need, and not all of those exist.
    lenient = "-Wl,--as-needed -Wl,--allow-shlib-undefined"
    configure = [
        *(cmake, "-S", os.fspath(SOURCES), "-B", os.fspath(folder / "build")),
        f"-DCMAKE_INSTALL_PREFIX={prefix}",
        f"-DCMAKE_PREFIX_PATH={';'.join(map(str, ament_prefixes(os.environ)))}",
        f"-DCMAKE_SHARED_LINKER_FLAGS={lenient}",
        f"-DCMAKE_EXE_LINKER_FLAGS={lenient}",
    ]
    build = [cmake, "--build", os.fspath(folder / "build"), "--target", "install", "-j", "2"]
    for command in (configure, build):
        done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    return prefix


@pytest.fixture
def components(built_components: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Package with our test components, for containers that are started from now on."""
    prefixes = [built_components, *ament_prefixes(os.environ)]
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(map(str, prefixes)))
    return "test_components"


@pytest.fixture
def probe() -> Iterator[Probe]:
    """A node of ours that listens and asks."""
    with Probe() as node:
        yield node


@pytest.fixture(params=["play_launch_demo", "test_components"])
def package(request: pytest.FixtureRequest) -> str:
    """The package of the components Talker and Crasher: of our SDK, and of rclcpp."""
    if request.param == "test_components":
        if (reason := missing(["rclcpp_components"])) is not None:
            pytest.skip(reason)
        request.getfixturevalue("components")
    return str(request.param)

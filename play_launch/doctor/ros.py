"""Checks of Python, ROS, and our container."""

from __future__ import annotations

import asyncio
import os
import shlex
import socket
import subprocess
import sys
import sysconfig
import tempfile
from typing import TYPE_CHECKING, Final

from play_launch.config.substitutions import ament_prefixes
from play_launch.container.channel import CONTROL_FD_VARIABLE, ControlChannel
from play_launch.container.codec import ControlError
from play_launch.container.command import NotInPackageError, find_executable
from play_launch.container.environment import (
    FIX,
    allocating_with,
    child_environment,
    find_allocator,
)
from play_launch.container.messages import Hello, Shutdown
from play_launch.container.ros import (
    RMW_VARIABLE,
    MixedInstallationError,
    NotInstalledError,
    RosInstallation,
    RosSource,
    component_container,
    middleware_problem,
    ros_installation,
    spawn_guard,
)
from play_launch.doctor.check_result import CheckResult, fail, ok, warn
from play_launch.process.preflight import (
    ADDRESS_SPACE_FIX,
    SHARED_MEMORY_FIX,
    address_space_problem,
    full_shared_memory,
)
from play_launch.recording.environment import versions

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from play_launch.container.environment import Allocator

_OLDEST: Final = (3, 11)
_NEWEST: Final = (3, 13)
"""Versions of Python that are tested."""
_OURSELVES: Final = "play-launch-py"
_NOTHING_STARTS: Final = "nothing can be started"
_REINSTALL: Final = "install play-launch-py as a package (pip install .)"
_REINSTALL_CONTAINER: Final = (
    "pip install play-launch-container of the same version (in a checkout: pip install "
    "./container_native)"
)
_IMPORTS: Final = {
    "rclpy": "import rclpy.utilities as u; print(u.get_rmw_implementation_identifier())",
    "composition_interfaces": "import composition_interfaces.srv",
}
_OPTIONAL: Final = "composition_interfaces"
_RCLPY_FIX: Final = (
    "source a ROS 2 installation that fits this Python, or pip install 'play-launch-py[jazzy]'"
)
_STOCK_FIX: Final = (
    "source a ROS 2 installation; with ROS's wheels, in a checkout: pip install --config-settings "
    "cmake.define.PLAY_LAUNCH_PYTHON_INTERFACES=ON ./container_native"
)
_IMPORT_TIMEOUT: Final = 60.0
_HELLO_TIMEOUT: Final = 20.0
"""Seconds from the start of the container to its hello message."""
_EXIT_TIMEOUT: Final = 5.0
_ALONE: Final = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF", "ROS_DOMAIN_ID": "0"}
"""A wrong domain is reported by its own check."""
_NAME: Final = "_play_launch_doctor"
_OUTPUT_LIMIT: Final = 500
"""Characters of the container's output that are quoted."""


def python(version: tuple[int, ...] = sys.version_info[:3]) -> CheckResult:
    says = f"{'.'.join(map(str, version))}, {sys.executable}"
    oldest, newest = (".".join(map(str, each)) for each in (_OLDEST, _NEWEST))
    if version[:2] < _OLDEST:
        return fail("Python", says, _NOTHING_STARTS, f"use Python {oldest} or newer")
    if version[:2] > _NEWEST:
        fix = f"use {oldest} to {newest} if in doubt"
        return warn("Python", says, "this version is not tested", fix)
    return ok("Python", says)


def packages() -> CheckResult:
    found = {name: version for name, version in versions().items() if name != "python"}
    if _OURSELVES not in found:
        says = "play-launch-py is not installed as a package"
        return warn("packages", says, "its version is unknown", _REINSTALL)
    named = ", ".join(f"{name} {version}" for name, version in sorted(found.items()))
    return ok("packages", named)


def ros() -> tuple[str, list[CheckResult]]:
    """Return the middleware in use, empty if unknown, and the findings on ROS and container."""
    environ = os.environ
    try:
        installation = ros_installation()
    except (NotInstalledError, MixedInstallationError) as error:
        return "", [
            fail("ROS", str(error), _NOTHING_STARTS, "as it says"),
            fail("container", "cannot be started without ROS", _NOTHING_STARTS, "see ROS"),
        ]
    prefixes = ament_prefixes(child_environment(environ, installation))
    prefix = installation.prefix
    if installation.source is RosSource.SYSTEM:
        prefix = next((p for p in prefixes if (p / "share/rcl/package.xml").is_file()), prefix)
    findings = [ok("ROS", f"{installation.source.value} in {prefix}")]
    rmw = ""
    # Either of these ends each process that loads ROS.
    if address_space_problem():
        obstacle, fix = "the address space is too small", ADDRESS_SPACE_FIX
    elif full_shared_memory():
        obstacle, fix = "shared memory is full", SHARED_MEMORY_FIX
    else:
        obstacle = fix = ""
    if obstacle:
        findings.append(fail("rclpy", f"does not load: {obstacle}", _NOTHING_STARTS, fix))
    else:
        errors, rmw = _imports(environ)
        if "rclpy" in errors and environ.get(RMW_VARIABLE):
            errors, rmw = _imports(_with_default_middleware(environ))
        for module, problem in errors.items():
            says = f"does not load: {problem}"
            if module == _OPTIONAL:
                loss = "container_type stock cannot be used"
                findings.append(warn(module, says, loss, _STOCK_FIX))
            else:
                findings.append(fail(module, says, _NOTHING_STARTS, _RCLPY_FIX))
        findings.append(_middleware(rmw, installation, environ))
    findings.append(_stock_container(prefixes))
    findings += _ros2_command(installation, environ)
    if obstacle:
        findings.append(fail("container", f"not started: {obstacle}", _NOTHING_STARTS, fix))
    else:
        usable = environ if environ.get(RMW_VARIABLE) == rmw else _with_default_middleware(environ)
        findings += container(installation, usable)
    return rmw, findings


def _with_default_middleware(environ: Mapping[str, str]) -> dict[str, str]:
    return {name: value for name, value in environ.items() if name != RMW_VARIABLE}


def _imports(environ: Mapping[str, str]) -> tuple[dict[str, str], str]:
    """Import each module in its own process, which rcl may end; errors by module, and the rmw."""
    errors: dict[str, str] = {}
    rmw = ""
    for module, code in _IMPORTS.items():
        try:
            result = subprocess.run(
                [sys.executable, "-c", code],
                env=dict(environ),
                capture_output=True,
                text=True,
                timeout=_IMPORT_TIMEOUT,
                check=False,
            )
        except subprocess.TimeoutExpired:
            errors[module] = f"takes longer than {_IMPORT_TIMEOUT:g} s"
            continue
        if result.returncode:
            lines = result.stderr.strip().splitlines()
            errors[module] = lines[-1] if lines else f"exited with {result.returncode}"
        elif module == "rclpy":
            rmw = result.stdout.split()[-1]
    return errors, rmw


def _middleware(rmw: str, ros: RosInstallation, environ: Mapping[str, str]) -> CheckResult:
    in_use, requested = rmw or "unknown", environ.get(RMW_VARIABLE, "")
    if requested in {"", in_use}:
        return ok("middleware", in_use)
    problem = middleware_problem(ros, environ)
    return fail(
        "middleware",
        problem or f"{RMW_VARIABLE} is {requested}, but {requested} does not load",
        f"every program with ROS exits at its start; the default is {in_use}",
        "as it says" if problem else f"unset {RMW_VARIABLE}, or install it",
    )


def _stock_container(prefixes: list[Path]) -> CheckResult:
    try:
        program = find_executable("rclcpp_components", "component_container", prefixes)
    except NotInPackageError:
        return warn(
            "stock containers",
            "rclcpp_components is not in AMENT_PREFIX_PATH",
            "container_type stock needs another package and executable, or attach: true",
            "source a ROS installation that has it (apt install ros-jazzy-rclcpp-components)",
        )
    return ok("stock containers", str(program))


def _ros2_command(ros: RosInstallation, environ: Mapping[str, str]) -> list[CheckResult]:
    """Report how the `ros2` of a sourced ROS finds the packages of our environment."""
    prefix = ros.prefix
    is_ours = (prefix / "share" / "play_launch_container").is_dir()
    if ros.source is RosSource.WHEELS or not is_ours or prefix in ament_prefixes(environ):
        return []
    folder, modules = shlex.quote(str(prefix)), shlex.quote(sysconfig.get_path("platlib"))
    line = (
        f"export AMENT_PREFIX_PATH={folder}:$AMENT_PREFIX_PATH "
        f"LD_LIBRARY_PATH={folder}/lib:$LD_LIBRARY_PATH PYTHONPATH=$PYTHONPATH:{modules}"
    )
    return [ok("ros2 command", f"finds our container and messages after: {line}")]


def container(ros: RosInstallation, environ: Mapping[str, str]) -> list[CheckResult]:
    """Start our container once, isolated and without discovery, and judge its hello message."""
    try:
        program = component_container()
        spawn_guard()
    except NotInstalledError as error:
        return [fail("container", str(error), _NOTHING_STARTS, _REINSTALL_CONTAINER)]
    allocator = find_allocator()
    environment = child_environment(environ, ros, _ALONE)
    if allocator.library is not None:
        environment = allocating_with(environment, allocator.library)
    hello = asyncio.run(_hello(program, environment))
    if isinstance(hello, str):
        return [fail("container", f"{program}: {hello}", _NOTHING_STARTS, _REINSTALL_CONTAINER)]
    return [
        _version(program, hello.version),
        _rclcpp(hello.backends),
        isolation(hello.mechanism, hello.notes),
        _allocator(allocator),
    ]


async def _hello(program: Path, environment: Mapping[str, str]) -> Hello | str:
    """Return the container's hello message, or what went wrong."""
    ours, theirs = socket.socketpair()
    with tempfile.TemporaryFile() as output, ours, theirs:
        try:
            process = subprocess.Popen(  # noqa: ASYNC220 - nothing else runs in this loop
                [program, "--isolated", "--ros-args", "-r", f"__node:={_NAME}"],
                env={**environment, CONTROL_FD_VARIABLE: str(theirs.fileno())},
                pass_fds=(theirs.fileno(),),
                stdout=output,
                stderr=subprocess.STDOUT,
            )
        except OSError as error:
            return f"cannot be started: {error.strerror}"
        theirs.close()
        try:
            channel = ControlChannel(ours, container=f"/{_NAME}")
            try:
                async with asyncio.timeout(_HELLO_TIMEOUT):
                    hello = await channel.handshake(Hello(version="doctor"))
                channel.send(Shutdown(reason="doctor is done"))
            finally:
                channel.close()
        except TimeoutError:
            return f"sends no hello message for {_HELLO_TIMEOUT:g} s"
        except ControlError as error:
            output.seek(0)
            text = output.read().decode(errors="replace").strip()
            return f"{error}; {text[-_OUTPUT_LIMIT:] or 'without output'}"
        finally:
            try:
                process.wait(_EXIT_TIMEOUT)  # nothing else runs in this loop
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
    return hello


def _version(program: Path, version: str) -> CheckResult:
    ours = versions().get(_OURSELVES, "")
    if version and ours and version != ours:
        says = f"{program} is version {version}, the supervisor is {ours}"
        return warn("container", says, "their messages may differ", _REINSTALL_CONTAINER)
    return ok("container", f"{program}, version {version or 'unknown'}")


def _rclcpp(backends: tuple[str, ...]) -> CheckResult:
    named = ", ".join(backends) or "none"
    if "rclcpp" in backends:
        return ok("rclcpp components", f"in; backends: {named}")
    return warn(
        "rclcpp components",
        f"not built with rclcpp support; backends: {named}",
        "our containers load components of play-launch's own SDK only",
        "build where rclcpp_components is found (source /opt/ros/jazzy/setup.sh, then pip install "
        "./container_native), or load them into container_type: stock",
    )


def isolation(mechanism: str, notes: tuple[str, ...]) -> CheckResult:
    if mechanism == "shared_memory":
        says = "by shared memory: messages between nodes go by pointer"
        return ok("isolation", "; ".join((says, *notes)))
    return warn(
        "isolation",
        f"by {mechanism or 'nothing'}" + (f": {'; '.join(notes)}" if notes else ""),
        "messages between isolated nodes are copied through the middleware",
        "allow clone() with CLONE_VM and waitid(): seccomp or a container's profile forbids them",
    )


def _allocator(found: Allocator) -> CheckResult:
    if found.library is not None:
        return ok("allocator", str(found.library))
    return warn(
        "allocator",
        "glibc's malloc, whose locks all nodes of a container share",
        "a node that dies while it allocates can freeze its isolated container, which is then "
        "restarted",
        found.problem or FIX,
    )

"""Gathers the facts about this machine. Nothing is changed, and nothing is left behind."""

from __future__ import annotations

import json
import os
import platform
import resource
import shlex
import shutil
import socket
import subprocess
import sys
import sysconfig
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.config.ament_index import ament_prefixes
from play_launch.container.command import ExecutableNotFoundError, find_executable
from play_launch.container.environment import child_environment
from play_launch.container.middleware import middleware_problem
from play_launch.container.ros import (
    MixedInstallationError,
    NotInstalledError,
    RosInstallation,
    RosSource,
    ros_installation,
)
from play_launch.doctor.container_probe import probe_container
from play_launch.doctor.facts import (
    ContainerFacts,
    KernelFacts,
    Limit,
    LimitFacts,
    MachineFacts,
    NetworkFacts,
    PythonFacts,
    RecordingFacts,
    RosFacts,
    SharedMemoryFacts,
)
from play_launch.doctor.gather_kernel import (
    key_support,
    own_group,
    real_time_share,
    surroundings,
)
from play_launch.process.capabilities import Capability, has_capability
from play_launch.process.machine import (
    ADDRESS_SPACE_FIX,
    SHARED_MEMORY_FIX,
    address_space,
    address_space_problem,
    full_shared_memory,
    proc_problem,
    shared_memory_room,
)
from play_launch.recording.facts import versions
from play_launch.recording.session import default_log_folder
from play_launch.ros.fastdds.shared_memory import SHARED_MEMORY, count_files

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_MODULES: Final = ("rclpy", "play_launch_msgs.msg", "composition_interfaces.srv")
_IMPORTS: Final = """
import importlib, json, os, sys
answer = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)  # libraries write there as well
errors, rmw = {}, ""
for module in sys.argv[1:]:
    try:
        importlib.import_module(module)
    except Exception as error:
        errors[module.partition(".")[0]] = str(error)
if "rclpy" not in errors:
    from rclpy.utilities import get_rmw_implementation_identifier
    rmw = get_rmw_implementation_identifier()
print(json.dumps({"errors": errors, "rmw": rmw}), file=answer, flush=True)
"""
_IMPORT_LIMIT: Final = 60.0
"""Seconds."""
_IFF_UP: Final = 0x1
_IFF_MULTICAST: Final = 0x1000
_DATAGRAM_LIMIT: Final = 2.0
"""Seconds for a datagram to ourselves."""


def gather() -> MachineFacts:
    """Look at everything; takes a second, most of it for starting two processes."""
    installation: RosInstallation | None = None
    problem = ""
    try:
        installation = ros_installation()
    except (NotInstalledError, MixedInstallationError) as error:
        problem = str(error)
    obstacle = _obstacle()
    ros = _ros(installation, problem, os.environ, obstacle)
    if installation is None:
        container = ContainerFacts(problem="it cannot be asked without ROS")
    elif obstacle is not None:
        # The messages that it speaks would be the end of this process.
        container = ContainerFacts(problem=f"it is not asked: {obstacle.what}", fix=obstacle.fix)
    else:
        with _middleware(ros.rmw_in_use):
            container = probe_container(installation, os.environ)
    return MachineFacts(
        python=_python(),
        ros=ros,
        container=container,
        kernel=_kernel(),
        groups=own_group(),
        keys=key_support(),
        surroundings=surroundings(),
        limits=_limits(),
        shared_memory=_shared_memory(),
        network=_network(os.environ),
        recording=_recording(default_log_folder()),
    )


class _Obstacle(NamedTuple):
    """What ends each process that loads ROS."""

    what: str
    fix: str


def _obstacle() -> _Obstacle | None:
    if address_space_problem(address_space()):
        return _Obstacle("the address space is too small", ADDRESS_SPACE_FIX)
    if full_shared_memory(shared_memory_room()):
        return _Obstacle("shared memory is full", SHARED_MEMORY_FIX)
    return None


def _python() -> PythonFacts:
    packages = versions()
    packages.pop("python", None)
    return PythonFacts(
        version=(sys.version_info.major, sys.version_info.minor, sys.version_info.micro),
        executable=sys.executable,
        packages=packages,
    )


def _ros(
    installation: RosInstallation | None,
    problem: str,
    environ: Mapping[str, str],
    obstacle: _Obstacle | None,
) -> RosFacts:
    asked_for = environ.get("RMW_IMPLEMENTATION", "")
    if installation is None:
        return RosFacts(problem=problem, rmw_asked_for=asked_for)
    errors, in_use = ({"rclpy": obstacle.what}, "") if obstacle else _imports(environ)
    if asked_for and not in_use and not obstacle:
        errors, in_use = _imports(_with_middleware(environ, ""))
    prefixes = ament_prefixes(child_environment(environ, installation))
    stock = ""
    with suppress(ExecutableNotFoundError):
        stock = str(find_executable("rclcpp_components", "component_container", prefixes))
    prefix = installation.prefix
    if installation.source.value == "system":
        prefix = next(
            (each for each in prefixes if (each / "share/rcl/package.xml").is_file()), prefix
        )
    return RosFacts(
        source=installation.source.value,
        prefix=str(prefix),
        import_errors=errors,
        import_fix=obstacle.fix if obstacle else "",
        rmw_in_use=in_use,
        rmw_asked_for=asked_for,
        middleware_problem=middleware_problem(installation, environ) or "",
        stock_container=stock,
        ros2_needs=_ros2_needs(installation, environ),
    )


def _ros2_needs(installation: RosInstallation, environ: Mapping[str, str]) -> str:
    """Describe how the ``ros2`` of a sourced ROS finds what our own environment has."""
    prefix = installation.prefix
    is_ours = (prefix / "share" / "play_launch_container").is_dir()
    if installation.source is RosSource.WHEELS or not is_ours or prefix in ament_prefixes(environ):
        return ""
    packages = shlex.quote(sysconfig.get_path("platlib"))
    place = shlex.quote(str(prefix))
    return (
        f"export AMENT_PREFIX_PATH={place}:$AMENT_PREFIX_PATH "
        f"LD_LIBRARY_PATH={place}/lib:$LD_LIBRARY_PATH PYTHONPATH=$PYTHONPATH:{packages}"
    )


def _with_middleware(environ: Mapping[str, str], rmw: str) -> dict[str, str]:
    """Give the environment without a request for another middleware than this."""
    name = "RMW_IMPLEMENTATION"
    return {key: value for key, value in environ.items() if key != name or value == rmw}


@contextmanager
def _middleware(rmw: str) -> Iterator[None]:
    """Take a request for another middleware out of our own environment for a while.

    With one that is not there, the container would end at its start, and so would we when our
    messages are imported.
    """
    before = dict(os.environ)
    wanted = _with_middleware(before, rmw)
    for name in before.keys() - wanted.keys():
        del os.environ[name]
    try:
        yield
    finally:
        os.environ.update(before)


def _imports(environ: Mapping[str, str]) -> tuple[dict[str, str], str]:
    """Import what is needed in a process of its own; the errors by module, and the middleware.

    rcl ends the process in which it is not satisfied, so this one does not try it.
    """
    try:
        result = subprocess.run(
            [sys.executable, "-c", _IMPORTS, *_MODULES],
            env=dict(environ),
            capture_output=True,
            text=True,
            timeout=_IMPORT_LIMIT,
            check=False,
        )
        report = json.loads(result.stdout)
    except subprocess.TimeoutExpired:
        return {"rclpy": f"takes longer than {_IMPORT_LIMIT:g} s"}, ""
    except ValueError:
        return {"rclpy": result.stderr.strip() or f"ended with {result.returncode}"}, ""
    return report["errors"], report["rmw"]


def _kernel() -> KernelFacts:
    has_pidfd = False
    with suppress(OSError, AttributeError):
        os.close(os.pidfd_open(os.getpid()))
        has_pidfd = True
    return KernelFacts(release=platform.release(), has_pidfd=has_pidfd, proc_problem=proc_problem())


def _limits() -> LimitFacts:
    return LimitFacts(
        nofile=_limit(resource.RLIMIT_NOFILE),
        nproc=_limit(resource.RLIMIT_NPROC),
        core=_limit(resource.RLIMIT_CORE),
        memlock=_limit(resource.RLIMIT_MEMLOCK),
        address_space=_limit(resource.RLIMIT_AS),
        rtprio=_limit(resource.RLIMIT_RTPRIO),
        nice=_limit(resource.RLIMIT_NICE),
        real_time_share=real_time_share(),
        may_schedule=has_capability(Capability.SYS_NICE),
        may_lock_memory=has_capability(Capability.IPC_LOCK),
    )


def _limit(which: int) -> Limit:
    soft, hard = (
        None if value == resource.RLIM_INFINITY else value for value in resource.getrlimit(which)
    )
    return Limit(soft=soft, hard=hard)


def _shared_memory(folder: Path = SHARED_MEMORY) -> SharedMemoryFacts:
    try:
        usage = shutil.disk_usage(folder)
        count = count_files(folder)
    except OSError:
        return SharedMemoryFacts(total=None, free=None, is_writable=False)
    return SharedMemoryFacts(
        total=usage.total,
        free=usage.free,
        is_writable=os.access(folder, os.W_OK | os.X_OK),
        segments=count.files,
        leftovers=count.leftovers,
    )


def _network(environ: Mapping[str, str]) -> NetworkFacts:
    flags: int | None = None
    with suppress(OSError, ValueError):
        flags = int(Path("/sys/class/net/lo/flags").read_text(), 16)
    ports: tuple[int, int] | None = None
    with suppress(OSError, ValueError):
        first, last = Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()
        ports = int(first), int(last)
    return NetworkFacts(
        loopback_works=_datagram_arrives() and (flags is None or bool(flags & _IFF_UP)),
        loopback_has_multicast=None if flags is None else bool(flags & _IFF_MULTICAST),
        discovery_range=environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", ""),
        localhost_only=environ.get("ROS_LOCALHOST_ONLY", ""),
        cyclone_uri=environ.get("CYCLONEDDS_URI", ""),
        domain_id=environ.get("ROS_DOMAIN_ID", ""),
        ephemeral_ports=ports,
    )


def _datagram_arrives() -> bool:
    try:
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
        ):
            receiver.bind(("127.0.0.1", 0))
            receiver.settimeout(_DATAGRAM_LIMIT)
            sender.sendto(b"?", receiver.getsockname())
            return receiver.recv(1) == b"?"
    except OSError:
        return False


def _recording(folder: Path) -> RecordingFacts:
    """Look at the folder for recordings, or at the nearest one above that is there."""
    nearest = folder
    while not nearest.exists() and nearest != nearest.parent:
        nearest = nearest.parent
    if not nearest.is_dir():
        return RecordingFacts(folder=str(folder), problem=f"{nearest} is no folder")
    if not os.access(nearest, os.W_OK | os.X_OK):
        return RecordingFacts(folder=str(folder), problem=f"{nearest} cannot be written to")
    free: int | None = None
    with suppress(OSError):
        free = shutil.disk_usage(nearest).free
    return RecordingFacts(folder=str(folder), free=free)

"""Checks of the kernel, its limits and rights, shared memory, network and folders.

No right is needed unless a configuration requests it, so a missing one is no warning.
"""

from __future__ import annotations

import ctypes
import os
import platform
import re
import resource
import shutil
import socket
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

from play_launch.config.resources import nice_limit
from play_launch.config.values import LARGEST_DOMAIN
from play_launch.doctor.check_result import CheckResult, fail, ok, size_text, warn
from play_launch.process.cgroups.group import GroupError
from play_launch.process.cgroups.session_groups import delegated_group
from play_launch.process.open_files import ENOUGH as RAISED_FILES
from play_launch.process.preflight import (
    ADDRESS_SPACE_FIX,
    SHARED_MEMORY_FIX,
    address_space_problem,
    full_shared_memory,
    proc_problem,
    shared_memory_room,
)
from play_launch.recording.session import default_log_folder
from play_launch.ros.fastdds.middleware import is_fastdds
from play_launch.ros.fastdds.shared_memory import SHARED_MEMORY, count_files

if TYPE_CHECKING:
    from collections.abc import Mapping

_NOTHING_STARTS: Final = "nothing can be started"
_RIGHTS: Final = "see docs/resources.md#rights"
_ENOUGH: Final = 4096
"""Descriptors, for a system of 150 processes; threads, of which a DDS participant has ten."""
_ENOUGH_ADDRESS_SPACE: Final = 8 * 1024**3
"""The nodes of an isolated container share one, and each thread reserves 8 MiB or more of it."""
_ENOUGH_SHARED_MEMORY: Final = 256 * 1024**2
"""Fast DDS needs half a megabyte for each participant, and large messages their own size."""
_ENOUGH_DISK: Final = 1024**3
_CONTROLLERS: Final = ("cpu", "cpuset", "io", "memory", "pids")
_PARTICIPANTS: Final = 32
"""Fast DDS discovers that many on one machine when discovery is limited to it; Cyclone DDS, as
rmw_cyclonedds configures it, creates no more."""
_CYCLONE: Final = "rmw_cyclonedds_cpp"
_LARGEST_BUFFER: Final = Path("/proc/sys/net/core/rmem_max")
_ENOUGH_BUFFER: Final = 4 * 1024**2
"""Bytes, as our participants ask for: see docs/decisions/participants.md."""
_DDS_PORT: Final = 7400
_PORTS_PER_DOMAIN: Final = 250
_PORTS_USED: Final = 118
"""By 54 participants of one domain, as many as fit below Linux's ephemeral ports in domain 101."""
_IFF_MULTICAST: Final = 0x1000
_DATAGRAM_TIMEOUT: Final = 2.0
_IPC_LOCK: Final = 14
"""Number of the capability, see capabilities(7), as the next one."""
_SYS_NICE: Final = 23

_NOT_IN_ASYNCSSH: Final = frozenset(
    (
        "bindinterface",
        "controlmaster",
        "controlpath",
        "knownhostscommand",
        "proxyusefdpass",
        "pubkeyacceptedalgorithms",
        "revokedhostkeys",
        "securitykeyprovider",
        "stricthostkeychecking",
        "verifyhostkeydns",
    )
)
"""Keys of ssh_config that decide whether a login works, and that asyncssh does not read."""


def _has_capability(number: int) -> bool:
    """Whether it is effective; False where that cannot be read."""
    try:
        status = Path("/proc/self/status").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    found = re.search(r"^CapEff:\s*([0-9a-f]+)$", status, re.MULTILINE)
    return found is not None and bool(int(found[1], 16) >> number & 1)


def kernel() -> CheckResult:
    says = f"Linux {platform.release()}"
    try:
        os.close(os.pidfd_open(os.getpid()))
    except (OSError, AttributeError):
        return fail(
            "kernel",
            f"{says} without pidfd_open",
            "nothing can be started: a new process could be taken for an old one with its pid",
            "use Linux 5.3 or newer, where nothing (seccomp) forbids pidfd_open",
        )
    return ok("kernel", says)


def proc() -> CheckResult:
    if problem := proc_problem():
        says, _, fix = problem.partition("; fix: ")
        return fail("/proc", says, _NOTHING_STARTS, fix)
    return ok("/proc", "mounted")


def control_groups() -> CheckResult:
    subject = "control groups"
    try:
        group = delegated_group()
    except GroupError as error:
        says, _, fix = str(error).partition("; fix: ")
        return ok(subject, f"{says}: no limits for groups", fix)
    found = _text(group / "cgroup.controllers").split()
    missing = [each for each in _CONTROLLERS if each not in found]
    says = f"version 2, {group}, ours"
    if not missing:
        return ok(subject, f"{says}, with {', '.join(_CONTROLLERS)}")
    says = f"{says}, without {', '.join(missing)}: no limits that need these"
    return ok(subject, says, "see docs/resources.md#where-they-are-made")


def protection_keys() -> CheckResult:
    """Check CPU (x86: pku, ospke) and kernel for memory protection keys."""
    subject, loss = "protection keys", "private memory of isolated nodes is ordinary memory"
    found = re.search(r"^(?:flags|Features)\s*:(.*)$", _text(Path("/proc/cpuinfo")), re.MULTILINE)
    flags = set(found[1].split()) if found else set[str]()
    if not flags & {"pku", "poe"}:
        return ok(subject, f"the CPU has none (no pku in /proc/cpuinfo); {loss}")
    if "pku" in flags and "ospke" not in flags:
        return ok(subject, f"the kernel does not enable them (pku without ospke); {loss}")
    library = ctypes.CDLL(None, use_errno=True)
    key = library.pkey_alloc(0, 0) if hasattr(library, "pkey_alloc") else -1
    if key < 0:
        fix = "allow pkey_alloc, pkey_free and pkey_mprotect in the seccomp profile"
        return ok(subject, f"CPU and kernel have them, and pkey_alloc() is refused; {loss}", fix)
    library.pkey_free(key)
    return ok(subject, "CPU and kernel have them, for the private memory of isolated nodes")


def address_space() -> CheckResult:
    subject, soft = "address space", _limit(resource.RLIMIT_AS)[0]
    if problem := address_space_problem():
        return fail(subject, problem.partition("; fix: ")[0], _NOTHING_STARTS, ADDRESS_SPACE_FIX)
    if soft is None or soft >= _ENOUGH_ADDRESS_SPACE:
        return ok(subject, size_text(soft))
    impact = "nodes cannot allocate memory, and fail with std::bad_alloc"
    return warn(subject, size_text(soft), impact, ADDRESS_SPACE_FIX)


def open_files() -> CheckResult:
    subject = "open files"
    soft, hard = _limit(resource.RLIMIT_NOFILE)
    if soft is None or soft >= _ENOUGH:
        return ok(subject, _count(soft))
    if hard is None or hard >= _ENOUGH:
        raised = RAISED_FILES if hard is None else min(hard, RAISED_FILES)
        says = f"{soft:,} for each process; replay raises its own to {raised:,}"
        return ok(subject, says, "rlimits: {nofile: 65536} for a container of a hundred nodes")
    impact = "a large system runs out of descriptors in the middle of its start"
    fix = f"ulimit -n 65536, or LimitNOFILE=65536 in the systemd unit; {_RIGHTS}"
    return warn(subject, f"{soft:,} (at most {hard:,})", impact, fix)


def processes() -> CheckResult:
    subject = "processes"
    soft, hard = _limit(resource.RLIMIT_NPROC)
    if soft is None or soft >= _ENOUGH:
        return ok(subject, _count(soft))
    impact = "a large system runs out of threads in the middle of its start"
    fix = f"ulimit -u {_ENOUGH}, or LimitNPROC=infinity in the systemd unit; {_RIGHTS}"
    return warn(subject, f"{soft:,} (at most {_count(hard)})", impact, fix)


def core_dumps() -> CheckResult:
    soft = _limit(resource.RLIMIT_CORE)[0]
    off = "off; a crash is recorded with its backtrace all the same (ulimit -c unlimited)"
    return ok("core dumps", off if soft == 0 else f"up to {size_text(soft)}")


def real_time() -> CheckResult:
    subject, refused = "real-time", "scheduler policies fifo and rr are refused"
    of_time = ""
    with suppress(ValueError, ZeroDivisionError):
        files = (Path(f"/proc/sys/kernel/sched_rt_{name}_us") for name in ("runtime", "period"))
        runtime, period = (int(_text(each)) for each in files)
        if runtime == 0:
            says = f"switched off in the kernel: {refused}"
            return ok(subject, says, "sysctl kernel.sched_rt_runtime_us=950000")
        of_time = "" if runtime < 0 else f", {100 * runtime / period:.0f} % of the time"
    if _has_capability(_SYS_NICE):
        return ok(subject, f"priorities up to 99 (CAP_SYS_NICE){of_time}")
    highest = _limit(resource.RLIMIT_RTPRIO)[0]
    if highest == 0:
        return ok(subject, f"no priorities: {refused}", _RIGHTS)
    return ok(subject, f"priorities up to {99 if highest is None else highest}{of_time}")


def nice_values() -> CheckResult:
    limit = _limit(resource.RLIMIT_NICE)[0]
    lowest = -20 if limit is None or _has_capability(_SYS_NICE) else nice_limit(limit)
    if lowest > 0:
        return ok("nice values", "none below that of play-launch", _RIGHTS)
    return ok("nice values", f"down to {lowest}")


def locked_memory() -> CheckResult:
    subject, soft = "locked memory", _limit(resource.RLIMIT_MEMLOCK)[0]
    if soft is None or _has_capability(_IPC_LOCK):
        return ok(subject, "unlimited")
    return ok(subject, f"{size_text(soft)}; lock_memory and mlockall() need more", _RIGHTS)


def shared_memory(rmw: str) -> list[CheckResult]:
    """Check `/dev/shm` for the middleware in use; empty if that is unknown."""
    subject = "shared memory"
    room = shared_memory_room()
    full = full_shared_memory().partition("; fix: ")[0]
    if rmw and not is_fastdds(rmw) and not full:
        return [ok(subject, f"not checked: {rmw} is in use, only Fast DDS needs it")]
    if room is None or not os.access(SHARED_MEMORY, os.R_OK | os.W_OK | os.X_OK):
        return [
            warn(
                subject,
                f"{SHARED_MEMORY} cannot be used",
                "messages between processes go through the network stack",
                "mount -t tmpfs tmpfs /dev/shm; in docker: --ipc=private --shm-size 1g",
            )
        ]
    says = f"{SHARED_MEMORY} has {size_text(room.total)}, {size_text(room.free)} of it free"
    if full:
        finding = fail(subject, full, _NOTHING_STARTS, SHARED_MEMORY_FIX)
    elif room.free < _ENOUGH_SHARED_MEMORY:
        impact = "when it is full, participants cannot be created and large messages are lost"
        finding = warn(subject, says, impact, SHARED_MEMORY_FIX)
    else:
        finding = ok(subject, says)
    files = count_files(SHARED_MEMORY)
    if not files.leftovers:
        return [finding, ok("leftovers", f"none; {files.files} files of Fast DDS are in use")]
    return [
        finding,
        warn(
            "leftovers",
            f"{files.leftovers} of {files.files} files of Fast DDS belong to exited processes",
            "they use up memory, and a process with the same port number later fails on them",
            "the next run of play-launch removes them",
        ),
    ]


def loopback(environ: Mapping[str, str]) -> CheckResult:
    if not _datagram_arrives():
        says, impact = "a datagram to 127.0.0.1 does not arrive", "nodes do not discover each other"
        return fail("loopback", says, impact, "ip link set lo up")
    flags = int(_text(Path("/sys/class/net/lo/flags")) or "-1", 16)
    if not flags & _IFF_MULTICAST and environ.get("ROS_LOCALHOST_ONLY") == "1":
        return warn(
            "loopback",
            "works, without multicast",
            "middlewares that discover by multicast on lo (Cyclone DDS) discover nothing",
            "ip link set lo multicast on",
        )
    return ok("loopback", "works")


def ssh_config(path: Path) -> CheckResult:
    """Name what OpenSSH reads in ``~/.ssh/config``, and connections to machines do not."""
    words = {
        words[0].lower(): words[0]
        for line in _text(path).splitlines()
        if (words := line.replace("=", " ").split())
    }
    ignored = [word for key, word in words.items() if key in _NOT_IN_ASYNCSSH]
    if ignored:
        return warn(
            "ssh",
            f"{path} has {', '.join(sorted(ignored))}, which `machines:` ignores",
            "a machine that `ssh` reaches may be unknown, or refuse the login",
            "give the key itself (IdentityFile, or an agent), and its host key in known_hosts",
        )
    return ok("ssh", f"{path} has no key that `machines:` is known to ignore")


def _datagram_arrives() -> bool:
    try:
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
        ):
            receiver.bind(("127.0.0.1", 0))
            receiver.settimeout(_DATAGRAM_TIMEOUT)
            sender.sendto(b"?", receiver.getsockname())
            return receiver.recv(1) == b"?"
    except OSError:
        return False


def receive_buffers() -> CheckResult:
    subject, largest = "receive buffers", _text(_LARGEST_BUFFER).strip()
    if not largest.isdecimal():
        return ok(subject, f"{_LARGEST_BUFFER} cannot be read")
    size = int(largest)
    says = f"up to {size / 1024**2:.1f} MiB"
    if size >= _ENOUGH_BUFFER:
        return ok(subject, says)
    fix = f"sysctl -w net.core.rmem_max={_ENOUGH_BUFFER}: large systems are discovered faster"
    return ok(subject, says, fix)


def discovery(environ: Mapping[str, str], rmw: str) -> CheckResult:
    subject, variable = "discovery", "ROS_AUTOMATIC_DISCOVERY_RANGE"
    given = environ.get(variable, "")
    reach = given.upper()
    if environ.get("ROS_LOCALHOST_ONLY") == "1" and not reach:
        reach = "LOCALHOST"
    if reach == "OFF":
        impact = "processes do not discover each other; container_type stock cannot be used"
        return warn(subject, f"{variable} is OFF", impact, "unset it, or LOCALHOST")
    if reach not in {"", "SUBNET", "LOCALHOST", "SYSTEM_DEFAULT"}:
        return warn(
            subject,
            f"{variable} is {given}",
            "ROS does not know that value and uses its default",
            "OFF, LOCALHOST, SUBNET or SYSTEM_DEFAULT",
        )
    if rmw == _CYCLONE and reach != "SYSTEM_DEFAULT" and not environ.get("CYCLONEDDS_URI"):
        return warn(
            subject,
            f"{reach or 'SUBNET, the default'}, with {rmw}",
            f"after {_PARTICIPANTS} processes with ROS in a domain of this machine, further ones "
            "cannot create nodes",
            f"{variable}=SYSTEM_DEFAULT, or a higher Discovery/MaxAutoParticipantIndex in "
            "CYCLONEDDS_URI",
        )
    if reach == "LOCALHOST" and rmw != _CYCLONE:
        return warn(
            subject,
            "on this machine only",
            f"the first {_PARTICIPANTS} processes with ROS discover each other, further ones do "
            "not",
            "SUBNET, or a network namespace of its own, for more",
        )
    if reach == "LOCALHOST":
        return ok(subject, "on this machine only")
    return ok(subject, f"{reach or 'SUBNET, the default'}: all machines in this network")


def domain(environ: Mapping[str, str]) -> CheckResult:
    given = environ.get("ROS_DOMAIN_ID", "")
    text = given or "0"
    if not text.isascii() or not text.isdecimal() or int(text) > LARGEST_DOMAIN:
        fix = f"a number from 0 to {LARGEST_DOMAIN}"
        return fail("domain", f"ROS_DOMAIN_ID is {given}", "no node can be created", fix)
    first = _DDS_PORT + _PORTS_PER_DOMAIN * int(text)
    last = first + _PORTS_USED - 1
    says = f"{text}, ports {first} to {last}"
    ports = _text(Path("/proc/sys/net/ipv4/ip_local_port_range")).split()
    if len(ports) == 2 and first <= int(ports[1]) and last >= int(ports[0]):
        impact = f"ports {ports[0]} to {ports[1]} are ephemeral, so another program may have one"
        return warn("domain", says, impact, "a domain from 0 to 101")
    return ok("domain", says)


def recordings() -> CheckResult:
    """Check the folder for recordings, or the nearest existing one above it."""
    folder = nearest = default_log_folder()
    while not nearest.exists() and nearest != nearest.parent:
        nearest = nearest.parent
    if not nearest.is_dir() or not os.access(nearest, os.W_OK | os.X_OK):
        says = f"{folder}: {nearest} is not a folder that can be written to"
        fix = "set PLAY_LAUNCH_LOG_DIR, log_dir in the configuration, or --log-dir"
        return fail("recordings", says, "nothing is started that cannot be recorded", fix)
    try:
        free = shutil.disk_usage(nearest).free
    except OSError:
        return ok("recordings", str(folder))
    says = f"{folder}, {size_text(free)} free"
    if free < _ENOUGH_DISK:
        impact = "a long run fills it; its recording ends then, the run goes on"
        return warn("recordings", says, impact, "make room, or set PLAY_LAUNCH_LOG_DIR")
    return ok("recordings", says)


def _limit(which: int) -> tuple[int | None, int | None]:
    """Return soft and hard limit; None is unlimited."""
    soft, hard = resource.getrlimit(which)
    unlimited = resource.RLIM_INFINITY
    return None if soft == unlimited else soft, None if hard == unlimited else hard


def _count(number: int | None) -> str:
    return "unlimited" if number is None else f"{number:,}"


def _text(path: Path) -> str:
    with suppress(OSError):
        return path.read_text(encoding="utf-8", errors="replace")
    return ""

"""Judges the kernel, limits, memory, network and folders. Pure: facts in, findings out."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from play_launch.config.values import LARGEST_DOMAIN
from play_launch.doctor.finding import Finding, fail, ok, size_text, warn
from play_launch.doctor.rights import Right, how_to_get
from play_launch.process.machine import (
    ADDRESS_SPACE_FIX,
    PROC_FIX,
    SHARED_MEMORY_FIX,
    Room,
    address_space_problem,
    full_shared_memory,
)
from play_launch.process.open_files import ENOUGH as RAISED_FILES
from play_launch.ros.fastdds.middleware import is_fastdds

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.doctor.facts import (
        KernelFacts,
        Limit,
        LimitFacts,
        NetworkFacts,
        RecordingFacts,
        SharedMemoryFacts,
    )
    from play_launch.doctor.surroundings import Surroundings

ENOUGH_FILES: Final = 4096
"""A system of 150 processes needs some ten for each in the supervisor, and hundreds in a node."""
ENOUGH_PROCESSES: Final = 4096
"""Threads count: a DDS participant has about ten."""
ENOUGH_ADDRESS_SPACE: Final = 8 * 1024**3
"""The nodes of an isolated container have one, and each thread reserves 8 MiB or more of it."""
ENOUGH_SHARED_MEMORY: Final = 256 * 1024**2
"""Fast DDS takes half a megabyte for each participant, and large messages take their own size."""
ENOUGH_DISK: Final = 1024**3
SHARED_MEMORY: Final = "/dev/shm"  # noqa: S108 - where Linux keeps shared memory
PARTICIPANTS: Final = 32
"""Fast DDS looks for that many on one machine when discovery does not leave it.

Cyclone DDS, as rmw_cyclonedds sets it up, has places for that many and no more.
"""
_CYCLONE: Final = "rmw_cyclonedds_cpp"
_DDS_PORT: Final = 7400
_PORTS_PER_DOMAIN: Final = 250
_PORTS_USED: Final = 118
"""By 54 participants of one domain, which is what fits below the ports of Linux in domain 101."""


def judge_kernel(facts: KernelFacts) -> list[Finding]:
    """Judge the kernel."""
    if not facts.has_pidfd:
        return [
            fail(
                "kernel",
                f"Linux {facts.release} without pidfd_open",
                "nothing can be started: a new process could be taken for an old one of its pid",
                "use Linux 5.3 or newer, where nothing (seccomp) forbids pidfd_open",
            )
        ]
    findings = [ok("kernel", f"Linux {facts.release}")]
    if facts.proc_problem:
        findings.append(fail("/proc", facts.proc_problem, "nothing can be started", PROC_FIX))
    else:
        findings.append(ok("/proc", "mounted"))
    return findings


def judge_limits(facts: LimitFacts, started_by: Surroundings) -> list[Finding]:
    """Judge the limits of getrlimit(2)."""
    findings = [
        _address_space(facts.address_space),
        _open_files(facts.nofile, started_by),
        _processes(facts.nproc, started_by),
    ]
    if facts.core.soft == 0:
        says = "off; a crash is recorded with its backtrace all the same (ulimit -c unlimited)"
        findings.append(ok("core dumps", says))
    else:
        findings.append(ok("core dumps", f"up to {size_text(facts.core.soft)}"))
    return findings


def judge_shared_memory(facts: SharedMemoryFacts, rmw: str = "") -> list[Finding]:
    """Judge ``/dev/shm``, by what Fast DDS needs of it.

    Args:
        facts: What was found.
        rmw: The middleware in use; empty where it is not known.
    """
    room = None
    if facts.total is not None and facts.free is not None:
        room = Room(facts.total, facts.free)
    if problem := full_shared_memory(room):
        failure = fail("shared memory", problem, "nothing can be started", SHARED_MEMORY_FIX)
        return [failure, _leftovers(facts)]
    if rmw and not is_fastdds(rmw):
        return [ok("shared memory", f"not judged: {rmw} is in use, and it is Fast DDS's matter")]
    if not facts.is_writable or facts.total is None or facts.free is None:
        return [
            warn(
                "shared memory",
                f"{SHARED_MEMORY} cannot be used",
                "messages between processes take the way through the network stack",
                "mount -t tmpfs tmpfs /dev/shm; in docker: --ipc=private --shm-size 1g",
            )
        ]
    says = f"{SHARED_MEMORY} has {size_text(facts.total)}, {size_text(facts.free)} of it free"
    if facts.free < ENOUGH_SHARED_MEMORY:
        findings = [
            warn(
                "shared memory",
                says,
                "when it is full, participants cannot be created and large messages are lost",
                SHARED_MEMORY_FIX,
            )
        ]
    else:
        findings = [ok("shared memory", says)]
    return [*findings, _leftovers(facts)]


def _leftovers(facts: SharedMemoryFacts) -> Finding:
    if not facts.leftovers:
        return ok("leftovers", f"none; {facts.segments} files of Fast DDS are in use")
    return warn(
        "leftovers",
        f"{facts.leftovers} of {facts.segments} files of Fast DDS belong to the dead",
        "they use up memory, and whoever gets their port number next stumbles over them",
        "the next run of play-launch removes them",
    )


def judge_network(facts: NetworkFacts, rmw: str = "") -> list[Finding]:
    """Judge loopback, discovery and the domain."""
    return [_loopback(facts), _discovery(facts, rmw), _domain(facts)]


def judge_recording(facts: RecordingFacts) -> list[Finding]:
    """Judge the place for recordings."""
    if facts.problem:
        return [
            fail(
                "recordings",
                f"{facts.folder}: {facts.problem}",
                "nothing is started that cannot be recorded",
                "set PLAY_LAUNCH_LOG_DIR, log_dir in the configuration, or --log-dir",
            )
        ]
    if facts.free is not None and facts.free < ENOUGH_DISK:
        return [
            warn(
                "recordings",
                f"{facts.folder}, {size_text(facts.free)} free",
                "a long run fills it; its recording ends then, the run goes on",
                "make room, or set PLAY_LAUNCH_LOG_DIR",
            )
        ]
    room = "" if facts.free is None else f", {size_text(facts.free)} free"
    return [ok("recordings", f"{facts.folder}{room}")]


def _address_space(limit: Limit) -> Finding:
    problem = address_space_problem(limit.soft)
    if problem:
        return fail("address space", problem, "nothing can be started", ADDRESS_SPACE_FIX)
    return _at_least(
        "address space",
        limit,
        ENOUGH_ADDRESS_SPACE,
        "nodes cannot allocate memory, and fail with std::bad_alloc",
        ADDRESS_SPACE_FIX,
        write=size_text,
    )


def _open_files(limit: Limit, started_by: Surroundings) -> Finding:
    subject, soft, hard = "open files", limit.soft, limit.hard
    if soft is None or soft >= ENOUGH_FILES:
        return ok(subject, "unlimited" if soft is None else f"{soft:,}")
    if hard is None or hard >= ENOUGH_FILES:
        raised = RAISED_FILES if hard is None else min(hard, RAISED_FILES)
        says = f"{soft:,} for each process; replay raises its own to {raised:,}"
        return ok(subject, says, "rlimits: {nofile: 65536} for a container of a hundred nodes")
    return warn(
        subject,
        f"{soft:,} (at most {hard:,})",
        "a large system runs out of descriptors in the middle of its start",
        how_to_get(Right.OPEN_FILES, started_by),
    )


def _processes(limit: Limit, started_by: Surroundings) -> Finding:
    finding = _at_least(
        "processes",
        limit,
        ENOUGH_PROCESSES,
        "a large system runs out of threads in the middle of its start",
        f"ulimit -u {ENOUGH_PROCESSES}",
    )
    if finding.fix and limit.hard is not None and limit.hard < ENOUGH_PROCESSES:
        return replace(finding, fix=how_to_get(Right.PROCESSES, started_by))
    return finding


def _loopback(facts: NetworkFacts) -> Finding:
    if not facts.loopback_works:
        return fail(
            "loopback",
            "a datagram to 127.0.0.1 does not arrive",
            "no node finds another one",
            "ip link set lo up",
        )
    if facts.loopback_has_multicast is False and facts.localhost_only == "1":
        return warn(
            "loopback",
            "works, without multicast",
            "middlewares that discover by multicast on lo (Cyclone DDS) find nobody",
            "ip link set lo multicast on",
        )
    return ok("loopback", "works")


def _discovery(facts: NetworkFacts, rmw: str) -> Finding:
    reach = facts.discovery_range.upper()
    if facts.localhost_only == "1" and not reach:
        reach = "LOCALHOST"
    if reach == "OFF":
        return warn(
            "discovery",
            "ROS_AUTOMATIC_DISCOVERY_RANGE is OFF",
            "no process finds another one; container_type stock cannot be used",
            "unset it, or LOCALHOST",
        )
    if rmw == _CYCLONE and reach != "SYSTEM_DEFAULT" and not facts.cyclone_uri:
        return warn(
            "discovery",
            f"{reach or 'SUBNET, the default'}, with {rmw}",
            f"after {PARTICIPANTS} processes with ROS in a domain of this machine, further ones "
            "cannot create nodes",
            "ROS_AUTOMATIC_DISCOVERY_RANGE=SYSTEM_DEFAULT, or a higher "
            "Discovery/MaxAutoParticipantIndex in CYCLONEDDS_URI",
        )
    if reach == "LOCALHOST" and rmw != _CYCLONE:
        return warn(
            "discovery",
            "on this machine only",
            f"the first {PARTICIPANTS} processes with ROS find one another, further ones do not",
            "SUBNET, or a network namespace of its own, for more",
        )
    if reach not in {"", "SUBNET", "LOCALHOST", "SYSTEM_DEFAULT"}:
        return warn(
            "discovery",
            f"ROS_AUTOMATIC_DISCOVERY_RANGE is {facts.discovery_range}",
            "ROS does not know that value and takes its default",
            "OFF, LOCALHOST, SUBNET or SYSTEM_DEFAULT",
        )
    if reach == "LOCALHOST":
        return ok("discovery", "on this machine only")
    return ok("discovery", f"{reach or 'SUBNET, the default'}: everybody in this network")


def _domain(facts: NetworkFacts) -> Finding:
    text = facts.domain_id or "0"
    if not text.isascii() or not text.isdecimal() or int(text) > LARGEST_DOMAIN:
        return fail(
            "domain",
            f"ROS_DOMAIN_ID is {facts.domain_id}",
            "no node can be created",
            f"a number from 0 to {LARGEST_DOMAIN}",
        )
    first = _DDS_PORT + _PORTS_PER_DOMAIN * int(text)
    last = first + _PORTS_USED - 1
    ports = facts.ephemeral_ports
    if ports is not None and first <= ports[1] and last >= ports[0]:
        return warn(
            "domain",
            f"{text}, ports {first} to {last}",
            f"the kernel gives ports {ports[0]} to {ports[1]} to anybody, so one may be taken",
            "a domain from 0 to 101",
        )
    return ok("domain", f"{text}, ports {first} to {last}")


def _at_least(
    subject: str,
    limit: Limit,
    enough: int,
    impact: str,
    fix: str,
    *,
    write: Callable[[int], str] = "{:,}".format,
) -> Finding:
    if limit.soft is None or limit.soft >= enough:
        return ok(subject, "unlimited" if limit.soft is None else write(limit.soft))
    hard = "unlimited" if limit.hard is None else write(limit.hard)
    return warn(subject, f"{write(limit.soft)} (at most {hard})", impact, fix)

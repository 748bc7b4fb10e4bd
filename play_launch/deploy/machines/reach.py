"""Whether nodes of two machines can find each other; where they cannot, no error of ROS says it.

The coordinator sends this file to each machine, where any Python 3.8 runs it: it imports nothing of
play-launch. `probe` tells how discovery is set there, and whose multicast arrives.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import shlex
import socket
import struct
import sys
import time
from itertools import combinations
from pathlib import Path

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any, TypeAlias

    from play_launch.deploy.machines.part import Part

    Report: TypeAlias = Mapping[str, Any]
    """`variables`: names to values. `heard`: names of machines. `host`, `shared_memory`: the
    machine's network, and its /dev/shm, each the same text only where it is the same one."""

_log = logging.getLogger(__name__)
SECONDS = 3.0
"""After which what has not arrived does not arrive; without trouble it takes 0.3 s."""
_START = 10.0
"""Seconds in which Python starts on a slow machine."""
_PERIOD = 0.05
_GROUP = "239.255.0.1"
"""That of DDS: switches and access points filter each group by itself."""
_OTHERWISE = (
    "ROS_STATIC_PEERS",
    "ROS_DISCOVERY_SERVER",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "CYCLONEDDS_URI",
)
"""With one of these, discovery may need no multicast."""
_VARIABLES = (
    *_OTHERWISE,
    "ROS_DOMAIN_ID",
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "RMW_IMPLEMENTATION",
    "FASTDDS_BUILTIN_TRANSPORTS",
)


def reach_problems(reports: Mapping[str, Report], *, multicast: bool) -> list[str]:
    """List, with their fixes, what keeps nodes of two machines from finding each other."""
    found = [
        f"{one} and {other} are one computer with two /dev/shm, through which Fast DDS delivers "
        "nothing; share it (containers: --ipc=host), or set FASTDDS_BUILTIN_TRANSPORTS: UDPv4 in "
        "environment"
        for one, other in combinations(reports, 2)
        if reports[one]["host"] == reports[other]["host"]
        and reports[one]["shared_memory"] != reports[other]["shared_memory"]
        and _have_shared_memory(reports[one]["variables"], reports[other]["variables"])
    ]
    needing = [name for name in reports if _needs_multicast(reports[name]["variables"])]
    # One way is enough: the answer goes to the address of the sender.
    apart = [
        f"{one} and {other}"
        for one, other in combinations(needing if multicast else (), 2)
        if other not in reports[one]["heard"] and one not in reports[other]["heard"]
    ]
    if apart:
        found.append(
            f"no multicast arrives between {', '.join(apart)}, so their nodes do not find each "
            "other; set discovery: {by: peers}, or permit it (firewall, access point)"
        )
    return found


def _needs_multicast(variables: Mapping[str, str]) -> bool:
    is_subnet = variables.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() in {"", "SUBNET"}
    is_dds = "zenoh" not in variables.get("RMW_IMPLEMENTATION", "")
    return is_subnet and is_dds and not any(map(variables.get, _OTHERWISE))


def _have_shared_memory(*both: Mapping[str, str]) -> bool:
    return all(
        "fastrtps" in (each.get("RMW_IMPLEMENTATION") or "rmw_fastrtps_cpp")
        and "UDP" not in each.get("FASTDDS_BUILTIN_TRANSPORTS", "").upper()
        for each in both
    )


async def report_of(part: Part, token: str, others: list[str], *, multicast: bool) -> Report | None:
    """Let a machine run `probe`; None where that fails, which is said. Raises LinkLost."""
    asked = {
        "token": token,
        "name": part.name,
        "others": others if multicast else [],
        "seconds": SECONDS if multicast else 0,
        "given": _of_discovery(part.config.environment),
    }
    python = shlex.quote(sys.executable) if part.machine.local else "python3"
    command = f"exec {python} -I - {shlex.quote(json.dumps(asked))}"
    script = "\n".join([*part.bundle.environment_lines(), command])
    this = await asyncio.to_thread(Path(__file__).read_bytes)
    output = await part.host.run(script, SECONDS + _START, this)
    try:
        report: Report = json.loads(output.stdout)
    except ValueError:
        text = "%s: its python3 does not tell whether its nodes find those of other machines: %s"
        _log.warning(text, part.name, output.stderr or output.status)
        return None
    return report


def _of_discovery(variables: Mapping[str, str]) -> dict[str, str]:
    return {each: variables[each] for each in _VARIABLES if each in variables}


def probe(
    token: str, name: str, others: list[str], seconds: float, given: dict[str, str]
) -> dict[str, Any]:
    """Return the report of this machine; `given` are variables over those of this process.

    It hears others that run this with the same token.
    """
    variables = _of_discovery({**os.environ, **given})
    domain = variables.get("ROS_DOMAIN_ID", "")
    # A domain has 250 ports; DDS does not use this one.
    port = 7400 + 250 * (int(domain) if domain.isdigit() and int(domain) < 233 else 0) + 9
    return {
        "variables": variables,
        "heard": sorted(_hear(port, token, name, others, seconds)),
        "host": _text("/proc/sys/kernel/random/boot_id") + _identity("/proc/self/ns/net"),
        "shared_memory": _identity("/dev/shm"),  # noqa: S108
    }


def _hear(port: int, token: str, name: str, others: list[str], seconds: float) -> set[str]:
    """Tell the others of this machine, until each has heard it; return the names of those heard."""
    heard: set[str] = set()
    heard_by: set[str] = set()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        link.bind(("", port))
        interfaces = [_choice(index) for index, _ in socket.if_nameindex()]
        for each in interfaces:
            with contextlib.suppress(OSError):  # it has no address, or no multicast
                link.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, each)
        deadline = time.monotonic() + seconds
        left = 3
        while time.monotonic() < deadline and left > 0:
            text = json.dumps([token, name, sorted(heard)]).encode()
            for each in interfaces:
                with contextlib.suppress(OSError):
                    link.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, each)
                    link.sendto(text, (_GROUP, port))
            # The others may still miss that they were heard.
            left -= heard_by == set(others)
            until = time.monotonic() + _PERIOD
            while (limit := until - time.monotonic()) > 0:
                link.settimeout(limit)
                with contextlib.suppress(OSError, ValueError, TypeError):
                    said, sender, hears = json.loads(link.recv(65536))
                    if said == token and sender in others:
                        heard.add(sender)
                        heard_by |= {sender} if name in hears else set()
    return heard


def _choice(index: int) -> bytes:
    """Return a struct ip_mreqn: the group, on an interface."""
    return struct.pack("4s4si", socket.inet_aton(_GROUP), bytes(4), index)


def _text(path: str) -> str:
    return Path(path).read_text().strip()


def _identity(path: str) -> str:
    found = Path(path).stat()
    return f" {found.st_dev}:{found.st_ino}"


if __name__ == "__main__":
    print(json.dumps(probe(**json.loads(sys.argv[1]))))  # noqa: T201

"""A network, and a /dev/shm, in which nothing else of the machine takes part."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

_INSIDE = "PLAY_LAUNCH_BENCHMARK_INSIDE"
_PREPARE = (
    "mount -t tmpfs none /dev/shm && ip link set lo up multicast on && "
    'ip route add 224.0.0.0/4 dev lo && exec "$@"'
)


def is_inside() -> bool:
    """Whether `enter_namespace` has been here."""
    return _INSIDE in os.environ


def enter_namespace(module: str) -> None:
    """Run this program again in a network and mount namespace of its own."""
    for program in ("unshare", "ip"):
        if shutil.which(program) is None:
            raise SystemExit(f"{program} is not installed (packages util-linux and iproute2)")
    flags = ["-n", "-m"] if os.geteuid() == 0 else ["-r", "-n", "-m"]
    again = [sys.executable, "-m", module, *sys.argv[1:]]
    command = ["unshare", *flags, "sh", "-c", _PREPARE, "sh", *again]
    environment = {**os.environ, _INSIDE: "1", "ROS_DOMAIN_ID": "7"}
    for name in ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS"):
        # LOCALHOST finds at most 32 participants.
        environment.pop(name, None)
    raise SystemExit(subprocess.run(command, check=False, env=environment).returncode)

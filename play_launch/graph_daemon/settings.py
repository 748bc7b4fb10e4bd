"""What decides whom a participant meets: settings that freeze when the daemon starts.

Two processes see the same graph only when these agree, so they are compared. Clients read those of
the daemon from its process; it reports them to no client.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.graph_daemon.contract import DOMAIN_VARIABLE
from play_launch.ros.fastdds.profiles import PROFILE_VARIABLES

if TYPE_CHECKING:
    from collections.abc import Mapping

_RANGE: Final = "ROS_AUTOMATIC_DISCOVERY_RANGE"
COMPARED: Final = (
    DOMAIN_VARIABLE,
    "RMW_IMPLEMENTATION",
    _RANGE,
    "ROS_STATIC_PEERS",
    "ROS_LOCALHOST_ONLY",
    "ROS_DISCOVERY_SERVER",
    "ROS_SUPER_CLIENT",
    "ROS_SECURITY_ENABLE",
    "ROS_SECURITY_ENCLAVE_OVERRIDE",
    *PROFILE_VARIABLES,
    "CYCLONEDDS_URI",
    "ZENOH_ROUTER_CONFIG_URI",
    "ZENOH_SESSION_CONFIG_URI",
    "ZENOH_CONFIG_OVERRIDE",
)
"""The environment variables that two processes must share in order to meet the same nodes."""
_DEFAULTS: Final = {
    DOMAIN_VARIABLE: "0",
    _RANGE: "SUBNET",
    "ROS_LOCALHOST_ONLY": "0",
    "ROS_SECURITY_ENABLE": "false",
}


def compared_settings(environment: Mapping[str, str], rmw: str = "") -> dict[str, str]:
    """Return the settings of ``environment`` that count, by variable; what is unset is left out.

    Args:
        environment: That of the process.
        rmw: The middleware that is really in use; it replaces what the environment asks for.
    """
    settings = {name: environment[name] for name in COMPARED if environment.get(name)}
    if rmw:
        settings["RMW_IMPLEMENTATION"] = rmw
    return settings


def differences(daemon: Mapping[str, str], caller: Mapping[str, str]) -> list[str]:
    """Say, a line for each, where the caller's settings are not the daemon's.

    A caller that asks for no middleware is content with any.
    """
    found = []
    for name in COMPARED:
        default = _DEFAULTS.get(name, "")
        theirs, ours = daemon.get(name) or default, caller.get(name) or default
        if name == "RMW_IMPLEMENTATION" and not ours:
            continue
        if theirs != ours:
            found.append(f"{name}: the daemon has {_shown(theirs)}, here it is {_shown(ours)}")
    return found


def _shown(value: str) -> str:
    return value or "not set"

"""Judges ROS, the container and Python. Pure: facts in, findings out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.container.allocator import FIX
from play_launch.doctor.finding import Finding, fail, ok, warn

if TYPE_CHECKING:
    from play_launch.doctor.facts import ContainerFacts, PythonFacts, RosFacts

OLDEST: Final = (3, 11)
NEWEST: Final = (3, 13)
"""Versions of Python that are tested."""
_NOTHING_STARTS: Final = "nothing can be started"
_REINSTALL: Final = "install play-launch-py as a package (pip install .)"
_NEEDED: Final = ("rclpy", "play_launch_msgs")
"""Modules without which nothing works."""


def judge_python(facts: PythonFacts) -> list[Finding]:
    """Judge the interpreter and the packages."""
    version = ".".join(map(str, facts.version))
    says = f"{version}, {facts.executable}"
    if facts.version[:2] < OLDEST:
        findings = [
            fail("Python", says, _NOTHING_STARTS, f"use Python {OLDEST[0]}.{OLDEST[1]} or newer")
        ]
    elif facts.version[:2] > NEWEST:
        tested = f"{OLDEST[0]}.{OLDEST[1]} to {NEWEST[0]}.{NEWEST[1]}"
        findings = [
            warn("Python", says, "this version has not been tried", f"use {tested} if in doubt")
        ]
    else:
        findings = [ok("Python", says)]
    if "play-launch-py" not in facts.packages:
        says = "play-launch-py is not installed as a package"
        findings.append(warn("packages", says, "its version is unknown", _REINSTALL))
    else:
        named = ", ".join(f"{name} {version}" for name, version in sorted(facts.packages.items()))
        findings.append(ok("packages", named))
    return findings


def judge_ros(facts: RosFacts) -> list[Finding]:
    """Judge where ROS is and what it can do."""
    if facts.problem:
        return [fail("ROS", facts.problem, _NOTHING_STARTS, "as it says")]
    findings = [ok("ROS", f"{facts.source} in {facts.prefix}")]
    fix = facts.import_fix or _REINSTALL
    findings += [_import_error(module, error, fix) for module, error in facts.import_errors.items()]
    if facts.rmw_in_use or facts.middleware_problem or not facts.import_fix:
        findings.append(_rmw(facts))
    if facts.stock_container:
        findings.append(ok("stock containers", facts.stock_container))
    else:
        findings.append(
            warn(
                "stock containers",
                "rclcpp_components is not in AMENT_PREFIX_PATH",
                "container_type stock needs another package and executable, or attach: true",
                "source a ROS installation that has it (apt install ros-jazzy-rclcpp-components)",
            )
        )
    if facts.ros2_needs:
        says = f"finds our container and messages after: {facts.ros2_needs}"
        findings.append(ok("ros2 command", says))
    return findings


def judge_container(facts: ContainerFacts, own_version: str) -> list[Finding]:
    """Judge our own container by what it said of itself."""
    if facts.problem:
        where = f"{facts.program}: {facts.problem}" if facts.program else facts.problem
        return [fail("container", where, _NOTHING_STARTS, facts.fix or _REINSTALL)]
    findings = []
    if facts.version and own_version and facts.version != own_version:
        findings.append(
            warn(
                "container",
                f"{facts.program} is version {facts.version}, the supervisor is {own_version}",
                "they may not understand one another",
                _REINSTALL,
            )
        )
    else:
        findings.append(ok("container", f"{facts.program}, version {facts.version or 'unknown'}"))
    findings.append(_rclcpp(facts))
    findings.append(_isolation(facts))
    if facts.allocator:
        findings.append(ok("allocator", facts.allocator))
    else:
        findings.append(
            warn(
                "allocator",
                "glibc's malloc, which has locks that all nodes of a container share",
                "a node that dies while it allocates can freeze its isolated container, "
                "which is then started anew",
                facts.allocator_problem or FIX,
            )
        )
    return findings


def _import_error(module: str, error: str, fix: str) -> Finding:
    if module in _NEEDED:
        return fail(module, f"does not load: {error}", _NOTHING_STARTS, fix)
    return warn(module, f"does not load: {error}", "container_type stock cannot be used", fix)


def _rmw(facts: RosFacts) -> Finding:
    in_use, asked = facts.rmw_in_use or "unknown", facts.rmw_asked_for
    if asked in {"", in_use}:
        return ok("middleware", in_use)
    return fail(
        "middleware",
        facts.middleware_problem or f"RMW_IMPLEMENTATION is {asked}, but {asked} does not load",
        f"every program with ROS ends at its start; {in_use} would be used otherwise",
        "as it says" if facts.middleware_problem else "unset RMW_IMPLEMENTATION, or install it",
    )


def _rclcpp(facts: ContainerFacts) -> Finding:
    if "rclcpp" in facts.backends:
        return ok("rclcpp components", f"in; backends: {', '.join(facts.backends)}")
    return warn(
        "rclcpp components",
        f"not built with rclcpp support; backends: {', '.join(facts.backends) or 'none'}",
        "our containers load components of play-launch's own SDK only",
        "build where rclcpp_components is found (source /opt/ros/jazzy/setup.sh, then pip install "
        ".), or load them into container_type: stock",
    )


def _isolation(facts: ContainerFacts) -> Finding:
    if facts.mechanism == "shared_memory":
        by = "by shared memory: messages between nodes go by pointer"
        return ok("isolation", "; ".join((by, *facts.notes)))
    notes = "; ".join(facts.notes)
    return warn(
        "isolation",
        f"by {facts.mechanism or 'nothing'}" + (f": {notes}" if notes else ""),
        "messages between isolated nodes are copied through the middleware",
        "use Linux 5.16 or newer, where nothing (seccomp, a container's profile) forbids clone()",
    )

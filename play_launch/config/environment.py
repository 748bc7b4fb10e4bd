"""Environment variables: strings, because that is what a process gets."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.config.problems import excerpt, join_path
from play_launch.config.yaml_scalars import ScalarKind
from play_launch.config.yaml_tree import Mapping, Node, Scalar, describe_node

if TYPE_CHECKING:
    from play_launch.config.report import Report

_OURS = frozenset({"PLAY_LAUNCH_CONTROL_FD"})
_DOMAIN = "ROS_DOMAIN_ID"
_MOST_DOMAIN = 232
"""With more, port numbers of DDS do not fit; Fast DDS then just ends the process."""
_QUOTABLE = frozenset({ScalarKind.INTEGER, ScalarKind.FLOAT, ScalarKind.BOOL})


def resolve_environment(node: Node | None, path: str, report: Report) -> dict[str, str]:
    """Return the variables at `node`; names without `=`, values without NUL."""
    if node is None or (isinstance(node, Scalar) and node.kind is ScalarKind.INVALID):
        return {}
    if not isinstance(node, Mapping):
        message = f"expected a mapping of variables to strings, given {describe_node(node)}"
        report.add(node.place, path, message)
        return {}
    variables: dict[str, str] = {}
    for entry in node.entries:
        where = join_path(path, entry.key)
        if "=" in entry.key or "\x00" in entry.key:
            report.add(entry.place, where, "the name of a variable cannot hold = or NUL")
        elif entry.key in _OURS:
            report.add(entry.place, where, f"{entry.key} is set by this program itself")
        else:
            value = _string(entry.value, where, report)
            if value is not None and entry.key == _DOMAIN:
                _check_domain(value, entry.value, where, report)
            if value is not None:
                variables[entry.key] = value
    return variables


def domain_problem(value: str) -> str | None:
    """Say what is wrong with a ROS_DOMAIN_ID; None for a good one."""
    if value == "" or (
        value.isascii() and value.isdecimal() and len(value) < 4 and int(value) <= _MOST_DOMAIN
    ):
        return None
    return f"{_DOMAIN} is a number from 0 to {_MOST_DOMAIN}, given {excerpt(value)}"


def _check_domain(value: str, node: Node, path: str, report: Report) -> None:
    problem = domain_problem(value)
    if problem is not None:
        report.add(node.place, path, problem)


def _string(node: Node, path: str, report: Report) -> str | None:
    if isinstance(node, Scalar):
        if node.kind is ScalarKind.STRING and "\x00" in node.text:
            report.add(node.place, path, "an environment variable cannot hold a NUL character")
            return None
        if node.kind is ScalarKind.STRING:
            return node.text
        if node.kind is ScalarKind.INVALID:
            return None
        if node.kind in _QUOTABLE:
            message = f"expected a string, given {describe_node(node)}"
            report.add(node.place, path, f"{message}; quote it: {excerpt(node.text)}")
            return None
    report.add(node.place, path, f"expected a string, given {describe_node(node)}")
    return None


def log_folder_problem(environ: dict[str, str]) -> str | None:
    """Say why a ROS process with this environment has no folder for its log; None: it has one.

    rcl_logging takes ROS_LOG_DIR, then ROS_HOME, then HOME, and a process that finds none of them
    ends when it is started. Unlike a shell, it does not look into the database of users.
    """
    if any(environ.get(name) for name in ("ROS_LOG_DIR", "ROS_HOME", "HOME")):
        return None
    return "ROS has no folder for its log files; set HOME or ROS_LOG_DIR"

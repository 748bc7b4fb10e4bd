"""Environment variables: strings, because that is what a process gets."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.config.problems import excerpt
from play_launch.config.yaml.scalars import ScalarKind
from play_launch.config.yaml.tree import Mapping, Scalar, describe_node
from play_launch.core.domain import LARGEST_DOMAIN

if TYPE_CHECKING:
    from play_launch.config.yaml.tree import At

_OURS = frozenset({"PLAY_LAUNCH_CONTROL_FD"})
_DOMAIN = "ROS_DOMAIN_ID"
_QUOTABLE = frozenset({ScalarKind.INTEGER, ScalarKind.FLOAT, ScalarKind.BOOL})


def resolve_environment(at: At | None) -> dict[str, str]:
    """Return the variables that stand there; names without `=`, values without NUL."""
    if at is None:
        return {}
    if not isinstance(at.node, Mapping):
        at.expected("a mapping of variables to strings")
        return {}
    variables: dict[str, str] = {}
    for entry, value in at.entries():
        if "=" in entry.key or "\x00" in entry.key:
            value.problem("the name of a variable cannot hold = or NUL", entry.place)
        elif entry.key in _OURS:
            value.problem(f"{entry.key} is set by this program itself", entry.place)
        else:
            text = _string(value)
            problem = domain_problem(text) if text is not None and entry.key == _DOMAIN else None
            if problem is not None:
                value.problem(problem)
            if text is not None:
                variables[entry.key] = text
    return variables


def domain_problem(value: str) -> str | None:
    """Say what is wrong with a ROS_DOMAIN_ID; None for a good one."""
    if value == "" or (
        value.isascii() and value.isdecimal() and len(value) < 4 and int(value) <= LARGEST_DOMAIN
    ):
        return None
    return f"{_DOMAIN} is a number from 0 to {LARGEST_DOMAIN}, given {excerpt(value)}"


def _string(at: At) -> str | None:
    node = at.node
    if at.string is not None and "\x00" in at.string:
        at.problem("an environment variable cannot hold a NUL character")
        return None
    if isinstance(node, Scalar) and node.kind in _QUOTABLE:
        at.problem(
            f"expected a string, given {describe_node(node)}; quote it: {excerpt(node.text)}"
        )
    elif at.string is None:
        at.expected("a string")
    return at.string


def log_folder_problem(environ: dict[str, str]) -> str | None:
    """Say why a ROS process with this environment has no folder for its log; None: it has one.

    rcl_logging takes ROS_LOG_DIR, then ROS_HOME, then HOME, and a process that finds none of them
    ends when it is started. Unlike a shell, it does not look into the database of users.
    """
    if any(environ.get(name) for name in ("ROS_LOG_DIR", "ROS_HOME", "HOME")):
        return None
    return "ROS has no folder for its log files; set HOME or ROS_LOG_DIR"

"""Names of nodes, namespaces and topics, by the rules of ROS 2.

The rules are those of rmw (`validate_node_name.c`, `validate_namespace.c`) and of the naming
design article; the article's ban on `__`, which rmw does not enforce, is enforced here, because
`__` marks names with a meaning of their own, such as `__node`.
"""

from __future__ import annotations

import re
from typing import Final

from play_launch.config.problems import excerpt

LONGEST_NODE_NAME: Final = 255
LONGEST_NAMESPACE: Final = 245
LONGEST_TOPIC: Final = 247
LONGEST_FULL_NAME: Final = LONGEST_TOPIC - len("/set_parameters_atomically")
"""Namespace and name together: the services of a node begin with them."""

_UNUSUAL = re.compile(r"[^A-Za-z0-9_]")


def check_node_name(name: str) -> str:
    """Return `name` if a node can be called so; raise ValueError saying why not."""
    if not name:
        raise ValueError("a node name cannot be empty")
    if "/" in name:
        raise ValueError(
            f"the node name {excerpt(name)} holds a slash; give the part before it as namespace"
        )
    _check_token(name, "node name", name)
    if len(name) > LONGEST_NODE_NAME:
        raise ValueError(f"a node name is at most {LONGEST_NODE_NAME} characters")
    return name


def check_namespace(namespace: str) -> str:
    """Return `namespace` as an absolute one; raise ValueError saying what is wrong with it.

    `sensing` means `/sensing`, as everywhere in ROS where nothing lies around it.
    """
    if not namespace:
        raise ValueError('a namespace cannot be empty; write "/" or leave the key out')
    if namespace == "/":
        return namespace
    if namespace.startswith("~"):
        raise ValueError(f"the namespace {excerpt(namespace)} cannot begin with ~")
    absolute = namespace if namespace.startswith("/") else "/" + namespace
    _check_tokens(absolute[1:], "namespace", namespace)
    if len(absolute) > LONGEST_NAMESPACE:
        raise ValueError(f"a namespace is at most {LONGEST_NAMESPACE} characters")
    return absolute


def check_topic(name: str) -> str:
    """Return `name` if it is a topic or service: `chatter`, `~/out`, `/sensing/points`."""
    if not name:
        raise ValueError("a topic or service name cannot be empty")
    if name == "~":
        raise ValueError('"~" alone is no topic; write "~/" and a name')
    rest = name[2:] if name.startswith("~/") else name.removeprefix("/")
    if not rest:
        raise ValueError(f"{excerpt(name)} names no topic")
    if "{" in rest or "}" in rest:
        raise ValueError(f"{excerpt(name)}: a remapping takes no substitutions in braces")
    if "*" in rest or "\\" in rest:
        raise ValueError(f"{excerpt(name)}: ROS 2 has no wildcards in remappings")
    _check_tokens(rest, "topic name", name)
    if len(name) > LONGEST_TOPIC:
        raise ValueError(f"a topic name is at most {LONGEST_TOPIC} characters")
    return name


def join_full_name(namespace: str, name: str) -> str:
    """Return the absolute name of `name` in the absolute `namespace`."""
    return f"{namespace.rstrip('/')}/{name}"


def _check_tokens(tokens: str, what: str, whole: str) -> None:
    if tokens.endswith("/"):
        raise ValueError(f"the {what} {excerpt(whole)} ends with a slash; remove it")
    for token in tokens.split("/"):
        if not token:
            raise ValueError(f"the {what} {excerpt(whole)} holds two slashes in a row")
        _check_token(token, what, whole)


def _check_token(token: str, what: str, whole: str) -> None:
    unusual = _UNUSUAL.search(token)
    if unusual is not None:
        raise ValueError(
            f"the {what} {excerpt(whole)} holds {excerpt(unusual.group())}; "
            "ROS names are made of letters, digits and _"
        )
    if token[0].isdigit():
        raise ValueError(f"the {what} {excerpt(whole)} has a part that begins with a digit")
    if "__" in token:
        raise ValueError(f"the {what} {excerpt(whole)} holds __, which ROS keeps for itself")

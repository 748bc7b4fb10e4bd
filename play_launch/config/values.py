"""Durations, sizes, ROS names and environment variables as they are written.

Durations are `250 ms`, `1.5 s` or `2 min`; a number alone is seconds. Sizes are `100 MB` or
`2 GiB`; a number alone is bytes. The rules for names are those of rmw (`validate_node_name.c`,
`validate_namespace.c`) and of the naming design article; the article's ban on `__`, which rmw does
not enforce, is enforced here, because `__` marks names with a meaning of their own, such as
`__node`.
"""

from __future__ import annotations

import math
import re
import shlex
from typing import TYPE_CHECKING, Final

from play_launch.config.problems import excerpt
from play_launch.config.tree import Mapping, Scalar, describe_node

if TYPE_CHECKING:
    from play_launch.config.tree import Cursor

LONGEST_DURATION = 365 * 24 * 3600.0
"""Seconds. Longer waits overflow timers."""
LARGEST_SIZE: Final = 2**60
"""Bytes. No disk is larger, and a number of bytes fits the fields that hold it."""
NEVER: Final = math.inf
"""Value of the word `never` in place of a duration or a size."""
_SECONDS: Final = {"us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}
_BYTES: Final = {
    "B": 1,
    "kB": 10**3,
    "MB": 10**6,
    "GB": 10**9,
    "TB": 10**12,
    "KiB": 2**10,
    "MiB": 2**20,
    "GiB": 2**30,
    "TiB": 2**40,
}
_DURATION: Final = (
    f"a duration such as 10 s, 250 ms or 2 min (units: {', '.join(_SECONDS)}; none is s)"
)
_SIZE: Final = f"a size such as 500 MB or 2 GiB (units: {', '.join(_BYTES)}; none is B)"
_NUMBER_AND_UNIT = re.compile(
    r"\s*([-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+))\s*([^\W\d_]+)?\s*", re.ASCII
)
_LONGEST_TEXT = 64


def _number_and_unit(value: object, expected: str) -> tuple[float, str]:
    if isinstance(value, bool) or not isinstance(value, int | float | str) or value != value:  # noqa: PLR0124 - NaN
        raise ValueError(f"expected {expected}")
    if not isinstance(value, str):
        return value, ""
    found = _NUMBER_AND_UNIT.fullmatch(value) if len(value) <= _LONGEST_TEXT else None
    if found is None:
        raise ValueError(f"expected {expected}, given {excerpt(value)}")
    return float(found[1]), found[2] or ""


def parse_duration(value: object) -> float:
    """Return the seconds that `value` means, at least 0; raise ValueError with the fix."""
    number, unit = _number_and_unit(value, _DURATION)
    if unit and unit not in _SECONDS:
        units = ", ".join(_SECONDS)
        raise ValueError(f"{excerpt(unit)} is not a unit of time; units: {units}")
    factor = _SECONDS[unit or "s"]
    # Compared first: an integer can be larger than any double.
    if number > LONGEST_DURATION / factor:
        raise ValueError(f"is longer than {LONGEST_DURATION / 3600:.0f} h, the longest duration")
    if number < 0 or math.copysign(1.0, number) < 0:
        raise ValueError("a duration cannot be negative")
    return float(number * factor)


def parse_positive_duration(value: object) -> float:
    """Return the seconds that `value` means, more than 0; raise ValueError with the fix."""
    seconds = parse_duration(value)
    if seconds == 0:
        raise ValueError("must be longer than 0 s")
    return seconds


def parse_size(value: object) -> int:
    """Return the bytes that `value` means, more than 0; raise ValueError with the fix."""
    number, unit = _number_and_unit(value, _SIZE)
    if unit and unit not in _BYTES:
        raise ValueError(f"{excerpt(unit)} is not a unit of size; units: {', '.join(_BYTES)}")
    factor = _BYTES[unit or "B"]
    if number > LARGEST_SIZE / factor:
        raise ValueError(f"is larger than {LARGEST_SIZE // 2**40} TiB, the largest size")
    size = int(number * factor)
    if size <= 0:
        raise ValueError("must be larger than 0 B")
    return size


LONGEST_NODE_NAME: Final = 255
LONGEST_NAMESPACE: Final = 245
LONGEST_TOPIC: Final = 247
LONGEST_FULL_NAME: Final = LONGEST_TOPIC - len("/set_parameters_atomically")
"""Namespace and name together: the services of a node begin with them."""

_UNUSUAL = re.compile(r"[^A-Za-z0-9_]")
_UNUSUAL_IN_PATTERN = re.compile(r"[^A-Za-z0-9_/*?]")


def parse_prefix(value: object) -> list[str]:
    """Return the words that stand before a program; raise ValueError with the fix."""
    if not isinstance(value, str):
        raise ValueError("expected a string such as gdb -ex run --args")  # noqa: TRY004 - pydantic collects ValueError
    if not value.strip():
        raise ValueError("cannot be empty")
    if "\x00" in value:
        raise ValueError("a NUL character cannot be passed to a program")
    try:
        words = shlex.split(value)
    except ValueError as error:
        raise ValueError(f"{excerpt(value)} cannot be split as a shell does: {error}") from None
    if not words or not words[0]:
        raise ValueError("the program, its first word, cannot be empty")
    return words


def check_node_name(name: str) -> str:
    if not name:
        raise ValueError("a node name cannot be empty")
    if "/" in name:
        raise ValueError(
            f"the node name {excerpt(name)} holds a slash; give the part before it as namespace"
        )
    return _checked(name, name, "node name", LONGEST_NODE_NAME)


def check_namespace(namespace: str) -> str:
    """Return `namespace` as an absolute one; raise ValueError with the reason.

    `sensing` means `/sensing`, as everywhere in ROS without a surrounding namespace.
    """
    if not namespace:
        raise ValueError('a namespace cannot be empty; write "/" or leave the key out')
    if namespace == "/":
        return namespace
    if namespace.startswith("~"):
        raise ValueError(f"the namespace {excerpt(namespace)} cannot begin with ~")
    relative = namespace.removeprefix("/")
    return "/" + _checked(relative, namespace, "namespace", LONGEST_NAMESPACE - 1)


def check_address(text: str) -> str:
    """Return an IP address to listen on; raises ValueError."""
    import ipaddress  # noqa: PLC0415 - for few configurations

    try:
        return str(ipaddress.ip_address("127.0.0.1" if text == "localhost" else text))
    except ValueError:
        raise ValueError(f"expected an IP address such as 0.0.0.0, given {excerpt(text)}") from None


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
    _checked(rest, name, "topic name", LONGEST_TOPIC - len(name) + len(rest))
    return name


def check_topic_pattern(pattern: str) -> str:
    """Return a topic, or a pattern with * and ?, from the root on; raise ValueError."""
    if not pattern:
        raise ValueError("a topic cannot be empty")
    unusual = _UNUSUAL_IN_PATTERN.search(pattern)
    if unusual is not None:
        raise ValueError(
            f"{excerpt(pattern)} holds {excerpt(unusual[0])}; topics are made of letters, "
            "digits, _ and /, patterns of * and ? as well"
        )
    if len(pattern) > LONGEST_TOPIC:
        raise ValueError(f"a topic name is at most {LONGEST_TOPIC} characters")
    return pattern if pattern[0] in "/*" else f"/{pattern}"


def join_full_name(namespace: str, name: str) -> str:
    return f"{namespace.rstrip('/')}/{name}"


def _checked(tokens: str, whole: str, what: str, longest: int) -> str:
    problem = ""
    if tokens.endswith("/"):
        problem = "ends with a slash; remove it"
    for token in tokens.split("/") if not problem else ():
        unusual = _UNUSUAL.search(token)
        if not token:
            problem = "holds two slashes in a row"
        elif unusual is not None:
            problem = f"holds {excerpt(unusual[0])}; ROS names are made of letters, digits and _"
        elif token[0].isdigit():
            problem = "has a part that begins with a digit"
        elif "__" in token:
            problem = "holds __, which ROS keeps for itself"
        if problem:
            break
    if problem:
        raise ValueError(f"the {what} {excerpt(whole)} {problem}")
    if len(tokens) > longest:
        longest += len(whole) - len(tokens)
        raise ValueError(f"a {what} is at most {longest} characters")
    return tokens


LARGEST_DOMAIN: Final = 232
"""With more, port numbers of DDS do not fit into 16 bits; Fast DDS then ends the process."""
_DOMAIN = "ROS_DOMAIN_ID"
_OURS = frozenset({"PLAY_LAUNCH_CONTROL_FD", "PLAY_LAUNCH_MEMBER"})


def resolve_environment(at: Cursor | None) -> dict[str, str]:
    """Return the variables that stand there; names without `=`, values without NUL."""
    variables: dict[str, str] = {}
    if at is None:
        return variables
    if not isinstance(at.node, Mapping):
        at.expected("a mapping of variables to strings")
    for entry, value in at.entries():
        text = value.string
        if "=" in entry.key or "\x00" in entry.key:
            value.problem("the name of a variable cannot hold = or NUL", entry.location)
        elif entry.key in _OURS:
            value.problem(f"{entry.key} is set by this program itself", entry.location)
        elif text is None:
            node = value.node
            if isinstance(node, Scalar) and node.is_quotable:
                quoted = excerpt(node.text)
                value.problem(f"expected a string, given {describe_node(node)}; quote it: {quoted}")
            else:
                value.expected("a string")
        elif "\x00" in text:
            value.problem("an environment variable cannot hold a NUL character")
        else:
            problem = domain_problem(text) if entry.key == _DOMAIN else None
            if problem is not None:
                value.problem(problem)
            variables[entry.key] = text
    return variables


def domain_problem(value: str) -> str | None:
    """Return the reason why a ROS_DOMAIN_ID is invalid; None for a valid one."""
    is_number = value.isascii() and value.isdecimal() and len(value) < 4
    if value == "" or (is_number and int(value) <= LARGEST_DOMAIN):
        return None
    return f"{_DOMAIN} is a number from 0 to {LARGEST_DOMAIN}, given {excerpt(value)}"

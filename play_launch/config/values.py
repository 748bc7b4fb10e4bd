"""Durations, sizes, ROS names and environment variables as people write them.

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

_SECONDS = {"us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}
_NUMBER_AND_UNIT = re.compile(r"([-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+))\s*([^\W\d_]+)?", re.ASCII)
_FORMS = "a duration such as 10 s, 250 ms or 2 min (units: us, ms, s, min, h; none is s)"
_LONGEST_TEXT = 64
_CLOCK = re.compile(r"[0-9]+(:[0-9]+)+", re.ASCII)
_OTHER_NAMES = {
    "sec": "s",
    "secs": "s",
    "second": "s",
    "seconds": "s",
    "m": "min",
    "mins": "min",
    "minute": "min",
    "minutes": "min",
    "hour": "h",
    "hours": "h",
    "msec": "ms",
    "millis": "ms",
    "usec": "us",
    "µs": "us",
}


def parse_duration(value: object) -> float:
    """Return the seconds that `value` means, at least 0; raise ValueError with the fix."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError(f"expected {_FORMS}")  # noqa: TRY004 - pydantic collects ValueError
    # Not turned into a float yet: integers can be larger than any double.
    number = _parse_text(value) if isinstance(value, str) else value
    if number != number:  # noqa: PLR0124 - NaN; math.isnan() takes no integer of any size
        raise ValueError(f"expected {_FORMS}")
    if number > LONGEST_DURATION:
        raise ValueError(f"is longer than {LONGEST_DURATION / 3600:.0f} h, the longest duration")
    if number < 0 or math.copysign(1.0, number) < 0:
        raise ValueError("a duration cannot be negative")
    return float(number)


def parse_positive_duration(value: object) -> float:
    """Return the seconds that `value` means, more than 0; raise ValueError with the fix."""
    seconds = parse_duration(value)
    if seconds == 0:
        raise ValueError("must be longer than 0 s")
    return seconds


def _parse_text(text: str) -> float:
    text = text.strip()
    found = _NUMBER_AND_UNIT.fullmatch(text) if len(text) <= _LONGEST_TEXT else None
    if found is None:
        if len(text) <= _LONGEST_TEXT and _CLOCK.fullmatch(text):
            raise ValueError(f"{excerpt(text)} is not a duration; write 90 s or 1.5 min")
        raise ValueError(f"expected {_FORMS}, given {excerpt(text)}")
    number, unit = found.groups()
    if unit is None:
        unit = "s"
    if unit not in _SECONDS:
        other = _OTHER_NAMES.get(unit.lower(), "s")
        raise ValueError(
            f"{excerpt(unit)} is not a unit of time; did you mean {excerpt(f'{number} {other}')}? "
            f"Units: {', '.join(_SECONDS)}"
        )
    return float(number) * _SECONDS[unit]


NEVER: Final = math.inf
"""What the word `never` means in place of a duration or a size."""

LARGEST_SIZE: Final = 2**60
"""Bytes. No disk is larger, and a number of bytes fits the fields that hold it."""

_SIZE_UNITS = {
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
_SIZE_FORMS = f"a size such as 500 MB or 2 GiB (units: {', '.join(_SIZE_UNITS)}; none is B)"
_UNITS_IN_LOWER_CASE = {unit.lower(): unit for unit in _SIZE_UNITS} | {
    "k": "kB",
    "m": "MB",
    "g": "GB",
    "t": "TB",
}


def parse_size(value: object) -> int:
    """Return the bytes that `value` means, more than 0; raise ValueError with the fix."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError(f"expected {_SIZE_FORMS}")  # noqa: TRY004 - pydantic collects ValueError
    number, unit = _split_size(value) if isinstance(value, str) else (value, "B")
    if unit not in _SIZE_UNITS:
        meant = f"{number} {_UNITS_IN_LOWER_CASE.get(unit.lower(), 'MB')}"
        raise ValueError(
            f"{excerpt(unit)} is not a unit of size; did you mean {excerpt(meant)}? "
            f"Units: {', '.join(_SIZE_UNITS)}"
        )
    if isinstance(number, str):
        number = float(number)
    # As for durations: an integer can be larger than any double.
    if not number <= LARGEST_SIZE / _SIZE_UNITS[unit]:
        raise ValueError(f"is larger than {LARGEST_SIZE // 2**40} TiB, the largest size")
    size = int(number * _SIZE_UNITS[unit])
    if size <= 0:
        raise ValueError("must be larger than 0 B")
    return size


def _split_size(text: str) -> tuple[str, str]:
    text = text.strip()
    found = _NUMBER_AND_UNIT.fullmatch(text) if len(text) <= _LONGEST_TEXT else None
    if found is None:
        raise ValueError(f"expected {_SIZE_FORMS}, given {excerpt(text)}")
    return found[1], found[2] or "B"


LONGEST_NODE_NAME: Final = 255
LONGEST_NAMESPACE: Final = 245
LONGEST_TOPIC: Final = 247
LONGEST_FULL_NAME: Final = LONGEST_TOPIC - len("/set_parameters_atomically")
"""Namespace and name together: the services of a node begin with them."""

_UNUSUAL = re.compile(r"[^A-Za-z0-9_]")


def parse_prefix(value: object) -> list[str]:
    """Return the words that stand before a program; raise ValueError with the fix."""
    if not isinstance(value, str):
        raise ValueError("expected a string such as gdb -ex run --args")  # noqa: TRY004 - as above
    if not value.strip():
        raise ValueError("cannot be empty")
    if "\x00" in value:
        raise ValueError("a NUL character cannot be handed to a program")
    try:
        words = shlex.split(value)
    except ValueError as error:
        raise ValueError(f"{excerpt(value)} cannot be split as a shell does: {error}") from None
    if not words or not words[0]:
        raise ValueError("the program, its first word, cannot be empty")
    return words


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


_UNUSUAL_IN_PATTERN = re.compile(r"[^A-Za-z0-9_/*?]")


def check_topic_pattern(pattern: str) -> str:
    """Return the name of a topic, or a pattern with * and ?, from the root on; raise ValueError."""
    if not pattern:
        raise ValueError("a topic cannot be empty")
    unusual = _UNUSUAL_IN_PATTERN.search(pattern)
    if unusual is not None:
        raise ValueError(
            f"{excerpt(pattern)} holds {excerpt(unusual.group())}; topics are made of letters, "
            "digits, _ and /, patterns of * and ? as well"
        )
    if len(pattern) > LONGEST_TOPIC:
        raise ValueError(f"a topic name is at most {LONGEST_TOPIC} characters")
    return pattern if pattern[0] in "/*" else f"/{pattern}"


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


_OURS = frozenset({"PLAY_LAUNCH_CONTROL_FD", "PLAY_LAUNCH_MEMBER"})
_DOMAIN = "ROS_DOMAIN_ID"


def resolve_environment(at: Cursor | None) -> dict[str, str]:
    """Return the variables that stand there; names without `=`, values without NUL."""
    if at is None:
        return {}
    if not isinstance(at.node, Mapping):
        at.expected("a mapping of variables to strings")
        return {}
    variables: dict[str, str] = {}
    for entry, value in at.entries():
        if "=" in entry.key or "\x00" in entry.key:
            value.problem("the name of a variable cannot hold = or NUL", entry.location)
        elif entry.key in _OURS:
            value.problem(f"{entry.key} is set by this program itself", entry.location)
        else:
            text = _string(value)
            problem = domain_problem(text) if text is not None and entry.key == _DOMAIN else None
            if problem is not None:
                value.problem(problem)
            if text is not None:
                variables[entry.key] = text
    return variables


def domain_problem(value: str) -> str | None:
    """Return what is wrong with a ROS_DOMAIN_ID; None for a valid one."""
    if value == "" or (
        value.isascii() and value.isdecimal() and len(value) < 4 and int(value) <= LARGEST_DOMAIN
    ):
        return None
    return f"{_DOMAIN} is a number from 0 to {LARGEST_DOMAIN}, given {excerpt(value)}"


def _string(at: Cursor) -> str | None:
    node = at.node
    if at.string is not None and "\x00" in at.string:
        at.problem("an environment variable cannot hold a NUL character")
        return None
    if isinstance(node, Scalar) and node.is_quotable and not node.substituted:
        at.problem(
            f"expected a string, given {describe_node(node)}; quote it: {excerpt(node.text)}"
        )
    elif at.string is None:
        at.expected("a string")
    return at.string


def log_folder_problem(environ: dict[str, str]) -> str | None:
    """Return why ROS finds no log folder in this environment; None if it does.

    rcl_logging takes ROS_LOG_DIR, then ROS_HOME, then HOME, and a process that finds none of them
    ends when it is started. Unlike a shell, it does not look into the database of users.
    """
    if any(environ.get(name) for name in ("ROS_LOG_DIR", "ROS_HOME", "HOME")):
        return None
    return "ROS has no folder for its log files; set HOME or ROS_LOG_DIR"


LARGEST_DOMAIN: Final = 232
"""With more, port numbers of DDS do not fit into 16 bits; Fast DDS then just ends the process."""

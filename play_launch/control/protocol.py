"""What is said on the control socket of a session, as docs/control.md describes it for programs.

Lines of JSON in both directions. Whoever listens greets; whoever connects asks, each request with a
number of its own; an answer bears the number of its request. Nothing in here does I/O.
"""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping

PROTOCOL: Final = 1
"""Counted up when a program that knows an older number would misunderstand; new fields, new
operations and new kinds of events are no reason."""
LONGEST_REQUEST: Final = 4 * 1024 * 1024
"""Bytes of a line from a client, its end not counted: a configuration with its files."""
LONGEST_ANSWER: Final = 16 * 1024 * 1024
"""Bytes of a line to a client."""
ROS_VARIABLES: Final = (
    "ROS_",
    "RMW_",
    "RCUTILS_",
    "FASTRTPS_",
    "FASTDDS_",
    "CYCLONEDDS_",
    "ZENOH_",
)
"""What the names of environment variables begin with by which a system behaves differently, and
nodes find each other or do not."""
MOST_NAMES: Final = 2000
LONGEST_COMMAND: Final = 1000
"""Characters of a client's command line that are sent and recorded."""
LONGEST_NAME: Final = 1000
"""Characters of a name or pattern. What is compared with everything that runs is bounded."""
_LARGEST_ID: Final = 2**53
"""Every reader of JSON has integers up to here."""


class Code:
    """What kind of error an answer reports."""

    MALFORMED: Final = "malformed"
    """No request at all: the connection ends."""
    TOO_LONG: Final = "too_long"
    PROTOCOL: Final = "protocol"
    """The client speaks another version."""
    NOT_ALLOWED: Final = "not_allowed"
    TOO_MANY: Final = "too_many"
    """Others' long requests are in memory: the connection ends, and a later one may do."""
    UNKNOWN_OPERATION: Final = "unknown_operation"
    BAD_ARGUMENTS: Final = "bad_arguments"
    UNKNOWN_NAME: Final = "unknown_name"
    AMBIGUOUS_NAME: Final = "ambiguous_name"
    REFUSED: Final = "refused"
    """It makes no sense in the state that the system is in; nothing was done."""
    FAILED: Final = "failed"
    """It was tried."""
    TIMEOUT: Final = "timeout"
    """It is under way and was not over in time."""
    INTERNAL: Final = "internal"


class ControlError(Exception):
    """A request was not carried out.

    Attributes:
        code: One of those of `Code`.
        details: What else an answer says about it, for programs.
    """

    def __init__(self, code: str, message: str, **details: object) -> None:
        super().__init__(message)
        self.code = code
        self.details = details

    def as_object(self) -> dict[str, object]:
        """As it stands in an answer."""
        return {"code": self.code, "message": str(self), **self.details}

    @classmethod
    def of(cls, found: object) -> ControlError:
        """Read what `as_object` made; anything else is an internal error."""
        if not isinstance(found, dict):
            return cls(Code.INTERNAL, "an error without a description")
        known = {str(name): value for name, value in found.items()}
        code, message = str(known.pop("code", Code.INTERNAL)), str(known.pop("message", ""))
        error = cls(code, message)
        error.details = known
        return error


class Request(NamedTuple):
    """One line of a client."""

    id: int
    operation: str
    arguments: Mapping[str, Any]
    command: tuple[str, ...] = ()
    """The command line of the client, as it says itself."""


class LineSplitter:
    """Bytes in any pieces to lines of bounded length."""

    def __init__(self, longest: int) -> None:
        """Refuse lines of more than ``longest`` bytes."""
        self._longest = longest
        self._rest = bytearray()

    @property
    def unfinished(self) -> int:
        """Bytes of the line that has begun."""
        return len(self._rest)

    def feed(self, data: bytes) -> list[bytes]:
        """Return the lines that are complete by now, without their ends; empty ones are left out.

        Raises:
            ControlError: When a line is too long, complete or not; nothing can be read after that.
        """
        *whole, rest = data.split(b"\n")
        lines: list[bytes] = []
        for piece in whole:
            self._append(piece)
            if line := bytes(self._rest).strip():
                lines.append(line)
            self._rest.clear()
        self._append(rest)
        return lines

    def _append(self, piece: bytes) -> None:
        if len(self._rest) + len(piece) > self._longest:
            raise ControlError(Code.TOO_LONG, f"a line is longer than {self._longest} bytes")
        self._rest += piece


def encode(values: Mapping[str, object]) -> bytes:
    """Write one line, with its end: plain ASCII, without the numbers that JSON does not have."""
    return json.dumps(values, separators=(",", ":"), allow_nan=False).encode("ascii") + b"\n"


def decode(line: bytes) -> dict[str, Any]:
    """Read one line.

    Raises:
        ControlError: When it is no JSON object.
    """
    try:
        # A ValueError, as for numbers of thousands of digits; brackets by the thousand recurse.
        found = json.loads(line, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise ControlError(Code.MALFORMED, f"a line is no JSON: {error}") from None
    if not isinstance(found, dict):
        raise ControlError(Code.MALFORMED, "a line is no JSON object")
    return found


def request_of(line: bytes) -> Request:
    """Read what a client says.

    Raises:
        ControlError: When it is no request.
    """
    found = decode(line)
    version = found.get("protocol", PROTOCOL)
    if version != PROTOCOL or isinstance(version, bool):
        raise ControlError(
            Code.PROTOCOL, f"this session speaks protocol {PROTOCOL}, not {version!r}"
        )
    number, operation = found.get("id"), found.get("op")
    arguments, command = found.get("arguments", {}), found.get("command", [])
    if type(number) is not int or not 0 <= number <= _LARGEST_ID:
        raise ControlError(Code.MALFORMED, "a request needs an id, an integer of 0 or more")
    if not isinstance(operation, str):
        raise ControlError(Code.MALFORMED, "a request needs an op, the name of an operation")
    if not isinstance(arguments, dict):
        raise ControlError(Code.MALFORMED, "the arguments of a request are an object")
    if not isinstance(command, list) or not all(isinstance(word, str) for word in command):
        raise ControlError(Code.MALFORMED, "the command of a request is a list of strings")
    said = tuple(word[:LONGEST_COMMAND] for word in command[:LONGEST_COMMAND])
    return Request(number, operation, arguments, said)


def request_line(request: Request) -> bytes:
    """Write a request.

    Raises:
        ControlError: When it is longer than one may be.
    """
    line = encode(
        {
            "id": request.id,
            "op": request.operation,
            "protocol": PROTOCOL,
            "arguments": request.arguments,
            "command": request.command,
        }
    )
    if len(line) > LONGEST_REQUEST + 1:
        raise ControlError(
            Code.TOO_LONG, f"a request of {len(line)} bytes; the most are {LONGEST_REQUEST}"
        )
    return line


def _refuse(word: str) -> None:
    raise ValueError(f"{word} is no number of JSON")


# What operations read from their arguments.


def names_argument(arguments: Mapping[str, Any], name: str = "names") -> tuple[str, ...]:
    """Read a list of names or patterns; a missing one is empty.

    Raises:
        ControlError: When it is something else, or too much.
    """
    found = arguments.get(name, [])
    if not isinstance(found, list) or not all(isinstance(each, str) for each in found):
        raise ControlError(Code.BAD_ARGUMENTS, f"{name} is a list of strings")
    if len(found) > MOST_NAMES or any(len(each) > LONGEST_NAME for each in found):
        raise ControlError(
            Code.BAD_ARGUMENTS,
            f"{name} are at most {MOST_NAMES} strings of {LONGEST_NAME} characters",
        )
    return tuple(found)


def seconds_argument(arguments: Mapping[str, Any], name: str, default: float) -> float:
    """Read a number of seconds, more than 0 and less than a year.

    Raises:
        ControlError: When it is something else.
    """
    found = arguments.get(name, default)
    is_number = isinstance(found, int | float) and not isinstance(found, bool)
    if not is_number or not math.isfinite(found) or not 0 < found < 365 * 24 * 3600:
        raise ControlError(Code.BAD_ARGUMENTS, f"{name} is a number of seconds, more than 0")
    return float(found)


def flag_argument(arguments: Mapping[str, Any], name: str) -> bool:
    """Read what is true or false; a missing one is false.

    Raises:
        ControlError: When it is something else.
    """
    found = arguments.get(name, False)
    if not isinstance(found, bool):
        raise ControlError(Code.BAD_ARGUMENTS, f"{name} is true or false")
    return found

"""Lines of the control socket, and their errors; imports next to nothing, for quick commands.

Each line is a JSON object. docs/control.md describes them for programs.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

PROTOCOL: Final = 2
"""Incremented when a program of an older version would misunderstand; new fields, operations and
kinds of events are no reason."""
REQUEST_LIMIT: Final = 4 * 1024 * 1024
"""Bytes of a line from a client, its end not counted: a configuration with its files."""
ANSWER_LIMIT: Final = 16 * 1024 * 1024
"""Bytes of a line to a client."""
COMMAND_LIMIT: Final = 1000
"""Characters of a client's command line that are sent and recorded."""
MEMBER_ACTIONS: Final = ("start", "stop", "restart")
"""Operations on containers and processes."""
NODE_ACTIONS: Final = ("load", "unload", "reload")
"""Operations on composable nodes."""
ROS_VARIABLES: Final = (
    "ROS_",
    "RMW_",
    "RCUTILS_",
    "FASTRTPS_",
    "FASTDDS_",
    "CYCLONEDDS_",
    "ZENOH_",
)
"""Prefixes of the environment variables that decide how nodes behave and discover each other."""


class Code:
    """Kinds of errors in answers."""

    MALFORMED: Final = "malformed"
    """Not a request: the connection is closed."""
    TOO_LONG: Final = "too_long"
    PROTOCOL: Final = "protocol"
    """Another version of the protocol."""
    NOT_ALLOWED: Final = "not_allowed"
    UNKNOWN_OPERATION: Final = "unknown_operation"
    BAD_ARGUMENTS: Final = "bad_arguments"
    UNKNOWN_NAME: Final = "unknown_name"
    AMBIGUOUS_NAME: Final = "ambiguous_name"
    REFUSED: Final = "refused"
    """Not possible in the current state; nothing was changed."""
    FAILED: Final = "failed"
    """It was tried."""
    TIMEOUT: Final = "timeout"
    """It was not done in time, and continues."""
    INTERNAL: Final = "internal"


class OperationError(Exception):
    """A request was not carried out.

    Attributes:
        code: One of those of `Code`.
        details: Other fields of the error, for programs.
    """

    def __init__(self, code: str, message: str, **details: object) -> None:
        super().__init__(message)
        self.code = code
        self.details = details

    def as_object(self) -> dict[str, object]:
        return {"code": self.code, "message": str(self), **self.details}

    @classmethod
    def of(cls, found: object) -> OperationError:
        """Read what `as_object` returned; anything else is an internal error."""
        if not isinstance(found, dict):
            return cls(Code.INTERNAL, "an error without a description")
        details = {str(name): value for name, value in found.items()}
        error = cls(str(details.pop("code", Code.INTERNAL)), str(details.pop("message", "")))
        error.details = details
        return error


def encode(
    values: Mapping[str, object], default: Callable[[object], object] | None = None
) -> bytes:
    """Write one line in UTF-8, without lone surrogates and numbers that JSON does not have."""
    text = json.dumps(
        values, separators=(",", ":"), allow_nan=False, ensure_ascii=False, default=default
    )
    return text.encode("utf-8", "replace") + b"\n"


def decode(line: bytes) -> dict[str, Any]:
    """Read one line; raises OperationError when it is not a JSON object."""
    try:
        found = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise OperationError(Code.MALFORMED, f"not a line of JSON: {error}") from None
    if not isinstance(found, dict):
        raise OperationError(Code.MALFORMED, "not a JSON object")
    return found

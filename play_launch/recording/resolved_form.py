"""What is recorded and shown of a configuration and its run: without secrets put into it.

A file is recorded as it is. What it takes from outside, by `${env:NAME}` or an argument, is not in
it, and a value whose name sounds like a secret stays out of the recording.
"""

from __future__ import annotations

import re
import struct
import sys
from typing import TYPE_CHECKING, Any, Final

from msgspec.structs import replace

from play_launch.config.description import describe
from play_launch.config.tree import resolve_scalar
from play_launch.recording.environment import REDACTED, is_secret
from play_launch.supervisor.events import ActionEvent, ProcessEvent

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from play_launch.config.model import ReplayConfig
    from play_launch.supervisor.events import RunEvent

_SHORTEST: Final = 4
"""Characters; a shorter secret is recognised only where it is the whole value."""


def resolved_form(config: ReplayConfig) -> dict[str, object]:
    """Return what `describe` returns, without secrets."""
    values = describe(config)
    secrets = taken_secrets(config)
    if secrets:
        values = {key: without(value, secrets) for key, value in values.items()}
    return values


def taken_secrets(config: ReplayConfig) -> frozenset[str]:
    """Return the secret values that came from outside; of an included file's, too."""
    taken = (*config.taken.variables.items(), *config.taken.arguments.items())
    found = [value for name, value in taken if value and is_secret(name, value)]
    # A number is written in another way where it is passed on: 1234.50 as 1234.5.
    numbers = (number for number in map(_number, found) if number is not None)
    return frozenset((*found, *map(str, numbers)))


def redacted_arguments(argv: Sequence[str]) -> list[str]:
    """Return a command line without the values of arguments that sound like secrets."""
    redacted = []
    for word in argv:
        name, assigned, value = word.partition(":=")
        hidden = assigned and name.isidentifier() and is_secret(name, value)
        redacted.append(f"{name}:={REDACTED}" if hidden else word)
    return redacted


def without(value: Any, secrets: Collection[str]) -> Any:
    """Return plain values with `REDACTED` in place of the secrets."""
    if isinstance(value, str):
        if value in secrets:
            return REDACTED
        # The longest first, as one may hold another.
        for secret in sorted(secrets, key=len, reverse=True):
            if len(secret) >= _SHORTEST:
                value = value.replace(secret, REDACTED)
        return value
    if isinstance(value, dict):
        return {key: without(each, secrets) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [without(each, secrets) for each in value]
    if type(value) in {int, float} and value in map(_number, secrets):
        return REDACTED
    return value


def _number(secret: str) -> int | float | None:
    """Return the number that a configuration reads; None for none, and for short ones such as 0."""
    try:
        _, value = resolve_scalar(secret, None, plain=True)
    except ValueError:
        return None
    if not isinstance(value, int | float) or not abs(value) <= sys.float_info.max:
        return None
    return value if len(str(value)) >= _SHORTEST and not isinstance(value, bool) else None


def event_without(event: RunEvent, secrets: Collection[str]) -> RunEvent:
    """Return an event without the secrets in command lines."""
    match event:
        case ProcessEvent():
            return replace(event, command=tuple(without(event.command, secrets)))
        case ActionEvent():
            command, reason = without((event.command, event.reason), secrets)
            return replace(event, command=command, reason=reason)
        case _:
            return event


def in_messages(secrets: Collection[str]) -> re.Pattern[bytes] | None:
    """Return what finds secrets in messages about parameters; None without any."""
    found = []
    for secret in sorted(secrets, key=len, reverse=True):  # as one may hold another
        text = secret.encode("utf-8", "surrogateescape")
        if len(secret) < _SHORTEST:
            length = re.escape(struct.pack("<I", len(text) + 1))
            found.append(b"(?<=%b)%b(?=\\0)" % (length, re.escape(text)))
            continue
        found.append(re.escape(text))
        number = _number(secret)
        if isinstance(number, int) and -(1 << 63) <= number < 1 << 63:
            found.append(re.escape(struct.pack("<q", number)))
        if number is not None:
            found.append(re.escape(struct.pack("<d", number)))
    return re.compile(b"|".join(found)) if found else None


def kept(taken: Mapping[str, object]) -> dict[str, str]:
    """Return the values of a recording that were there and were not taken out of it."""
    return {
        name: value
        for name, value in taken.items()
        if isinstance(value, str) and REDACTED not in value
    }

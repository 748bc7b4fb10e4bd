"""A configuration as plain values for JSON, for `check --json` and the recording."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from enum import Enum, IntEnum
from pathlib import Path
from typing import Any, Final

_LEFT_OUT: Final = frozenset({"text"})
"""The file as given; it stands beside the resolved configuration wherever this goes."""


def describe(value: object) -> Any:
    """Turn a configuration, or a part of it, into dicts, lists and scalars.

    Enumerations become their value, numbered ones their name in small letters; bytes become a list
    of numbers; infinities and NaN, which JSON does not have, become text.
    """
    if isinstance(value, IntEnum):
        return value.name.lower()
    if isinstance(value, Enum):
        return value.value
    if dataclasses.is_dataclass(value):
        return {
            field.name: describe(getattr(value, field.name))
            for field in dataclasses.fields(value)
            if field.name not in _LEFT_OUT
        }
    if isinstance(value, Mapping):
        return {str(key): describe(each) for key, each in value.items()}
    if isinstance(value, (tuple, list, bytes)):
        return [describe(each) for each in value]
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value

"""Lengths of time as people write them: `250 ms`, `1.5 s`, `2 min`; a number alone is seconds."""

from __future__ import annotations

import math
import re

from play_launch.config.problems import excerpt

LONGEST_DURATION = 365 * 24 * 3600.0
"""Seconds. Longer waits overflow timers, and nobody means them."""

_SECONDS = {"us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}
_DURATION = re.compile(r"([-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+))\s*([^\W\d_]+)?", re.ASCII)
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
    if number > LONGEST_DURATION or math.isnan(number):
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
    found = _DURATION.fullmatch(text) if len(text) <= _LONGEST_TEXT else None
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

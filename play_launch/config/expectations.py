"""What is expected of a topic while the system runs."""

from __future__ import annotations

import math
from enum import StrEnum

from msgspec import Struct


class Reliability(StrEnum):
    """Whether publishers of a topic deliver every message."""

    RELIABLE = "reliable"
    BEST_EFFORT = "best_effort"


class Durability(StrEnum):
    """Whether publishers of a topic keep messages for subscriptions that come later."""

    TRANSIENT_LOCAL = "transient_local"
    VOLATILE = "volatile"


class Expectation(Struct, frozen=True, kw_only=True):
    """What is expected of one topic; what is not given may be anything.

    Rates are messages per second of all its publishers together, `max_gap` is seconds between two
    messages. It is measured on `machine`.
    """

    topic: str
    machine: str = ""
    type: str = ""
    min_rate: float = 0.0
    max_rate: float = math.inf
    max_gap: float = math.inf
    publishers: int | None = None
    reliability: Reliability | None = None
    durability: Durability | None = None

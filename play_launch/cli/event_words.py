"""Lines of `events` and `logs`."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from play_launch.cli.show.terminal import printable

if TYPE_CHECKING:
    from collections.abc import Mapping


def lines_of(event: Mapping[str, Any]) -> str:
    """Write an event of the control socket; a text of several lines stays."""
    source = str(event["source"])
    text = str(event["text"]) + (" [cut]" if event.get("truncated") else "")
    clean = printable(text, colour=False).replace("\n", f"\n{' ' * 13}")
    return f"{clock(event.get('stamp_ns', 0))} [{printable(source, colour=False)}] {clean}"


def clock(stamp_ns: int) -> str:
    """Write the local time of day to the millisecond."""
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    return f"{time.strftime('%H:%M:%S', time.localtime(seconds))}.{rest // 1_000_000:03}"

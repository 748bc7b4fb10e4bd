"""Whether a process got the resources that the configuration gives it."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from play_launch.core.resource_check import shortfalls
from play_launch.process.resources import held_resources

if TYPE_CHECKING:
    from play_launch.actors.publisher import Publisher
    from play_launch.core.resources import Resources

_log = logging.getLogger(__name__)


def report_shortfalls(name: str, wanted: Resources, pid: int, publisher: Publisher) -> None:
    """Report once each resource that the kernel refused; the process runs without it."""
    if not wanted or not pid:
        return
    held = held_resources(pid, wanted.limit_names)
    if held is None:  # it has ended, which is reported anyway
        return
    for shortfall in shortfalls(wanted, held):
        text = f"{name}: {shortfall}"
        if publisher.is_news(text):
            _log.warning("%s", text)

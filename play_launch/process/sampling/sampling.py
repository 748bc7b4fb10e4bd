"""Task that samples a running system."""

from __future__ import annotations

import asyncio
import logging
import time
from functools import partial
from typing import TYPE_CHECKING, Final, TypeVar

from play_launch.process.descendants import in_a_thread
from play_launch.process.sampling.groups import GroupSampler
from play_launch.process.sampling.machine import MachineSampler
from play_launch.process.sampling.processes import Sampler, targets

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from play_launch.supervisor.events import RunEvent, Sample
    from play_launch.supervisor.view import SystemView

_Result = TypeVar("_Result")

_log = logging.getLogger(__name__)
_REPORT_AFTER: Final = 10.0
"""Seconds."""


async def sample(
    view: Callable[[], SystemView],
    publish: Callable[[RunEvent], None],
    *,
    period: float,
    folder: Path,
) -> None:
    """Publish samples every `period` seconds until cancelled.

    They are taken in a thread. A late one, after SIGSTOP for example, shifts those after it.
    `folder` is that of the recording.
    """
    loop = asyncio.get_running_loop()
    has_failed = False
    try:
        machine, sampler = await _taken(lambda: MachineSampler(folder)), Sampler()
        groups = GroupSampler()
        due = loop.time() + period
        while True:
            await asyncio.sleep(due - loop.time())
            due = next_due(due, loop.time(), period)
            try:
                samples, news = await _taken(partial(_measure, machine, sampler, groups, view()))
            except OSError as error:  # for example EMFILE
                if not has_failed:
                    _log.warning("samples are missing: %s", error)
                has_failed = True
                continue
            for each in samples:
                publish(each)
            for text in news:
                _log.warning("%s", text)
    except Exception as error:  # noqa: BLE001 - the run must go on whatever this kernel answers
        _log.warning(
            "processes and the machine are not sampled: %s: %s", type(error).__name__, error
        )


def next_due(due: float, now: float, period: float) -> float:
    """Return the time of the next sample, after one that was due at `due` and is taken `now`."""
    return max(due, now - period / 2) + period


def _measure(
    machine: MachineSampler, sampler: Sampler, groups: GroupSampler, view: SystemView
) -> tuple[list[Sample], list[str]]:
    """Return samples and warnings."""
    stamp_ns = time.time_ns()
    processes = targets(view)
    of_groups, news = groups.sample(processes, stamp_ns)
    samples: list[Sample] = [
        machine.sample(stamp_ns),
        *sampler.sample(processes, stamp_ns),
        *of_groups,
    ]
    return samples, news


async def _taken(work: Callable[[], _Result]) -> _Result:
    taken = in_a_thread(work)
    await asyncio.wait([taken], timeout=_REPORT_AFTER)
    if not taken.done():
        _log.warning("a sample takes longer than %g s: a process does not answer", _REPORT_AFTER)
    return await taken

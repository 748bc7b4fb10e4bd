"""Samples a running system beside its event loop."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
import time
from functools import partial
from typing import TYPE_CHECKING, Final, TypeVar

from play_launch.process.sampling.groups import GroupSampler
from play_launch.process.sampling.machine_usage import Machine
from play_launch.process.sampling.sampler import Sampler
from play_launch.process.sampling.targets import targets

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from play_launch.supervisor.events import RunEvent, Sample
    from play_launch.supervisor.view import SystemView

_Result = TypeVar("_Result")

_log = logging.getLogger(__name__)
_LONGEST: Final = 10.0
"""Seconds after which a measurement that does not end is reported."""


async def sample(
    view: Callable[[], SystemView],
    publish: Callable[[RunEvent], None],
    *,
    period: float,
    folder: Path,
) -> None:
    """Publish samples every `period` seconds until cancelled.

    They are taken in a thread, and published in the loop's. A measurement that comes late, because
    the program was stopped or the machine is busy, shifts those after it: none is made up for.

    Args:
        view: Gives the system as it stands.
        publish: Takes the samples.
        period: Seconds.
        folder: Where the recording is written.
    """
    loop = asyncio.get_running_loop()
    has_failed = False
    try:
        machine, sampler = await _in_a_thread(lambda: Machine(folder)), Sampler()
        groups = GroupSampler()
        due = loop.time() + period
        while True:
            await asyncio.sleep(due - loop.time())
            due = next_due(due, loop.time(), period)
            try:
                samples, news = await _in_a_thread(
                    partial(_measure, machine, sampler, groups, view())
                )
            except OSError as error:  # no descriptor is free, perhaps
                if not has_failed:
                    _log.warning("there are samples missing: %s", error)
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
    """When the next sample is due, if one that was due at `due` is taken `now`."""
    return max(due, now - period / 2) + period


def _measure(
    machine: Machine, sampler: Sampler, groups: GroupSampler, view: SystemView
) -> tuple[list[Sample], list[str]]:
    """Give samples, and what is worth a warning."""
    stamp_ns = time.time_ns()
    processes = targets(view)
    of_groups, news = groups.sample(processes, stamp_ns)
    samples: list[Sample] = [
        machine.sample(stamp_ns),
        *sampler.sample(processes, stamp_ns),
        *of_groups,
    ]
    return samples, news


async def _in_a_thread(work: Callable[[], _Result]) -> _Result:
    """Run it in a thread that nothing waits for at the end.

    The kernel may keep a reader of ``/proc`` waiting for as long as the process is stuck itself; an
    executor's thread would then keep the program from ending.
    """
    loop = asyncio.get_running_loop()
    done: asyncio.Future[_Result] = loop.create_future()

    def run() -> None:
        try:
            settle = partial(done.set_result, work())
        except Exception as error:  # noqa: BLE001 - it is raised where it is awaited
            settle = partial(done.set_exception, error)
        with contextlib.suppress(RuntimeError):  # the loop is closed: nobody awaits it any more
            loop.call_soon_threadsafe(lambda: None if done.done() else settle())

    threading.Thread(target=run, name="sampling", daemon=True).start()
    await asyncio.wait([done], timeout=_LONGEST)
    if not done.done():
        _log.warning("a sample takes longer than %g s: a process does not answer", _LONGEST)
    return await done

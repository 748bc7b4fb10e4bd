"""The real command with a scripted system instead of processes: ``python -m`` this.

The system has one container. What its node prints and how it ends comes from the environment
variable ``STUB``: words out of ``deaf`` (ends on the second request only), ``flood`` (prints
without end), ``slow`` (a second node never loads), ``ends`` (exits on its own), ``failing``,
``troubled`` (Python has something to report).
"""

from __future__ import annotations

import asyncio
import os
import sys
import threading
import time
import types
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

from play_launch.cli.app import main
from play_launch.config.node_key import NodeKey
from play_launch.supervisor.events import (
    ContainerState,
    ContainerStateChanged,
    NodeState,
    NodeStateChanged,
    OutputLine,
    Stream,
)
from play_launch.supervisor.view import SystemView, exit_code

if TYPE_CHECKING:
    from play_launch.config.model import ReplayConfig
    from play_launch.runtime.publisher import Publisher
    from play_launch.runtime.signals import StopRequests


@dataclass(frozen=True)
class Outcome:
    """As that of the real one, as far as the command looks."""

    exit_code: int
    view: SystemView
    final_view: SystemView


class BadEnd:
    """Cannot be destroyed without an error."""

    def __del__(self) -> None:
        raise ValueError("destructor failed")


async def trouble() -> None:
    def fail(what: str) -> None:
        raise ValueError(f"{what} failed")

    asyncio.get_running_loop().call_soon(fail, "callback")
    BadEnd()
    thread = threading.Thread(target=fail, args=("thread",))
    thread.start()
    thread.join()
    warnings.warn("about to fail", UserWarning, stacklevel=1)
    task = asyncio.create_task(asyncio.to_thread(fail, "task"))
    await asyncio.wait({task})


async def run_system(
    config: ReplayConfig, publisher: Publisher, stop: StopRequests, **_ignored: object
) -> Outcome:
    script = os.environ.get("STUB", "").split()

    def say(text: str) -> None:
        publisher.publish(
            OutputLine(
                stamp_ns=time.time_ns(), process="/c", pid=1, stream=Stream.STDOUT, text=text
            )
        )

    publisher.publish(
        ContainerStateChanged(stamp_ns=time.time_ns(), container="/c", state=ContainerState.RUNNING)
    )
    states = [NodeState.LOADED]
    if "slow" in script:
        states.append(NodeState.LOADING)
    if "failing" in script:
        states.append(NodeState.LOAD_FAILED)
    for index, state in enumerate(states):
        publisher.publish(
            NodeStateChanged(stamp_ns=time.time_ns(), key=NodeKey("/c", f"/n{index}"), state=state)
        )
    say("node is up")
    if "troubled" in script:
        await trouble()
    while "flood" in script and not stop.requested.is_set():
        for _ in range(100):
            say("flood " * 20)
        await asyncio.sleep(0)
    if "ends" not in script:
        try:
            async with asyncio.timeout(config.duration):
                await stop.requested.wait()
        except TimeoutError:
            say("time is over")
    if "deaf" in script:
        say("deaf to the first request")
        await stop.hurry.wait()
    view = publisher.view
    return Outcome(exit_code=exit_code(view, view, stop.signum), view=view, final_view=view)


if __name__ == "__main__":
    stand_in = types.ModuleType("play_launch.runtime.run")
    stand_in.run_system = run_system  # type: ignore[attr-defined]
    sys.modules[stand_in.__name__] = stand_in
    main()

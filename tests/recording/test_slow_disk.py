"""Topics come at twice the speed of the disk, and the recorder is killed: its events are there."""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap
from typing import TYPE_CHECKING

from play_launch.recording.topics import LOG_ALL
from tests.recording.reading import raw_messages

if TYPE_CHECKING:
    from pathlib import Path

PROMISED = 0.25
"""Seconds of events that a SIGKILL may cost, see docs/recording.md."""
KILLS = 5
PROGRAM = """
    import itertools, os, sys, threading, time
    from pathlib import Path
    from play_launch.recording.bag import BagWriter
    from play_launch.recording.recorder import Recorder
    from play_launch.supervisor.events import LogRecord
    from tests.recording.test_topic_chunks import chunk_of

    SPEED, SIZE = 20e6, 1 << 20  # of the disk, bytes a second; of a chunk of topics

    def note(kind, number):  # in one piece, from whichever thread
        os.write(1, f"{kind} {number} {time.monotonic()}\\n".encode())

    def slow(function):
        def throttled(*arguments):
            count = function(*arguments)
            time.sleep(count / SPEED)
            return count
        return throttled

    os.sendfile, os.pwrite = slow(os.sendfile), slow(os.pwrite)
    recorder = Recorder(BagWriter(Path(sys.argv[1])))
    channels, answered, room = [], threading.Event(), threading.Semaphore(64)
    recorder.open_channel("/camera", "rcl_interfaces/msg/Log", "", channels.append)
    recorder.after_these(answered.set)
    answered.wait()
    written = itertools.count(1)

    def done():
        note("chunk", next(written))
        room.release()

    def send():
        while True:
            room.acquire()  # 64 MiB are under way, as from `topic_recorder`
            recorder.append_chunk(chunk_of([(channels[0], 1, bytes(SIZE))]), done)
            time.sleep(SIZE / SPEED / 2)

    threading.Thread(target=send, daemon=True).start()
    for number in itertools.count(1):
        note("event", number)
        recorder.publish(LogRecord(stamp_ns=number, level=20, name="n", message="x"))
        time.sleep(0.005)
"""


def lost_by_a_kill(path: Path, chunks: int) -> float:
    """Kill the recorder after so many chunks; return how many seconds of events are missing."""
    command = [sys.executable, "-c", textwrap.dedent(PROGRAM), str(path)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    published: dict[int, float] = {}
    with process.stdout as output:
        for line in output:
            kind, number, at = line.split()
            if kind == "event":
                published[int(number)] = float(at)
            elif int(number) == chunks:
                break
        process.send_signal(signal.SIGKILL)
        for line in output:
            if line.startswith("event") and line.endswith("\n"):
                published[int(line.split()[1])] = float(line.split()[2])
        process.wait()
    found = [
        message.publish_time
        for message in raw_messages(path.with_name(path.name + ".active"), LOG_ALL.name)
    ]
    assert found == list(range(1, len(found) + 1)), "nothing is missing before the end"
    return published[max(published)] - published[found[-1]]


def test_a_kill_costs_a_quarter_of_a_second_of_events(tmp_path: Path) -> None:
    lost = [lost_by_a_kill(tmp_path / f"{chunks}.mcap", chunks) for chunks in range(20, 20 + KILLS)]
    # All events would be missing if they waited for topics: these never end. One kill may find the
    # recorder without a processor, on a machine that does other things.
    assert sorted(lost)[-2] <= PROMISED, lost

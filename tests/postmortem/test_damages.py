"""Cut and flipped anywhere, a recording gives what can be read, or says where it cannot.

Each verb that reads a recording has a line in `VERBS`.
"""

from __future__ import annotations

import contextlib
import io
import os
import random
import re
import signal
import struct
import subprocess
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pytest
import zstandard
from mcap.opcode import Opcode
from msgspec.structs import replace

from play_launch import UserError
from play_launch.cli.compare import compare
from play_launch.cli.explain import explain
from play_launch.cli.info import info
from play_launch.cli.inspect import inspect
from play_launch.cli.recover import recover
from play_launch.cli.report import report as write_report
from play_launch.container.cdr.messages import PROCESS_STATS
from play_launch.postmortem.bag_reader import BagReader
from play_launch.postmortem.recover import write_whole
from play_launch.recording import folder, topics
from play_launch.recording.bag import BagWriter
from play_launch.recording.forms import convert
from play_launch.supervisor.events import (
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
    RunEvent,
    Stream,
    SubjectKind,
)
from tests.cli.test_past_sessions import EVENTS
from tests.support.replay import COMMAND

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

PARTIAL = 5
NOTHING = {1, 2}
LONGEST = 20
"""Seconds for one reading of a small file; more is a hang."""
STEP = 1000


class Verb(NamedTuple):
    """How a verb is called here, and on the command line."""

    run: Callable[[Path, Path], int]
    """Takes the recording and a path for its output; returns the exit code, or ends with it."""
    words: Callable[[Path, Path], Sequence[object]]


def but_for_findings(code: int) -> int:
    """A fault of the session is no damage of its recording."""
    return 0 if code == 1 else code


VERBS = {
    "info": Verb(
        lambda bag, _: info(bag, as_json=False),
        lambda bag, _: ("info", bag),
    ),
    "info --json": Verb(
        lambda bag, _: info(bag, as_json=True),
        lambda bag, _: ("info", "--json", bag),
    ),
    "inspect": Verb(
        lambda bag, _: inspect(bag, level="debug", as_json=False),
        lambda bag, _: ("inspect", "--level", "debug", bag),
    ),
    "inspect --json": Verb(
        lambda bag, _: inspect(bag, level="debug", as_json=True),
        lambda bag, _: ("inspect", "--json", bag),
    ),
    "explain": Verb(
        lambda bag, _: but_for_findings(explain(bag, as_json=False)),
        lambda bag, _: ("explain", bag),
    ),
    "explain --json": Verb(
        lambda bag, _: but_for_findings(explain(bag, as_json=True)),
        lambda bag, _: ("explain", "--json", bag),
    ),
    "compare": Verb(
        lambda bag, _: compare(bag, bag, as_json=False),
        lambda bag, _: ("compare", bag, bag),
    ),
    "report": Verb(
        write_report,
        lambda bag, output: ("report", bag, "-o", output),
    ),
    "recover": Verb(
        recover,
        lambda bag, output: ("recover", bag, "-o", output),
    ),
}


@cache
def recording() -> bytes:
    """A small session with everything that a recording has, in many chunks."""
    import tempfile

    noise = random.Random(7)
    with tempfile.TemporaryDirectory() as folder:
        writer = BagWriter(Path(folder) / "session.mcap")
        for name in ("config.yaml", "resolved_config.json", "host.json"):
            writer.attach(name, "application/json", b'{"name": "demo"}' * 20, time=1)
        writer.metadata("play_launch.session", {"id": "1", "name": "demo", "started_ns": "1000"})
        channels = {topic: writer.register(topic) for topic in topics.ALL_TOPICS}
        stamp = 1000
        for _ in range(12):
            lines: list[RunEvent] = [
                OutputLine(
                    stamp_ns=stamp,
                    process="/box",
                    pid=7,
                    stream=Stream.STDERR,
                    text=noise.randbytes(200).hex(),
                )
                for _ in range(12)
            ]
            exited = ProcessEvent(
                stamp_ns=stamp, kind=ProcessEventKind.EXITED, name="/box", pid=4711, signal=11
            )
            for event in (*EVENTS, *lines, replace(exited, stamp_ns=stamp)):
                stamp += 1_000_000
                for topic, data, key in convert(event):
                    writer.write(channels[topic], data, log_time=stamp, publish_time=stamp, key=key)
            writer.flush()
        writer.close()
        return writer.path.read_bytes()


class Result(NamedTuple):
    code: int
    output: str
    errors: str


@contextlib.contextmanager
def no_hang() -> Iterator[None]:
    def hangs(_number: int, _frame: object) -> None:
        raise AssertionError(f"takes more than {LONGEST} s")

    before = signal.signal(signal.SIGALRM, hangs)
    signal.alarm(LONGEST)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def call(verb: str, data: bytes, folder: Path) -> Result:
    bag, made = folder / "session.mcap.active", folder / "made"
    bag.write_bytes(data)
    made.unlink(missing_ok=True)
    output, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors), no_hang():
        try:
            code = VERBS[verb].run(bag, made)
        except SystemExit as end:
            code = int(end.code or 0)
        except UserError as error:
            code = error.exit_code
            errors.write(f"error: {error}\n")
    return Result(code, output.getvalue(), errors.getvalue())


def assert_in_order(result: Result, folder: Path) -> None:
    bag = str(folder / "session.mcap.active")
    assert result.code in {0, PARTIAL, *NOTHING}
    if result.code == 0:
        assert result.errors == ""
    elif result.code == PARTIAL:
        lines = result.errors.splitlines()
        assert lines
        for line in lines:
            assert line.startswith(f"warning: {bag}: ")
            assert "byte " in line or "not closed in order" in line
    else:
        assert result.errors.startswith(f"error: {bag}: ")
        assert result.errors.count("\n") == 1


@pytest.mark.parametrize("verb", VERBS)
def test_a_whole_recording_is_no_problem(verb: str, tmp_path: Path) -> None:
    assert len(recording()) > 30 * STEP
    result = call(verb, recording(), tmp_path)
    assert (result.code, result.errors) == (0, "")
    assert result.output


@pytest.mark.parametrize("verb", [verb for verb in VERBS if "--json" not in verb])
def test_cut_at_every_thousandth_byte(verb: str, tmp_path: Path) -> None:
    whole = recording()
    for length in (*range(0, len(whole), STEP), len(whole) - 1):
        result = call(verb, whole[:length], tmp_path)
        assert_in_order(result, tmp_path)
        if length == 0:
            assert result.code in NOTHING
        elif verb == "recover":
            # What ends between two records has lost nothing that was there.
            assert result.code in {0, PARTIAL}
        else:
            assert result.code == PARTIAL


@pytest.mark.parametrize("verb", VERBS)
def test_bits_flipped_anywhere(verb: str, tmp_path: Path) -> None:
    whole = recording()
    random_ = random.Random(5)
    intact = call(verb, whole, tmp_path)
    for begin in range(0, len(whole), STEP):
        at = random_.randrange(begin, min(begin + STEP, len(whole)))
        data = bytearray(whole)
        data[at] ^= 1 << random_.randrange(8)
        result = call(verb, bytes(data), tmp_path)
        assert_in_order(result, tmp_path)
        if result.code == 0 and verb == "inspect":
            assert result.output == intact.output, f"byte {at} is wrong, unnoticed"


def first_record(kind: int) -> int:
    """Where the first record of a kind stands."""
    whole, at = recording(), 8
    while whole[at] != kind:
        at += 9 + int.from_bytes(whole[at + 1 : at + 9], "little")
    return at


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize("kind", [3, 4, 6, 7, 9, 12, 15], ids=lambda kind: Opcode(kind).name)
def test_a_record_that_says_it_is_another_one(verb: str, kind: int, tmp_path: Path) -> None:
    for bit in range(8):
        data = bytearray(recording())
        data[first_record(kind)] ^= 1 << bit
        result = call(verb, bytes(data), tmp_path)
        assert_in_order(result, tmp_path)
        assert result.code == PARTIAL, f"bit {bit}"


@pytest.mark.parametrize("verb", VERBS)
def test_noise_after_the_first_bytes(verb: str, tmp_path: Path) -> None:
    random_ = random.Random(3)
    for _ in range(20):
        data = recording()[: random_.randrange(8, 2000)] + random_.randbytes(3000)
        result = call(verb, data, tmp_path)
        assert_in_order(result, tmp_path)
        assert result.code == PARTIAL


@pytest.mark.parametrize("verb", [verb for verb in VERBS if "--json" not in verb])
def test_the_real_commands(verb: str, tmp_path: Path) -> None:
    whole = recording()
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 0x10
    bag, made = tmp_path / "session.mcap.active", tmp_path / "made"
    for data, code in ((whole[: len(whole) // 2], PARTIAL), (bytes(flipped), PARTIAL), (b"", None)):
        bag.write_bytes(data)
        made.unlink(missing_ok=True)
        done = subprocess.run(
            [str(COMMAND), *map(os.fspath, map(str, VERBS[verb].words(bag, made)))],
            capture_output=True,
            text=True,
            check=False,
            timeout=60,
        )
        assert_in_order(Result(done.returncode, done.stdout, done.stderr), tmp_path)
        assert done.returncode == code or (code is None and done.returncode in NOTHING)


def chunks() -> list[int]:
    """Where the chunks stand."""
    whole, at, found = recording(), 8, []
    while whole[at] != Opcode.DATA_END:
        if whole[at] == Opcode.CHUNK:
            found.append(at)
        at += 9 + int.from_bytes(whole[at + 1 : at + 9], "little")
    return found


def _with(at: int, new: bytes) -> bytes:
    return recording()[:at] + new + recording()[at + len(new) :]


def _chunk_of_zeros() -> bytes:
    zeros = bytes(50_000_000)
    data = zstandard.compress(zeros)
    head = struct.pack("<QQQII", 0, 0, len(zeros), 0, 4) + b"zstd" + struct.pack("<Q", len(data))
    return struct.pack("<BQ", Opcode.CHUNK, len(head + data)) + head + data


def _name_of_a_channel() -> int:
    return recording().index(b"/play_launch/", first_record(Opcode.CHANNEL))


class Damaged(NamedTuple):
    """What was done to a recording, and what is read of it then."""

    make: Callable[[], bytes]
    offset: Callable[[], int]
    """Of the one damage."""
    reason: str
    lost: Callable[[int], bool]
    """Whether a chunk is, by its number."""


DAMAGES = {
    "a chunk with a wrong byte": Damaged(
        lambda: _with(chunks()[2] + 100, bytes([recording()[chunks()[2] + 100] ^ 1])),
        lambda: chunks()[2],
        "a chunk cannot be decompressed|the checksum of a chunk is wrong",
        lambda number: number == 2,
    ),
    "a chunk that is another record": Damaged(
        lambda: _with(chunks()[2], b"\x7f"),
        lambda: chunks()[2],
        "no record of kind 0x7f can stand here",
        lambda number: number == 2,
    ),
    "a chunk with a wrong length": Damaged(
        lambda: _with(chunks()[2] + 4, b"\x01"),
        lambda: chunks()[2],
        r"its length \(\d+ bytes\) is wrong; [\d,]+ bytes are not read",
        lambda number: number >= 2,
    ),
    "a record beyond the limit of its kind": Damaged(
        lambda: _with(chunks()[2], struct.pack("<BQ", Opcode.METADATA, 1 << 25)) + bytes(1 << 25),
        lambda: chunks()[2],
        "its length .33554432 bytes. is wrong",
        lambda number: number >= 2,
    ),
    "cut within a chunk": Damaged(
        lambda: recording()[: chunks()[5] + 40],
        lambda: chunks()[5],
        "the file ends within a record",
        lambda number: number >= 5,
    ),
    "zeros in a chunk": Damaged(
        lambda: recording()[: chunks()[3]] + _chunk_of_zeros() + recording()[chunks()[3] :],
        lambda: chunks()[3],
        "no record of kind 0x00 can stand here",
        lambda _: False,
    ),
    # A file system may have grown a file whose blocks were not written when the power failed.
    "zeros at the end": Damaged(
        lambda: recording()[: chunks()[5]] + bytes(3_000_000),
        lambda: chunks()[5],
        "its length .0 bytes. is wrong; 3,000,000 bytes are not read",
        lambda number: number >= 5,
    ),
    # Such a record has no checksum; nothing would have happened on its topic.
    "a wrong letter in the name of a channel": Damaged(
        lambda: _with(_name_of_a_channel(), b"."),
        lambda: first_record(Opcode.DATA_END),
        "is not described as in the summary",
        lambda _: False,
    ),
}


@pytest.mark.parametrize("what", DAMAGES)
def test_a_damage_costs_what_is_in_it(what: str, tmp_path: Path) -> None:
    damage, path = DAMAGES[what], tmp_path / "session.mcap.active"
    path.write_bytes(recording())
    reader = BagReader(path)
    before = [(reader.offset, message.data) for message in reader.messages()]
    numbers = {offset: number for number, offset in enumerate(chunks())}
    expected = [data for offset, data in before if not damage.lost(numbers[offset])]
    path.write_bytes(damage.make())
    reader = BagReader(path)
    assert [each.data for each in reader.messages()] == expected
    assert reader.damages[0].offset == damage.offset()
    assert re.search(damage.reason, reader.damages[0].reason)
    assert len([each for each in reader.damages if each.offset < chunks()[-1]]) <= 1
    assert not reader.is_complete or reader.damages
    recovered = write_whole(path, tmp_path / "whole.mcap")
    assert (recovered.messages, recovered.reader.damages) == (len(expected), reader.damages)
    again = BagReader(recovered.path)
    assert [each.data for each in again.messages()] == expected
    assert (again.is_complete, again.damages) == (True, [])


def test_a_file_that_is_cut_while_it_is_read_ends_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A full disk, or another program.
    monkeypatch.setattr(folder, "_BUFFER", 1 << 12)
    path = tmp_path / "session.mcap.active"
    path.write_bytes(recording())
    reader = BagReader(path)
    messages = reader.messages()
    next(messages)
    os.truncate(path, chunks()[2] + 20)
    assert sum(1 for _ in messages) > 0
    assert reader.damages[0].offset == chunks()[2]
    assert not reader.is_complete


@pytest.mark.parametrize("verb", [verb for verb in VERBS if "--json" not in verb])
def test_times_that_no_clock_shows(verb: str, tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "session.mcap")
    writer.metadata("play_launch.session", {"id": "1", "name": "demo", "started_ns": "1000"})
    channel = writer.register(topics.stats_topic(SubjectKind.PROCESS, "/a"))
    for time in (1 << 63, (1 << 64) - 1):
        writer.write(channel, PROCESS_STATS.write({}), log_time=time, publish_time=time)
        writer.flush()
    writer.close()
    result = call(verb, writer.path.read_bytes(), tmp_path)
    assert (result.code, result.errors) == (0, "")

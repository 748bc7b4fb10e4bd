"""Output as whole lines."""

from __future__ import annotations

import asyncio
import os
import re
import time
from collections import Counter
from collections.abc import Sequence
from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.process.lines import Line, LineReader, LineSplitter

LIMIT = 12
# Much of what matters: line ends of all kinds, long lines, characters of every length, rubbish.
PIECES = st.lists(
    st.one_of(
        st.sampled_from([b"\n", b"\r", b"\r\n", b"\n\r", b"\xff", b"\xc3", b"\xe2\x82", b""]),
        st.text("a€ü😀", max_size=8).map(str.encode),
        st.binary(max_size=6),
    ),
    max_size=30,
)


def split(pieces: Sequence[bytes], limit: int) -> list[Line]:
    splitter = LineSplitter(limit)
    lines = [line for piece in pieces for line in splitter.feed(piece)]
    return lines + splitter.finish()


@given(PIECES)
def test_lines_do_not_depend_on_how_the_bytes_arrive(pieces: list[bytes]) -> None:
    whole = b"".join(pieces)
    expected = split([whole], LIMIT)
    assert split(pieces, LIMIT) == expected
    assert split([bytes((byte,)) for byte in whole], LIMIT) == expected


@given(PIECES)
def test_every_line_arrives_once_and_in_order(pieces: list[bytes]) -> None:
    whole = b"".join(pieces)
    expected = re.split(b"\r\n|\n|\r", whole)
    if not expected[-1]:
        expected.pop()
    lines = split(pieces, 10_000)
    assert [line.text for line in lines] == [part.decode(errors="replace") for part in expected]
    assert not any(line.truncated for line in lines)
    for line, part in zip(split(pieces, LIMIT), expected, strict=True):
        assert line.truncated == (len(part) > LIMIT)
        # A character cut in the middle would have become a replacement character.
        clean = part.decode(errors="replace")
        if "\ufffd" not in clean:
            assert clean.startswith(line.text)
            assert len(line.text.encode()) > min(len(part), LIMIT) - 4


def test_a_long_line_is_cut_when_it_grows_too_long_not_when_it_ends() -> None:
    splitter = LineSplitter(4)
    assert splitter.feed(b"abc") == []
    assert splitter.feed(b"defg") == [Line("abcd", truncated=True)]
    assert splitter.feed(b"h" * 100_000) == []
    assert splitter.feed(b"ij\nnext\n") == [Line("next")]
    assert splitter.finish() == []


def test_a_return_is_not_held_back() -> None:
    splitter = LineSplitter()
    assert splitter.feed(b"10 %\r") == [Line("10 %")]
    assert splitter.feed(b"\n") == []
    assert splitter.feed(b"\n20 %") == [Line("")]
    assert splitter.finish() == [Line("20 %")]


pytestmark = pytest.mark.anyio


async def test_a_pipe_is_read_to_its_end() -> None:
    read_end, write_end = os.pipe()
    batches: list[list[Line]] = []
    reader = LineReader(read_end, lambda lines: batches.append(list(lines)))
    count = 60_000
    data = b"".join(b"line %d of the output of a node\n" % number for number in range(count))

    def write() -> None:
        with os.fdopen(write_end, "wb") as pipe:
            pipe.write(data + b"the end")

    await asyncio.to_thread(write)
    await reader.wait_end()
    lines = [line.text for batch in batches for line in batch]
    assert len(lines) == count + 1
    assert lines[-1] == "the end"
    assert lines[:-1] == data.decode().splitlines()
    assert len(batches) < count / 10
    assert not reader.is_open


async def test_a_pipe_that_stays_open_is_given_up() -> None:
    read_end, write_end = os.pipe()
    lines: list[Line] = []
    reader = LineReader(read_end, lines.extend)
    os.write(write_end, b"whole\nhalf")
    reader.close()
    reader.close()
    assert lines == [Line("whole"), Line("half")]
    await reader.wait_end()
    with pytest.raises(BrokenPipeError):
        os.write(write_end, b"x")
    os.close(write_end)


async def test_chatterboxes_leave_the_loop_a_third_of_its_time_and_take_turns() -> None:
    pipes = [os.pipe() for _ in range(3)]
    busy = 0.0
    batches: Counter[int] = Counter()

    def take(write_end: int, lines: Sequence[Line]) -> None:
        nonlocal busy
        began = time.monotonic()
        os.write(write_end, b"y\n" * len(lines))
        while time.monotonic() - began < 0.01:
            pass  # as sinks that have much to do
        busy += time.monotonic() - began
        batches[write_end] += 1

    readers = [LineReader(read_end, partial(take, write_end)) for read_end, write_end in pipes]
    for _, write_end in pipes:
        os.set_blocking(write_end, False)
        os.write(write_end, b"y\n" * 1000)
    began = time.monotonic()
    async with asyncio.timeout(20):
        while batches.total() < 30:
            await asyncio.sleep(0)
    assert busy / (time.monotonic() - began) < 0.8
    assert set(batches.values()) == {10}
    for reader, (_, write_end) in zip(readers, pipes, strict=True):
        reader.close()
        os.close(write_end)


async def test_a_chatterbox_does_not_keep_the_loop() -> None:
    read_end, write_end = os.pipe()
    os.set_blocking(write_end, False)
    got = 0

    def count(lines: Sequence[Line]) -> None:
        nonlocal got
        got += len(lines)
        # Refilled at once: the reader would never find the pipe empty.
        os.write(write_end, b"y\n" * 1000)

    reader = LineReader(read_end, count)
    os.write(write_end, b"y\n" * 1000)
    for _ in range(20):
        await asyncio.sleep(0)
    assert got >= 1000
    reader.close()
    os.close(write_end)

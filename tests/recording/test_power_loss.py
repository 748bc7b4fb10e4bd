"""The plug is pulled: what was synced is on the disk, with its name, and can be read."""

from __future__ import annotations

import fcntl
import os
import shutil
import struct
import subprocess
import threading
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from play_launch.config.model import RotateConfig
from play_launch.container.cdr.messages import log_message
from play_launch.postmortem.bag_reader import BagReader
from play_launch.recording.bag import BagWriter
from play_launch.recording.topics import OUTPUT

if TYPE_CHECKING:
    from collections.abc import Iterator

SHUTDOWN = 0x8004587D
"""`_IOR('X', 125, __u32)`, which file systems have for such tests (xfstests calls it godown)."""
WITHOUT_FLUSHING_THE_JOURNAL = 2
SIZE = 16 * 1024 * 1024


class Disk:
    """An ext4 file system in a file, mounted by the kernel's loop device."""

    def __init__(self, folder: Path) -> None:
        self.image, self.root = folder / "image", folder / "disk"
        self.root.mkdir()
        with self.image.open("wb") as file:
            file.truncate(SIZE)
        self.is_mounted = False

    def make(self) -> str:
        """Mount it; return why that cannot be done."""
        mkfs = shutil.which("mkfs.ext4", path=f"{os.environ['PATH']}:/sbin:/usr/sbin")
        if mkfs is None:
            return "mkfs.ext4 is not installed"
        subprocess.run([mkfs, "-q", str(self.image)], check=True)
        return self.mount()

    def mount(self) -> str:
        command = ["mount", "-o", "loop", str(self.image), str(self.root)]
        done = subprocess.run(command, check=False, capture_output=True, text=True)
        self.is_mounted = done.returncode == 0
        return done.stderr.strip()

    def unmount(self) -> None:
        if self.is_mounted:
            subprocess.run(["umount", str(self.root)], check=True)
        self.is_mounted = False

    def pull_the_plug(self) -> None:
        """Nothing gets to the disk any more; then it is mounted again."""
        descriptor = os.open(self.root, os.O_RDONLY)
        try:
            fcntl.ioctl(descriptor, SHUTDOWN, struct.pack("I", WITHOUT_FLUSHING_THE_JOURNAL))
        finally:
            os.close(descriptor)

    def come_back(self) -> None:
        self.unmount()
        assert self.mount() == ""


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Disk]:
    disk = Disk(tmp_path)
    try:
        problem = disk.make()
        if problem:
            pytest.skip(f"a file system of its own cannot be mounted here: {problem}")
        yield disk
    finally:
        disk.unmount()


@pytest.mark.parametrize("size", [1e9, 20_000], ids=["one file", "several files"])
def test_everything_up_to_the_last_sync_is_there(
    disk: Disk, size: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[int] = []
    written: dict[Path, int] = {}
    has_synced = threading.Semaphore(0)
    really = os.fdatasync

    def sync(descriptor: int) -> None:
        # Files before this one were synced before it.
        before = written.get(Path(f"/proc/self/fd/{descriptor}").readlink(), 0)
        really(descriptor)
        synced.append(before)
        has_synced.release()

    monkeypatch.setattr(os, "fdatasync", sync)
    writer = BagWriter(
        disk.root / "session.mcap", rotation=RotateConfig(size=size), sync=1e-3, has_index=True
    )
    channel = writer.register(OUTPUT)
    for number in range(400):
        data = log_message(number, 20, "/a", os.urandom(50).hex(), file="stdout")
        writer.write(channel, data, log_time=number + 1, publish_time=number)
        if number % 10 == 9:
            path = writer._file.path
            writer.flush()
            written[path] = number + 1
        if number % 100 == 99:
            has_synced.acquire()
    # Before: a sync during the kernel's shutdown may return as if it had been one.
    safe = max(synced)
    disk.pull_the_plug()
    writer.abandon()
    disk.come_back()

    reader = BagReader(disk.root)
    found = [message.publish_time for message in reader.messages()]
    assert safe > 0
    assert len(found) >= safe
    assert found == list(range(len(found)))


def test_without_a_sync_the_plug_takes_the_file(disk: Disk) -> None:
    # Else the test above could not fail.
    writer = BagWriter(disk.root / "session.mcap")
    channel = writer.register(OUTPUT)
    writer.write(channel, b"\0\1\0\0", log_time=1, publish_time=1)
    writer.flush()
    disk.pull_the_plug()
    writer.abandon()
    disk.come_back()
    left = disk.root / "session.mcap.active"
    assert not left.exists() or left.stat().st_size == 0

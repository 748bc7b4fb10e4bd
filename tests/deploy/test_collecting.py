"""The recordings of several machines as one."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from mcap.reader import McapReader, make_reader

from play_launch.deploy.machines.namespaces import missing
from play_launch.postmortem.archive import session_entry
from tests.support.hosts import Hosts, running, supervisors, system
from tests.support.replay import COMMAND
from tests.support.waiting import until

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"hosts: {missing()}")


@contextlib.contextmanager
def make_reader_of(path: Path) -> Iterator[McapReader]:
    with path.open("rb") as file:
        yield make_reader(file)


def test_the_recordings_of_all_machines_become_one(net: Hosts, tmp_path: Path) -> None:
    with running(net, system(tmp_path, "whole")) as whole:
        whole.loaded()
        os.kill(whole.rows()["/talker"]["pid"], signal.SIGSEGV)
        until(lambda: whole.rows()["/talker"]["crashes"] == 1, "the crash")
        until(lambda: whole.rows()["/talker"]["state"] == "loaded", "the reload")
        whole.stop()
    folder = net.home / ".ros/play_launch/latest"
    assert folder.resolve().name.endswith("-whole")
    entry = session_entry(folder.resolve())
    assert entry is not None
    assert not entry.is_pinned, "it may be removed like any other"
    done = net.run("collect", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["missing"] == []
    explained = subprocess.run(
        [COMMAND, "explain", folder / "all-machines.mcap"],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert "/talker" in explained.stdout
    assert "SIGSEGV" in explained.stdout
    assert re.search(r"declared in whole.yaml:\d+; on machine h2\.", explained.stdout)
    again = net.run("rerun", str(folder / "all-machines.mcap"))
    assert again.returncode == 5
    assert "the decisions of several machines; rerun the recording of one" in again.stdout
    (part,) = (folder / "h2").iterdir()
    assert "as recorded" in net.run("rerun", str(part)).stdout
    interrupted_collecting_goes_on(net, part)
    with make_reader_of(folder / "all-machines.mcap") as reader:
        times = [message.log_time for _, _, message in reader.iter_messages(log_time_order=False)]
        assert times == sorted(times)
        data = [message.data for _, _, message in reader.iter_messages()]
        assert any(b"tick 2" in each for each in data)
        assert any(b"Hello World" in each for each in data)


def interrupted_collecting_goes_on(net: Hosts, part: Path) -> None:
    files = {each: each.read_bytes() for each in part.iterdir()}
    kept, lost = part / "session.mcap", part / "metadata.yaml"
    before = kept.stat().st_ino
    lost.rename(part / f".{lost.name}")  # as far as it had come
    (part / "session_1.mcap").touch()  # of an earlier, shorter copy
    aliases = net.home / ".ssh/config"
    used = net.home / "used"
    relay = f"bash -c 'touch {used}; exec 3<>/dev/tcp/%h/22; cat <&3 & exec cat >&3'"
    aliases.write_text(f"Host h2 h3 10.77.0.*\n  ProxyCommand {relay}\n{aliases.read_text()}")
    assert net.run("collect", code=0).stderr == ""
    assert used.exists()
    assert {each: each.read_bytes() for each in part.iterdir()} == files
    assert kept.stat().st_ino == before, "it was fetched again"


SHIFTED_CLOCK = """\
#include <dlfcn.h>
#include <time.h>
#include <unistd.h>
extern "C" int clock_gettime(clockid_t clock, timespec* now) {
  static void* const real = dlsym(RTLD_NEXT, "clock_gettime");
  const int result = reinterpret_cast<decltype(&clock_gettime)>(real)(clock, now);
  if (clock == CLOCK_REALTIME && access(CLOCK_IS_SET, F_OK) != 0) now->tv_sec -= 400 * 86400;
  return result;
}
"""
"""Of a computer without a battery for its clock, until NTP sets it."""


def test_recordings_agree_on_the_time_although_a_clock_was_set(net: Hosts, tmp_path: Path) -> None:
    source, library, is_set = tmp_path / "clock.cpp", tmp_path / "clock.so", tmp_path / "set"
    source.write_text(SHIFTED_CLOCK)
    define = f'-DCLOCK_IS_SET="{is_set}"'
    subprocess.run(["c++", "-shared", "-fPIC", define, source, "-o", library], check=True)
    (tmp_path / "setup.bash").write_text(f"export LD_PRELOAD={library}")
    path = system(tmp_path, "clocks")
    setup = f"h2: {{setup: [{tmp_path}/setup.bash], "
    path.write_text(path.read_text().replace("h2: {", setup))
    before = time.time_ns()
    with running(net, path) as whole:
        whole.loaded()
        # 400 days, but for what the measurement is off.
        warning = re.compile(r"its clock is -345(60|59)\d{6} ms off")
        until(lambda: warning.search(whole.printed()) is not None, "the warning")
        is_set.touch()
        net.set_link(2, "down")
        until(lambda: whole.rows()["/talker"]["state"] == "unreachable", "the loss")
        net.set_link(2, "up")
        until(lambda: whole.rows()["/talker"]["state"] == "loaded", "the connection")
        os.kill(whole.rows()["/talker"]["pid"], signal.SIGSEGV)
        until(lambda: whole.rows()["/talker"]["crashes"] == 1, "the crash")
        until(lambda: whole.rows()["/talker"]["state"] == "loaded", "the reload")
        whole.stop()
    warnings = [line for line in whole.printed().splitlines() if "its clock is -" in line]
    assert len(warnings) == 1
    net.run("collect", code=0)
    merged = net.home / ".ros/play_launch/latest/all-machines.mcap"
    with make_reader_of(merged) as reader:
        messages = [(channel.topic, each) for _, channel, each in reader.iter_messages()]
    second = 1_000_000_000
    begin, end = before - second, time.time_ns() + second
    assert not {topic for topic, each in messages if not begin < each.log_time < end}
    own = [(topic, each) for topic, each in messages if topic.startswith("/play_launch/")]
    assert not {topic for topic, each in own if not begin < each.publish_time < end}
    found = json.loads(net.run("explain", "--json", str(merged), code=1).stdout)
    crash = next(each for each in found["findings"] if each["name"] == "/talker")
    assert before < crash["times_ns"][0] < time.time_ns()


@pytest.mark.parametrize("is_cut", [False, True])
def test_a_session_that_was_killed_is_started_again(
    net: Hosts, tmp_path: Path, is_cut: bool
) -> None:
    with running(net, system(tmp_path, "killed")) as killed:
        before = killed.loaded().rows()["/listen"]["pid"]
        (pid,) = supervisors(net, 3)
        if is_cut:
            net.set_link(3, "down")
            try:
                until(lambda: "h3 is unreachable" in killed.printed(), "the lost connection")
                os.kill(pid, signal.SIGKILL)
            finally:
                net.set_link(3, "up")
        else:
            os.kill(pid, signal.SIGKILL)
        until(
            lambda: (
                killed.rows().get("/listener", {}).get("state") == "loaded"
                and killed.rows()["/listen"]["pid"] != before
            ),
            "the new one",
        )
        killed.stop()
    done = net.run("collect", "--json")
    assert done.returncode == 0, done.stderr
    with make_reader_of(Path(json.loads(done.stdout)["output"])) as reader:
        every = [message.data for _, _, message in reader.iter_messages()]
    firsts = [data for data in every if b"tick 1\0" in data]
    assert len(firsts) == 2, "also what was recorded before the supervisor was killed"
    explained = net.run("explain", json.loads(done.stdout)["output"])
    assert "machine h3 was started again at " in explained.stdout
    assert "Cause: the supervisor of its session was killed." in explained.stdout


def test_a_list_of_recordings_that_cannot_be_written_ends_nothing(
    net: Hosts, tmp_path: Path
) -> None:
    with running(net, system(tmp_path, "unlisted")) as unlisted:
        unlisted.loaded()
        (listed,) = (net.home / ".ros/play_launch").glob("*-unlisted/machines.json")
        listed.unlink()
        listed.mkdir()  # as with a disk that is full
        net.set_link(3, "down")
        try:
            until(lambda: unlisted.rows()["/listener"]["state"] == "unreachable", "the loss")
        finally:
            net.set_link(3, "up")
        until(lambda: unlisted.rows()["/listener"]["state"] == "loaded", "the return")
        listed.rmdir()
        unlisted.stop()
    assert "the recordings of the machines cannot be listed: Is a directory" in unlisted.printed()
    net.run("collect", code=0)

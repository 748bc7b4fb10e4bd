"""What is no recording, and outputs that cannot be written: one sentence, and nothing is spoilt."""

from __future__ import annotations

import fcntl
import os
import signal
import socket
import subprocess
import sys
import termios
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from typer.testing import CliRunner

from play_launch.cli.app import app
from play_launch.supervisor.events import NodeState
from tests.postmortem.scenes import Scene
from tests.support.launch import SLEEPER, use_launch
from tests.support.mounts import mounted
from tests.support.replay import COMMAND, finished, run
from tests.support.waiting import until

if TYPE_CHECKING:
    from collections.abc import Callable

READERS = (
    ("info",),
    ("inspect",),
    ("explain",),
    ("report",),
    ("crashes",),
    ("export",),
    ("export", "--format", "csv"),
    ("layout", "foxglove"),
    ("rerun",),
    ("recover",),
    ("compare", "SECOND"),
)
HEAD = ("bash", "-c", 'set -o pipefail; "$@" | head -1', "bash")
WRITERS = (
    ("report", "GOOD", "-o", "OUTPUT"),
    ("export", "GOOD", "-o", "OUTPUT"),
)


@pytest.fixture(autouse=True)
def _launch(monkeypatch: pytest.MonkeyPatch) -> None:
    use_launch(monkeypatch)


def folder_of_nothing(path: Path) -> None:
    path.mkdir()


def folder_of_folders(path: Path) -> None:
    (path / "session.mcap").mkdir(parents=True)


def empty_file(path: Path) -> None:
    path.touch()


def pipe(path: Path) -> None:
    os.mkfifo(path)


def folder_with_a_pipe(path: Path) -> None:
    path.mkdir()
    os.mkfifo(path / "session.mcap")


def link_to_itself(path: Path) -> None:
    path.symlink_to(path)


def device_without_end(path: Path) -> None:
    path.symlink_to("/dev/zero")


def bound_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind(str(path))


@pytest.fixture
def good(tmp_path: Path) -> Path:
    made = Scene()
    made.started()
    made.node(1, "/talker", NodeState.LOADED)
    return made.record(tmp_path / "good.mcap")


@pytest.mark.parametrize("verb", READERS, ids=" ".join)
@pytest.mark.parametrize(
    "make",
    [
        folder_of_nothing,
        folder_of_folders,
        empty_file,
        pipe,
        folder_with_a_pipe,
        link_to_itself,
        device_without_end,
        bound_socket,
    ],
)
@pytest.mark.timeout(60)
def test_what_is_no_recording_is_named(
    tmp_path: Path,
    good: Path,
    verb: tuple[str, ...],
    make: Callable[[Path], None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    path = Path("it.mcap")
    make(path)
    before = sorted(tmp_path.rglob("*"))
    words = [str(good) if word == "SECOND" else word for word in verb]
    result = CliRunner().invoke(app, [*words, str(path)])
    assert isinstance(result.exception, SystemExit), result.exception
    assert result.exit_code in ({2, 5} if verb[0] == "crashes" else {1, 2})
    (line,) = result.stderr.splitlines()
    assert "it.mcap" in line
    assert "None" not in line
    # `crashes` reads on, and counts what it found.
    assert result.stdout == "" or verb[0] == "crashes"
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("verb", [*READERS, ("dump",)], ids=" ".join)
def test_a_name_that_cannot_be_is_named(good: Path, verb: tuple[str, ...]) -> None:
    words = [good if word == "SECOND" else word for word in verb]
    result = run(*words, "x" * 300)
    assert result.returncode in {1, 2}
    assert result.stderr == f"error: {'x' * 300}: File name too long\n"


def test_a_folder_that_cannot_be_read_is_named_among_others(tmp_path: Path, good: Path) -> None:
    closed = tmp_path / "logs" / "closed"
    closed.mkdir(parents=True)
    good.rename(tmp_path / "logs" / "good.mcap")
    closed.chmod(0)
    rights = "-dac_override,-dac_read_search"  # root's
    drop = ["setpriv", "--inh-caps", rights, "--bounding-set", rights] if os.geteuid() == 0 else []
    result = finished([*drop, COMMAND, "crashes", closed.parent])
    closed.chmod(0o700)
    assert result.returncode == 5
    assert result.stderr == f"warning: {closed}: Permission denied\n"
    assert result.stdout == "0 signatures in 1 session\n"


@pytest.mark.parametrize("form", ["perfetto", "csv"])
def test_the_folder_where_one_is_can_be_exported(
    tmp_path: Path, good: Path, form: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    good.rename(tmp_path / "session.mcap")
    monkeypatch.chdir(tmp_path)
    assert run("export", ".", "--format", form).returncode == 0
    name = "session.trace.json" if form == "perfetto" else "session-csv"
    assert (tmp_path / name).exists()


@pytest.mark.parametrize("verb", WRITERS, ids=lambda words: words[0])
@pytest.mark.parametrize(
    ("output", "reason"),
    [
        ("good.mcap", "is a recording"),
        ("/", "Is a directory"),
        ("no/such/folder", "No such file or directory"),
        ("/proc/x", "No such file or directory"),
        ("x" * 300, "File name too long"),
    ],
)
def test_what_cannot_be_an_output_stays_as_it_is(
    tmp_path: Path,
    good: Path,
    verb: tuple[str, ...],
    output: str,
    reason: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    whole = good.read_bytes()
    words = [{"GOOD": str(good), "OUTPUT": output}.get(word, word) for word in verb]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 1
    assert result.stderr == f"error: {output}: {reason}; name another file with --output\n"
    assert sorted(tmp_path.iterdir()) == [good]
    assert good.read_bytes() == whole


@pytest.mark.parametrize("verb", [("dump", "a.launch.py"), ("systemd-unit", "robot.yaml")])
def test_a_working_directory_that_was_removed_is_named(
    tmp_path: Path, verb: tuple[str, str]
) -> None:
    (tmp_path / "gone").mkdir()
    (tmp_path / "a.launch.py").write_text(SLEEPER, encoding="utf-8")
    (tmp_path / "robot.yaml").write_text("{version: 1, nodes: [{name: a, command: [a]}]}")
    remove = 'rmdir ../gone && exec "$@"'
    done = finished(
        ["sh", "-c", remove, "sh", str(COMMAND), verb[0], str(tmp_path / verb[1])],
        cwd=tmp_path / "gone",
    )
    assert done.returncode == 2
    assert done.stderr == "error: the working directory was removed; change to another one\n"


def test_names_of_files_do_nothing_to_the_terminal(tmp_path: Path, good: Path) -> None:
    folder = tmp_path / "of \x1b[31m mallory"
    folder.mkdir()
    (folder / "cut.mcap").write_bytes(good.read_bytes()[:-100])
    launch = folder / "a.launch.py"
    launch.write_text(SLEEPER, encoding="utf-8")
    for words, code in (
        (("crashes", tmp_path), 5),
        (("info", folder / "cut.mcap"), 5),
        (("info", folder / "none.mcap"), 2),
        (("replay", folder / "none.yaml"), 2),
        (("dump", launch), 0),
    ):
        done = run(*words)
        assert done.returncode == code, done.stderr
        assert "mallory" in done.stdout + done.stderr
        assert "\x1b" not in done.stdout + done.stderr


@pytest.mark.parametrize("output", ["-", "/dev/stdout", "/dev/fd/1", "/proc/self/fd/1", "link"])
@pytest.mark.parametrize(
    ("verb", "beginning"),
    [
        (("report", "good.mcap", "-o"), b"<!doctype html>"),
        (("export", "good.mcap", "-o"), b"{"),
        (("recover", "good.mcap", "-o"), b"\x89MCAP"),
        (("dump", "a.launch.py", "-o"), b"# From a.launch.py"),
        (("init",), b"# yaml-language-server"),
    ],
    ids=lambda words: words[0] if isinstance(words, tuple) else "",
)
def test_standard_output_is_an_output(
    tmp_path: Path, good: Path, verb: tuple[str, ...], beginning: bytes, output: str
) -> None:
    (tmp_path / "link").symlink_to("/dev/stdout")
    (tmp_path / "a.launch.py").write_text(SLEEPER, encoding="utf-8")
    before = sorted(tmp_path.iterdir())
    with (tmp_path / "taken").open("wb") as stdout:
        result = subprocess.run(
            [COMMAND, *verb, output],
            check=False,
            cwd=tmp_path,
            stdout=stdout,
            stderr=subprocess.PIPE,
            timeout=60,
        )
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "taken").read_bytes().startswith(beginning)
    assert sorted(tmp_path.iterdir()) == [*before, tmp_path / "taken"]


@pytest.mark.parametrize("verb", ["report", "export", "recover", "dump"])
def test_a_reader_that_has_gone_is_no_error_and_a_full_disk_is_that_of_the_output(
    tmp_path: Path, good: Path, verb: str
) -> None:
    launch = tmp_path / "a.launch.py"
    launch.write_text(SLEEPER, encoding="utf-8")
    command = [str(COMMAND), verb, str(launch if verb == "dump" else good), "-o", "-"]
    reading, writing = os.pipe()
    os.close(reading)
    gone = subprocess.run(command, check=False, stdout=writing, stderr=subprocess.PIPE, timeout=60)
    os.close(writing)
    assert gone.returncode == 0
    assert b"error" not in gone.stderr
    with Path("/dev/full").open("wb") as full:
        failed = subprocess.run(
            command, check=False, stdout=full, stderr=subprocess.PIPE, timeout=60
        )
    assert failed.returncode in {1, 2}
    (error,) = [line for line in failed.stderr.splitlines() if line.startswith(b"error: ")]
    assert error.startswith((b"error: -: No space left", b"error: cannot write the output: No"))


@pytest.mark.parametrize("verb", ["report", "recover", "dump"])
def test_a_pipe_stays_one_and_a_link_leads_where_it_did(
    tmp_path: Path, good: Path, verb: str
) -> None:
    launch = tmp_path / "a.launch.py"
    launch.write_text(SLEEPER, encoding="utf-8")
    command = [str(COMMAND), verb, str(launch) if verb == "dump" else str(good), "-o"]
    pipe, link, target = (tmp_path / name for name in ("pipe", "link", "target"))
    os.mkfifo(pipe)
    with subprocess.Popen([*command, str(pipe)], stdout=subprocess.DEVNULL) as writing:
        passed = pipe.read_bytes()
    assert writing.returncode == 0
    # A reader that goes, while more comes than a pipe holds.
    program = "import pathlib, sys; from play_launch.cli.output import *\n"
    program += "with whole_file(pathlib.Path(sys.argv[1])) as f: f.write_bytes(bytes(1_000_000))"
    with subprocess.Popen([sys.executable, "-c", program, pipe], stderr=subprocess.PIPE) as writing:
        with pipe.open("rb") as reading:
            assert reading.read(10)
        assert b"Broken pipe; name another file" in writing.communicate(timeout=60)[1]
    assert pipe.is_fifo()
    link.symlink_to(target)
    subprocess.run([*command, str(link)], check=True, timeout=60, stdout=subprocess.DEVNULL)
    assert link.is_symlink()
    assert target.read_bytes()[:100] == passed[:100]


@pytest.mark.parametrize("arguments", [("report",), ("export",), ("export", "--format", "csv")])
def test_nothing_is_left_of_an_output_for_which_there_is_no_room(
    tmp_path: Path, good: Path, arguments: tuple[str, ...]
) -> None:
    folder = tmp_path / "full"
    folder.mkdir()
    mount = f"mount -t tmpfs -o size=4k tmpfs {folder} && head -c 4096 /dev/zero > {folder}/x"
    listing = f'"$@" -o {folder}/out; code=$?; find {folder} -type f; exit $code'
    command = [COMMAND, *arguments, good]
    result = finished(mounted(mount, "sh", "-c", listing, "sh", *command))
    assert result.returncode == 1
    assert "No space left on device" in result.stderr
    assert result.stderr.count("\n") == 1
    assert result.stdout == f"{folder}/x\n"


def test_a_folder_is_recovered_as_far_as_its_files_permit(tmp_path: Path, good: Path) -> None:
    folder = tmp_path / "session"
    folder.mkdir()
    active = folder / "session.mcap.active"
    active.write_bytes(good.read_bytes()[:-100])
    # What is a mount point cannot be removed.
    mount = f"mount --bind {active} {active}"
    result = finished(mounted(mount, COMMAND, "recover", folder))
    assert result.returncode == 1
    assert result.stderr == f"error: {active}: Device or resource busy\n"
    assert run("recover", folder).returncode == 0
    assert not active.exists()
    active.mkdir()
    result = run("recover", folder)
    assert (result.returncode, result.stderr) == (1, f"error: {active}: it is no regular file\n")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_nothing_is_left_of_outputs_that_are_interrupted(
    tmp_path: Path, number: signal.Signals
) -> None:
    program = """
import signal, sys
from pathlib import Path
from play_launch.cli.output import whole_file
for each in signal.SIGINT, signal.SIGTERM, signal.SIGHUP:
    signal.signal(each, signal.SIG_DFL)
with whole_file(Path(sys.argv[1])) as one, whole_file(Path(sys.argv[2])) as other:
    one.write_text("half")
    other.write_text("half")
    print("there", flush=True)
    signal.pause()
"""
    outputs = [tmp_path / "a", tmp_path / "b"]
    outputs[0].write_text("old")
    with subprocess.Popen(
        [sys.executable, "-c", program, *outputs], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "there\n"
        assert len(list(tmp_path.iterdir())) == 3
        process.send_signal(number)
    assert process.returncode == -number
    assert list(tmp_path.iterdir()) == [outputs[0]]
    assert outputs[0].read_text() == "old"


@pytest.mark.parametrize("verb", ["info", "inspect", "explain", "crashes", "export", "layout"])
@pytest.mark.parametrize(("redirection", "code"), [(">/dev/full", 2), (">&-", 0)])
def test_an_answer_that_cannot_be_written(
    tmp_path: Path, good: Path, verb: str, redirection: str, code: int
) -> None:
    arguments = [verb, "foxglove", str(good)] if verb == "layout" else [verb, str(good)]
    result = finished(["sh", "-c", f'exec "$@" {redirection}', "sh", COMMAND, *arguments])
    assert result.returncode == code
    expected = "error: cannot write the output: No space left on device\n" if code else ""
    assert result.stderr == expected


def test_a_pipe_that_another_program_made_non_blocking_takes_everything() -> None:
    reading, writing = os.pipe()
    fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 4096)
    os.set_blocking(writing, False)
    command = [str(COMMAND), "manual"]
    with subprocess.Popen(command, stdout=writing, stderr=subprocess.PIPE, text=True) as process:
        os.close(writing)
        until(lambda: process.poll() is not None or waiting_in(reading) >= 4096, "a full pipe")
        with os.fdopen(reading, encoding="utf-8") as lines:
            text = lines.read()
        assert process.stderr is not None
        assert not process.stderr.read()
    assert process.returncode == 0
    assert text == finished(command).stdout


def waiting_in(pipe: int) -> int:
    return int.from_bytes(fcntl.ioctl(pipe, termios.FIONREAD, bytes(4)), sys.byteorder)


def test_a_reader_that_has_gone_ends_the_command(tmp_path: Path) -> None:
    made = Scene()
    made.started()
    for number in range(20_000):
        made.line(number / 100, f"line {number}")
    path = made.record(tmp_path / "x.mcap")
    # Its end is damaged: reading it to the end fails.
    path.write_bytes(path.read_bytes()[:-100])
    for option in ("--level=info", "--json"):
        result = finished([*HEAD, str(COMMAND), "inspect", option, str(path)])
        assert (result.returncode, result.stderr) == (0, "")
        assert result.stdout.count("\n") == 1


@pytest.mark.parametrize("words", [("manual",), ("completion", "bash"), ("schema",)])
def test_a_reader_that_has_gone_is_no_error(words: tuple[str, ...]) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    result = finished(
        [COMMAND, *words], capture_output=False, stdout=writing, stderr=subprocess.PIPE
    )
    os.close(writing)
    assert (result.returncode, result.stderr) == (0, "")


def test_a_recording_that_is_being_written_is_read_as_far_as_it_is(tmp_path: Path) -> None:
    made = Scene()
    made.started()
    made.crashed(1, "/talker")
    path = made.record(tmp_path / "x.mcap", finished=False)
    for verb in ("info", "inspect", "explain", "report", "export"):
        result = run(verb, path)
        assert result.returncode == 5
        assert "it was not closed in order, so its end may be missing" in result.stderr
        assert "Traceback" not in result.stderr

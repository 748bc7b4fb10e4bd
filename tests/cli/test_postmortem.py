"""`explain`, `crashes`, `compare` and `replay` of recordings: words, exit codes, damage, page."""

from __future__ import annotations

import json
import os
import re
from collections import Counter
from pathlib import Path

import pytest

from play_launch.supervisor.events import NodeState, ProcessEventKind
from play_launch.supervisor.outcome import Cause, Sequel
from tests.postmortem.scenes import Scene
from tests.support.replay import run

PAGE = Path(__file__).resolve().parents[2] / "docs" / "postmortem.md"


def scene(*, crashes: int = 0, loaded_at: float = 1.0, memory: int = 10**8) -> Scene:
    made = Scene()
    made.started()
    made.node(loaded_at, "/talker", NodeState.LOADED)
    for at in range(5):
        made.used(2 + at, "/box:/talker", memory_bytes=memory, cpu_seconds=0.1 * at)
    for number in range(crashes):
        made.crashed(10 + number, "/talker")
        made.node(10.5 + number, "/talker", NodeState.LOADED)
    return made


@pytest.fixture
def good(tmp_path: Path) -> Path:
    return scene().record(tmp_path / "good.mcap")


@pytest.fixture
def bad(tmp_path: Path) -> Path:
    return scene(crashes=2).record(tmp_path / "bad.mcap")


def test_exit_codes_say_whether_something_was_wrong(good: Path, bad: Path) -> None:
    result = run("explain", good)
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.startswith("Nothing was wrong. Session made_up: ")
    whole = bytearray(good.read_bytes())
    whole[whole.index(b"zstd") + 40] ^= 1
    good.with_name("flipped.mcap").write_bytes(whole)
    result = run("explain", good.with_name("flipped.mcap"))
    assert result.returncode == 5
    assert result.stdout.startswith("Nothing in what can be read was wrong. Session made_up: ")
    assert run("explain", bad).returncode == 1
    assert json.loads(run("explain", bad, "--json").stdout)["wrong"] is True
    unfinished = scene().record(good.with_name("cut.mcap"), finished=False)
    result = run("explain", unfinished)
    assert result.returncode == 5
    assert "The recording is incomplete" in result.stdout


def test_the_words_of_a_finding(bad: Path) -> None:
    lines = run("explain", bad).stdout.splitlines()
    assert lines[0] == "/talker in /box crashed 2 times, first at 10.000 s after the start."
    assert "a null pointer was used" in lines[1]
    assert "demo::tick (libdemo.so+0x2)" in lines[2]
    assert "  Downtime: /talker 2 times, 1.0 s in all, 500 ms at most." in lines
    assert "    #0 demo::tick()+0x1 (libdemo.so+0x2)" in lines


def test_many_findings_stay_readable(tmp_path: Path) -> None:
    made = Scene()
    made.started()
    for number in range(9):
        made.crashed(number, f"/node_{number}", f"demo::f{number}()")
        for pause in range(20):
            made.crashed(
                number + 0.1,
                f"/node_{number}",
                f"demo::f{number}()",
                sequel=("", Sequel.RELOAD),
                delay_ns=pause * 10**9,
            )
            made.node(number + 0.2, f"/node_{number}", NodeState.LOADED)
    bag = made.record(tmp_path / "x.mcap")
    text = run("explain", bag).stdout
    assert text.count("crashed 20 times") == 9
    assert text.count("Backtrace:") == 5
    assert text.count("Place: ") == 9
    assert "The first 5 are in full here" in text
    assert max(map(len, text.splitlines())) < 400
    assert len(json.loads(run("explain", bag, "--json").stdout)["findings"]) == 18


def test_what_a_node_wrote_cannot_spoil_the_terminal(tmp_path: Path) -> None:
    made = Scene()
    made.started()
    made.line(1, "\x1b[2Jgone\x07")
    made.crashed(2, "/talker")
    result = run("explain", made.record(tmp_path / "x.mcap"))
    assert "gone" in result.stdout
    assert "\x1b" not in result.stdout
    assert "\x07" not in result.stdout


def test_a_bag_of_another_program_is_not_replayed(tmp_path: Path, good: Path) -> None:
    result = run("replay", good, "--log-dir", tmp_path / "logs")
    assert result.returncode == 2
    assert "is an MCAP recording; give the YAML file" in result.stderr
    assert not (tmp_path / "logs").exists()


def test_equal_crashes_of_several_sessions_are_a_group(tmp_path: Path, bad: Path) -> None:
    scene(crashes=3).record(tmp_path / "worse.mcap")
    (tmp_path / "latest").symlink_to(tmp_path, target_is_directory=True)
    result = run("crashes", tmp_path, "--json")
    found = json.loads(result.stdout)
    assert (result.returncode, found["sessions"]) == (0, 2)
    (group,) = found["crashes"]
    assert (group["count"], group["sessions"], group["nodes"]) == (5, 2, ["/talker"])
    assert group["title"] == "SIGSEGV in demo::tick (libdemo.so)"
    text = run("crashes", tmp_path).stdout
    assert f"{group['id']}  SIGSEGV in demo::tick (libdemo.so)" in text
    assert "5 times in 2 sessions" in text
    assert run("crashes", bad).stdout.count("SIGSEGV in ") == 1


def test_a_folder_without_recordings_is_named(tmp_path: Path) -> None:
    result = run("crashes", tmp_path)
    assert result.returncode == 2
    assert "there is no recording" in result.stderr


@pytest.mark.parametrize(
    ("after", "words"),
    [
        (scene(crashes=1), "new crash: "),
        (scene(loaded_at=3.0), "/box:/talker is loaded 3.0 s after the start instead of 1.0 s"),
        (scene(memory=3 * 10**8), "/box:/talker uses 300 MB at most instead of 100 MB"),
    ],
)
def test_a_worse_session_is_told_by_its_exit_code(
    tmp_path: Path, good: Path, after: Scene, words: str
) -> None:
    worse = after.record(tmp_path / "after.mcap")
    result = run("compare", good, worse)
    assert result.returncode == 1
    assert words in result.stdout
    assert result.stdout.splitlines()[-1] == "The second session is worse."
    back = run("compare", worse, good, "--json")
    assert (back.returncode, json.loads(back.stdout)["worse"]) == (0, False)


def test_crashes_that_both_sessions_have_are_counted(tmp_path: Path) -> None:
    fewer = scene(crashes=1).record(tmp_path / "fewer.mcap")
    more = scene(crashes=3).record(tmp_path / "more.mcap")
    result = run("compare", fewer, more)
    assert result.returncode == 1
    assert re.search(
        r"^Worse:\n  more crashes: \w{8} SIGSEGV in demo::tick \(libdemo.so\), "
        r"3 times instead of 1, /talker$",
        result.stdout,
        re.MULTILINE,
    )
    back = json.loads(run("compare", more, fewer, "--json").stdout)
    assert not back["worse"]
    (crash,) = back["fewer_crashes"]
    assert (crash["before"], crash["after"], crash["units"]) == (3, 1, ["/talker"])
    assert "fewer crashes: " in run("compare", more, fewer).stdout
    same = run("compare", more, more)
    assert "crash" not in same.stdout


def test_parameters_that_differ_are_listed(tmp_path: Path) -> None:
    before, after = scene(), scene()
    before.parameters(3, "/talker", rate=1.0, frame="base", note="x" * 500)
    after.parameters(3, "/talker", rate=2.5, frame="base")
    before.parameters(3, "/many", **{f"p{number:02}": number for number in range(80)})
    after.parameters(3, "/many", **{f"p{number:02}": number + 1 for number in range(80)})
    paths = before.record(tmp_path / "before.mcap"), after.record(tmp_path / "after.mcap")
    result = run("compare", *paths)
    assert result.returncode == 0, "a parameter is changed on purpose"
    lines = result.stdout.splitlines()
    assert lines[0] == "Parameters that differ:"
    assert lines[1] == "  /many p00: 0 -> 1"
    assert lines[-2:] == ["  and 32 more; --json gives all", "The second session is not worse."]
    values = json.loads(run("compare", *paths, "--json").stdout)["parameters"]
    assert values[-1] == {"node": "/talker", "name": "rate", "before": "1.0", "after": "2.5"}
    assert values[-2]["after"] is None


def test_a_name_that_is_no_utf_8_is_compared(tmp_path: Path, good: Path) -> None:
    other = scene().record(tmp_path / os.fsdecode(b"other\xff.mcap"))
    result = run("compare", good, other, "--json")
    assert (result.returncode, result.stderr) == (0, "")
    assert json.loads(result.stdout)["second"].endswith("other\\udcff.mcap")


def test_a_node_that_is_not_loaded_any_more_is_worse(tmp_path: Path, good: Path) -> None:
    made = Scene()
    made.started()
    made.node(1, "/talker", NodeState.LOAD_FAILED, reason="no")
    result = run("compare", good, made.record(tmp_path / "after.mcap"))
    assert result.returncode == 1
    assert "/box:/talker is not loaded any more" in result.stdout


def test_all_commands_count_the_same_crashes(tmp_path: Path) -> None:
    made = Scene()
    made.process(0, ProcessEventKind.STARTED, "/helper", pid=9)
    made.process(1, ProcessEventKind.EXITED, "/helper", signal=11)
    made.started()
    for name in ("/talker", "/deaf"):
        made.node(1, name, NodeState.LOADED)
    for at, count in ((2, 1), (3, 2)):
        made.crashed(at, "/talker", crashes=count)
        made.node(at + 0.5, "/talker", NodeState.LOADED, crashes=count)
    made.crashed(4, "/constructor", in_constructor=True)
    made.node(5, "/refused", NodeState.LOAD_FAILED, reason="no such class")
    made.process(8, ProcessEventKind.STOPPING)
    made.crashed(9, "/deaf", signal=9, error_message="SIGKILL", cause=Cause.STOP_TIMEOUT)
    bag = made.record(tmp_path / "session.mcap")

    assert json.loads(run("info", bag, "--json").stdout)["crashes"] == {
        "/constructor": 1,
        "/helper": 1,
        "/talker": 2,
    }
    groups = json.loads(run("crashes", bag, "--json").stdout)["crashes"]
    assert sum(each["count"] for each in groups) == 4
    said = run("explain", bag).stdout
    assert re.findall(r"^(/\w+)(?: in /box)? (?:crashed|died)", said, re.MULTILINE) == [
        "/helper",
        "/talker",
        "/constructor",
    ]
    assert "/talker in /box crashed 2 times" in said
    run("report", bag, "-o", tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    facts = json.loads(page.split('id="facts">')[1].split("</script>")[0])
    assert Counter(mark["what"] for mark in facts["marks"]) == {
        "crashed": 3,
        "died": 1,
        "failed to load": 1,
        "did not stop": 1,
    }


def test_the_commands_of_the_page_work(tmp_path: Path) -> None:
    scene(crashes=1).record(tmp_path / "session.mcap")
    scene().record(tmp_path / "before.mcap")
    scene().record(tmp_path / "after.mcap")
    (tmp_path / "logs").mkdir()
    scene(crashes=1).record(tmp_path / "logs" / "one.mcap")
    commands = re.findall(r"^\$ play-launch (.+)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    codes = [run(*command.split(), cwd=tmp_path).returncode for command in commands]
    # The scene has no inputs that could be decided once more.
    assert codes == [1, 0, 0, 5]


def damaged(whole: bytes) -> list[bytes]:
    cuts = [whole[:size] for size in range(0, len(whole), max(1, len(whole) // 25))]
    places = range(8, len(whole), max(1, len(whole) // 25))
    flips = [whole[:at] + bytes([whole[at] ^ 0x10]) + whole[at + 1 :] for at in places]
    return cuts + flips


def test_damaged_sessions_do_not_hide_the_crashes_of_others(bad: Path) -> None:
    # In one process, for starting one for each would take a minute.
    from typer.testing import CliRunner

    from play_launch.cli.app import app

    runner = CliRunner()
    path = bad.with_name("damaged.mcap")
    codes = set()
    for content in damaged(bad.read_bytes()):
        path.write_bytes(content)
        result = runner.invoke(app, ["crashes", str(path)])
        assert result.exception is None or isinstance(result.exception, SystemExit), content[:9]
        codes.add(result.exit_code)
    assert codes <= {0, 5}
    assert 5 in codes


def test_a_process_that_fails_without_a_backtrace(tmp_path: Path) -> None:
    made = Scene()
    made.process(0, ProcessEventKind.STARTED, "/job", pid=7, command=("job", "--now"))
    made.line(1, "bind: Address already in use", "/job")
    made.process(2, ProcessEventKind.EXITED, "/job", exit_code=3, message="exited with status 3")
    lines = run("explain", made.record(tmp_path / "x.mcap")).stdout.splitlines()
    assert lines[0] == "/job died at 2.000 s after the start."
    assert lines[1].endswith("; that is, another program has its port.")
    assert "command job --now" in lines[2]

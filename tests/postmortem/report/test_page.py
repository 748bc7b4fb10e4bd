"""The page as a file: whole, closed to the network, and proof against what it shows."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import re
import subprocess
import zlib
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from play_launch.cli.output import OutputError
from play_launch.cli.report import report as write_report
from play_launch.postmortem.bag_reader import NotARecordingError
from play_launch.supervisor.events import LogRecord
from tests.postmortem.report.recordings import (
    BEGIN,
    HOSTILE,
    SECOND,
    hostile,
    ordinary,
    page_of,
    record,
)
from tests.support.replay import COMMAND


class Reader(HTMLParser):
    """Elements, in their order, and the text of scripts and styles."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: dict[str, str] = {}
        self._is_open = False
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self._is_open = True

    def handle_endtag(self, tag: str) -> None:
        self._is_open = False

    def handle_data(self, data: str) -> None:
        if not self._is_open:
            return
        tag, attributes = self.elements[-1]
        if tag in {"script", "style", "title"}:
            name = attributes.get("id") or tag
            self.texts[name] = self.texts.get(name, "") + data


def read(path: Path) -> Reader:
    return Reader(path.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Reader:
    folder = tmp_path_factory.mktemp("page")
    assert write_report(ordinary(folder), folder / "page.html") == 0
    return read(folder / "page.html")


@pytest.fixture(scope="module")
def hostile_page(tmp_path_factory: pytest.TempPathFactory) -> Reader:
    folder = tmp_path_factory.mktemp("hostile")
    assert write_report(hostile(folder), folder / "page.html") == 0
    return read(folder / "page.html")


@pytest.fixture(scope="module")
def explained(tmp_path_factory: pytest.TempPathFactory) -> str:
    recording = ordinary(tmp_path_factory.mktemp("explained"))
    command = [str(COMMAND), "explain", str(recording)]
    result = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
    assert result.returncode == 1, result.stderr
    return result.stdout


def facts_of(page: Reader) -> dict[str, Any]:
    facts: dict[str, Any] = json.loads(page.texts["facts"])
    return facts


def test_it_needs_nothing_else_and_may_load_nothing_else(page: Reader) -> None:
    policy = next(
        attributes["content"]
        for tag, attributes in page.elements
        if tag == "meta" and attributes.get("http-equiv") == "Content-Security-Policy"
    )
    assert policy is not None
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    for kind in ("script", "style"):
        digest = base64.b64encode(hashlib.sha256(page.texts[kind].encode()).digest()).decode()
        assert rules[f"{kind}-src"] == f"'sha256-{digest}'"
    assert ':root[data-theme="dark"] {' in page.texts["style"]
    for tag, attributes in page.elements:
        assert "src" not in attributes, tag
        assert "style" not in attributes, f"{tag}: the policy forbids it"
        assert not any(name.startswith("on") for name in attributes), tag
        assert (attributes.get("href") or "#").startswith("#"), tag


def test_it_tells_what_happened(page: Reader, explained: str) -> None:
    facts = facts_of(page)
    kinds = [row["kind"] for row in facts["rows"]]
    assert (kinds.count("node"), kinds.count("container"), kinds.count("process")) == (24, 10, 2)
    assert len(facts["series"]) == 36
    assert facts["marks"]
    assert facts["marks"] == sorted(facts["marks"], key=lambda mark: mark["at"])
    first = facts["story"][0]
    marks = [mark for mark in facts["marks"] if mark["at"] == pytest.approx(first["at"], abs=1.0)]
    assert first["name"] in {facts["rows"][mark["row"]]["name"] for mark in marks}
    assert first["title"].startswith(first["name"])
    assert first["lines"][0].startswith("Cause: SIG")
    # As explain says it.
    assert first["title"] in explained
    assert facts["came_up"] > 0
    assert facts["notices"] == []
    assert {topic["name"] for topic in facts["topics"]} >= {"/play_launch/states"}


def test_every_column_is_there_and_whole(page: Reader) -> None:
    facts = facts_of(page)
    samples = sum(each["count"] for each in facts["series"])
    sizes = {
        "lane_rows": 2 * facts["lanes"],
        "lane_states": facts["lanes"],
        "lane_times": 8 * facts["lanes"],
        "line_rows": 2 * facts["lines"],
        "line_times": 4 * facts["lines"],
        "series_times": 4 * samples,
        "series_0": 2 * samples,
        "series_1": 2 * samples,
        "system_5": 2 * facts["system"]["count"],
    }
    for name, size in sizes.items():
        assert len(zlib.decompress(base64.b64decode(page.texts[name]))) == size, name


def test_hostile_text_ends_no_element(hostile_page: Reader, page: Reader) -> None:
    tags = [tag for tag, _ in hostile_page.elements]
    assert tags == [tag for tag, _ in page.elements]
    assert hostile_page.texts["script"] == page.texts["script"]
    assert not re.search(r"[<>]", hostile_page.texts["facts"])
    facts = facts_of(hostile_page)
    assert facts["title"] == HOSTILE[0]
    names = {row["name"] for row in facts["rows"]}
    assert f"/{HOSTILE[1]}" in names
    assert "/\\u202egnp.exe\\u202c and \\u2066isolated" in names
    assert "/red  \\x9b2J" in names


def test_the_configuration_is_compared_with_that_of_the_session_before(tmp_path: Path) -> None:
    for name, config in (("1-a", "rate: 1\n"), ("2-a", "rate: 2\nkept: 1\n"), ("9-a", "later\n")):
        record(tmp_path / name / "session.mcap", [], config=config)
    (tmp_path / "3-a").mkdir()
    (tmp_path / "4-a").mkdir()
    (tmp_path / "4-a" / "session.mcap").write_bytes(b"no recording")
    (tmp_path / "latest").symlink_to("9-a")
    this = record(tmp_path / "5-a" / "session.mcap", [], config="rate: 3\nkept: 1\n")
    (tmp_path / "latest").unlink()
    (tmp_path / "latest").symlink_to("5-a")
    for recording in (this, this.parent, tmp_path / "latest", tmp_path / "latest" / this.name):
        page_of(recording, tmp_path / "page.html")
        found = facts_of(read(tmp_path / "page.html"))["configuration"]
        assert found["before"] == "2-a"
        assert [line for line in found["difference"] if line[0] in "+-"] == [
            "--- 2-a/config.yaml",
            "+++ config.yaml",
            "-rate: 2",
            "+rate: 3",
        ]
    # The clock was at its beginning in the meantime.
    (tmp_path / ".order").write_text("2-a\n9-a\n5-a\n")
    page_of(this, tmp_path / "page.html")
    assert facts_of(read(tmp_path / "page.html"))["configuration"]["before"] == "9-a"
    # One that was put elsewhere has no session before it.
    moved = this.rename(tmp_path / "5-a" / "copy.mcap")
    page_of(moved, tmp_path / "page.html")
    assert facts_of(read(tmp_path / "page.html"))["configuration"]["before"] == ""


def test_an_empty_session_has_a_page(tmp_path: Path) -> None:
    page_of(record(tmp_path / "session.mcap", []), tmp_path / "page.html")
    facts = facts_of(read(tmp_path / "page.html"))
    assert (facts["end"], facts["rows"], facts["story"]) == (0.0, [], [])


def test_what_is_no_recording_writes_nothing(tmp_path: Path) -> None:
    file = tmp_path / "notes.mcap"
    file.write_text("no recording")
    with pytest.raises(NotARecordingError):
        page_of(file, tmp_path / "page.html")
    assert [each.name for each in tmp_path.iterdir()] == ["notes.mcap"]


def test_a_page_that_cannot_be_written_leaves_nothing_behind(tmp_path: Path) -> None:
    recording = record(tmp_path / "session.mcap", [])
    output = tmp_path / "page.html"
    output.mkdir()
    with pytest.raises(OutputError, match=r"page\.html: Is a directory"):
        page_of(recording, output)
    with pytest.raises(OutputError, match="No such file or directory"):
        page_of(recording, tmp_path / "missing" / "page.html")
    assert sorted(each.name for each in tmp_path.iterdir()) == ["page.html", "session.mcap"]


def test_a_page_is_replaced_at_once(tmp_path: Path) -> None:
    output = tmp_path / "page.html"
    output.write_text("old")
    with output.open() as old:
        page_of(record(tmp_path / "session.mcap", []), output)
        assert old.read() == "old"
    assert output.read_text(encoding="utf-8").startswith("<!doctype html>")


def run(*arguments: str | os.PathLike[str]) -> subprocess.CompletedProcess[str]:
    command = [str(COMMAND), "report", *arguments]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)


def test_the_command_says_where_the_page_is(tmp_path: Path) -> None:
    recording = record(tmp_path / "session.mcap", [])
    result = run(recording)
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.startswith(f"{tmp_path / 'session.html'}: ")
    assert facts_of(read(tmp_path / "session.html"))["title"] == "robot"


def test_a_damaged_recording_has_a_page_that_says_so(tmp_path: Path) -> None:
    events = ordinary(tmp_path).read_bytes()
    active = tmp_path / "cut" / "session.mcap.active"
    active.parent.mkdir()
    active.write_bytes(events[: len(events) // 2])
    result = run(active)
    assert result.returncode == 5, result.stderr
    assert "the file ends within a record" in result.stderr
    facts = facts_of(read(active.with_name("session.html")))
    assert "Not everything could be read" in facts["notices"][0]
    assert "the file ends within a record" in facts["notices"][1]
    assert facts["marks"]


def test_the_command_refuses_in_a_sentence(tmp_path: Path) -> None:
    missing = run(tmp_path / "missing.mcap")
    assert (missing.returncode, missing.stdout) == (2, "")
    assert "No such file" in missing.stderr
    recording = record(tmp_path / "session.mcap", [])
    unwritable = run(recording, "-o", tmp_path / "missing" / "page.html")
    assert unwritable.returncode == 1
    assert "name another file with --output" in unwritable.stderr
    assert "Traceback" not in missing.stderr + unwritable.stderr


def test_times_before_the_start_count_as_the_start(tmp_path: Path) -> None:
    early = LogRecord(stamp_ns=BEGIN - 5 * SECOND, level=20, name="x", message="early")
    page_of(record(tmp_path / "session.mcap", [early]), tmp_path / "page.html")
    assert facts_of(read(tmp_path / "page.html"))["end"] == 0.0

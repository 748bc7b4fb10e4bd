"""The page of two sessions: the words of the text, numbers as bars, and proof against names."""

from __future__ import annotations

import base64
import hashlib
import math
import os
import re
from html import escape
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from play_launch.cli.output import OutputError, write_file
from play_launch.postmortem.comparison import (
    Change,
    Comparison,
    CrashChange,
    Measure,
    ParameterChange,
    compare,
)
from play_launch.postmortem.frames import Signature
from play_launch.postmortem.report.comparison import MOST, Words, comparison_page
from play_launch.postmortem.report.text import shown
from play_launch.postmortem.story import Story, read_story
from tests.cli.test_postmortem import run, scene
from tests.postmortem.report.recordings import HOSTILE
from tests.postmortem.report.test_page import Reader

WORDS = Words("The second session is worse.", [("Worse", ["/a is"])], [("Only in the first", [])])


@pytest.fixture(scope="module")
def stories(tmp_path_factory: pytest.TempPathFactory) -> tuple[Story, Story]:
    folder = tmp_path_factory.mktemp("stories")
    before = read_story(scene().record(folder / "before.mcap"))
    after = scene(crashes=1, memory=3 * 10**8).record(folder / "after.mcap")
    return before, read_story(after)


def page_of(stories: tuple[Story, Story], *changes: Change, words: Words = WORDS) -> str:
    return comparison_page(stories, Comparison(changes, (), (), (), (), (), (), (), ()), words)


def rows_of(page: str) -> list[str]:
    return re.findall(r"<tr[^>]*><td><bdi>(.*?)</bdi>", page.partition("<h2>Sessions")[0])


def hostile_comparison(text: str) -> Comparison:
    crash = CrashChange(Signature(text, (text, text)), (text, text), 0, 1)
    changes = tuple(Change(measure, text, 1e8, 3e8) for measure in Measure)
    crashes, texts = (crash,), (text,)
    parameters = (ParameterChange(text, text, text, None),)
    return Comparison(changes, crashes, crashes, crashes, crashes, texts, texts, texts, parameters)


def test_it_has_no_script_and_may_load_nothing(stories: tuple[Story, Story]) -> None:
    page = Reader(comparison_page(stories, compare(*stories), WORDS))
    digest = base64.b64encode(hashlib.sha256(page.texts["style"].encode()).digest()).decode()
    (policy,) = [
        each["content"]
        for tag, each in page.elements
        if each.get("http-equiv") == "Content-Security-Policy"
    ]
    assert policy == (
        f"default-src 'none'; style-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'"
    )
    for tag, attributes in page.elements:
        assert tag != "script"
        assert not attributes.keys() & {"src", "href", "style"}, tag
        assert not any(name.startswith("on") for name in attributes), tag
    dark = page.texts["style"].partition("@media screen and (prefers-color-scheme: dark) {")[2]
    assert dark.count("{") + 1 == dark.count("}")
    assert "--back: #0d1014" in dark


def test_the_verdict_comes_first(stories: tuple[Story, Story]) -> None:
    page = comparison_page(stories, compare(*stories), WORDS)
    titles = re.findall(r'<h2>(.*?)</h2>|"verdict bad">(.*?)<', page)
    assert ["".join(title) for title in titles] == [
        *("The second session is worse.", "Worse", "Time until a node is loaded first"),
        *("Restarts and reloads", "Crashes whose number differs", "Peak memory"),
        *("CPU, on average", "Sessions"),
    ]
    assert "SIGSEGV in demo::tick (libdemo.so)" in page
    assert '<td class="number">100.0</td><td class="number">300.0</td>' in page
    assert '<td class="number">+200.0</td><td>worse</td>' in page
    assert '<rect y="0" width="33.33%" height="6"/><rect y="7" width="100.00%"' in page


@pytest.mark.parametrize(("after", "shown"), [(50.04, "0.0"), (49.96, "0.0"), (50.06, "+0.1")])
def test_a_difference_that_is_not_shown_has_no_sign(
    stories: tuple[Story, Story], after: float, shown: str
) -> None:
    page = page_of(stories, Change(Measure.CPU, "/camera", 50, after))
    assert f'<td class="number">{shown}</td><td>' in page


def test_the_largest_difference_comes_first(stories: tuple[Story, Story]) -> None:
    changes = [Change(Measure.CPU, f"/{number}", 50, 50 + number) for number in range(20)]
    page = page_of(stories, *changes, Change(Measure.CPU, "/less", 50, 30.5))
    names = ["/less", *(f"/{number}" for number in reversed(range(20)))]
    assert rows_of(page) == names
    assert rows_of(page.partition("<details>")[0]) == names[:MOST]
    assert f"<summary>{21 - MOST} that" in page
    assert "<details>" not in page_of(stories, *changes[:MOST])


def test_who_was_never_restarted_has_no_row(stories: tuple[Story, Story]) -> None:
    quiet, busy = (Change(Measure.RESTARTS, who, n, n) for who, n in (("/q", 0), ("/b", 1)))
    assert rows_of(page_of(stories, quiet, busy)) == ["/b"]
    assert "Nothing was restarted" in page_of(stories, quiet)


@pytest.mark.parametrize("text", HOSTILE, ids=range(len(HOSTILE)))
def test_hostile_names_end_no_element(stories: tuple[Story, Story], text: str) -> None:
    words = Words(text, [(text, [text])], [(text, [text])])
    pages = [
        comparison_page(stories, hostile_comparison(name), each)
        for name, each in ((text, words), ("x", Words("x", [("x", ["x"])], [("x", ["x"])])))
    ]
    tags, expected = ([tag for tag, _ in Reader(page).elements] for page in pages)
    assert tags == expected
    assert pages[0].count(f"<bdi>{escape(shown(text))}</bdi>") >= len(Measure)


@given(before=st.floats(), after=st.floats(), measure=st.sampled_from(Measure))
@example(before=math.inf, after=math.nan, measure=Measure.CPU)
@example(before=math.nan, after=-math.inf, measure=Measure.PEAK_MEMORY)
def test_any_number_is_a_bar_within_its_cell(
    stories: tuple[Story, Story], before: float, after: float, measure: Measure
) -> None:
    page = page_of(stories, Change(measure, "/a", before, after), Change(measure, "/b", 1.0, 2.0))
    widths = [float(width) for width in re.findall(r' width="(.*?)%"', page)]
    assert len(widths) == 4
    assert all(0 <= width <= 100 for width in widths)


def test_what_cannot_be_read_is_said_of_its_session(tmp_path: Path) -> None:
    whole = scene().record(tmp_path / "whole.mcap")
    path = scene().record(tmp_path / "cut.mcap", finished=False)
    result = run("compare", whole, path, "-o", tmp_path / "page.html")
    assert result.returncode == 5
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Of the second session: The recording was not closed in order" in page
    assert "Of the first session" not in page
    assert 'class="notice"' not in page_of((read_story(whole), read_story(whole)))


def test_the_command_writes_the_words_that_it_says(tmp_path: Path) -> None:
    before = scene().record(tmp_path / os.fsdecode(b"before, no UTF-8 \xff.mcap"))
    after = scene(crashes=2, loaded_at=4.0).record(tmp_path / "after.mcap")
    output = tmp_path / "page.html"
    result, plain = run("compare", before, after, "-o", output), run("compare", before, after)
    assert (result.returncode, result.stderr) == (plain.returncode, "") == (1, "")
    assert result.stdout == plain.stdout
    page = output.read_text(encoding="utf-8")
    lines = [line.strip().removesuffix(":") for line in plain.stdout.splitlines()]
    assert len(lines) > 3
    for line in lines:
        assert f">{escape(line)}<" in page
    unwritable = run("compare", before, after, "-o", tmp_path / "missing" / "page.html")
    assert (unwritable.returncode, unwritable.stdout) == (1, "")
    assert "name another file with --output" in unwritable.stderr


def test_a_recording_is_not_replaced_by_a_page(tmp_path: Path) -> None:
    recording = scene().record(tmp_path / "session.mcap")
    content = recording.read_bytes()
    with pytest.raises(OutputError, match="is a recording; name another file with --output"):
        write_file(recording, "<html>")
    assert recording.read_bytes() == content
    assert [each.name for each in tmp_path.iterdir()] == ["session.mcap"]

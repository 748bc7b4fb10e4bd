"""The page in a real browser: it draws, follows mouse and keyboard, and can be printed."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from benchmarks.browser import Browser, find_browser
from play_launch.cli.report import report as write_report
from play_launch.postmortem.report.page import shown
from tests.postmortem.report.recordings import HOSTILE, gather, hostile, ordinary, page_of, record
from tests.postmortem.scenes import Scene
from tests.support.waiting import until

BROWSER = find_browser()
pytestmark = pytest.mark.skipif(
    BROWSER is None,
    reason="no Chromium; install one (Debian: chromium) or name it in PLAY_LAUNCH_BROWSER",
)
PLOTS = "[...document.querySelectorAll('canvas[data-range]')].map((each) => each.dataset.range)"
RANGE = "[axis.begin, axis.end]"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("browser")


@pytest.fixture(scope="module")
def browser(folder: Path) -> Iterator[Browser]:
    assert BROWSER is not None
    with Browser(BROWSER, folder / "profile") as started:
        started.size(1400, 900)
        yield started


@pytest.fixture(scope="module")
def page(folder: Path) -> Path:
    (folder / "ordinary").mkdir()
    assert write_report(ordinary(folder / "ordinary"), folder / "page.html") == 0
    return folder / "page.html"


@pytest.fixture(scope="module")
def hostile_page(folder: Path) -> Path:
    (folder / "hostile").mkdir()
    page = folder / "hostile.html"
    assert write_report(hostile(folder / "hostile"), page) == 0
    return page


@pytest.fixture
def opened(browser: Browser, page: Path) -> Iterator[Browser]:
    browser.prefer("light")
    browser.open(page)
    yield browser
    assert browser.errors == []
    assert browser.requests == [page.as_uri()]


def place_of_mark(browser: Browser, number: int) -> tuple[float, float]:
    """Where a mark is in the view; its row is scrolled to."""
    x, y = browser.run(
        f"""(() => {{
            const mark = facts.marks[{number}];
            byId('timeline-card').scrollIntoView();
            revealRow(mark.row);
            drawNow();
            const canvas = byId('timeline');
            const box = canvas.getBoundingClientRect();
            const row = timeline.shown.indexOf(mark.row);
            return [box.left + xOf(mark.at, plotWidth(canvas)),
                    box.top + (row + 0.5) * rowHeight - byId('rows').scrollTop];
        }})()"""
    )
    browser.drawn()
    return x, y


def opacities(browser: Browser, canvas: str, y: int) -> list[int]:
    """Those of the pixels of a canvas at a height, from left to right."""
    pixels: list[int] = browser.run(
        f"""(() => {{
            const canvas = document.querySelector('{canvas}');
            const line = canvas.getContext('2d').getImageData(0, {y}, canvas.width, 1);
            return [...line.data];
        }})()"""
    )
    return pixels[3::4]


def inked(browser: Browser, canvas: str) -> int:
    """How many pixels of a canvas are drawn on, right of the names."""
    count: int = browser.run(
        f"""(() => {{
            const canvas = document.querySelector('{canvas}');
            const left = labelWidth;
            const {{ data }} = canvas.getContext('2d').getImageData(
                left, 0, canvas.width - left, canvas.height);
            let count = 0;
            for (let i = 3; i < data.length; i += 4) if (data[i]) count++;
            return count;
        }})()"""
    )
    return count


def test_it_draws_everything(opened: Browser) -> None:
    assert opened.run("byId('failed').hidden")
    assert opened.run(PLOTS) == [opened.run("`0 ${axis.whole}`")] * 5
    for canvas in ("#timeline", "#plots canvas:nth-child(1)", "#plots canvas:nth-child(3)"):
        assert inked(opened, canvas) > 5000
    marks = opened.run("facts.marks.length")
    assert opened.run("document.querySelectorAll('#failures button').length") == marks > 10
    assert opened.run("byId('story').children.length") == 4
    # What explain says first leads to its moment.
    opened.run("byId('story').querySelector('button').click()")
    opened.drawn()
    first = opened.run("facts.story[0]")
    assert opened.run("facts.marks[timeline.mark].at") == pytest.approx(first["at"], abs=1)
    assert first["name"] in opened.run("byId('failure').innerText")


def test_the_script_reads_what_was_packed(opened: Browser, folder: Path) -> None:
    gathered = gather(folder / "ordinary" / "session.mcap")
    lines, lanes = gathered.lines, gathered.lanes()
    assert opened.run("data.lines.texts") == lines.texts
    assert opened.run("[...data.lines.rows]") == list(lines.rows)
    assert opened.run("[...data.lines.times]") == [round(at) for at in lines.times]
    assert opened.run("data.lanesOfRow.flat().length") == len(lanes.rows)
    for row, series in gathered.usage.of_rows.items():
        found: dict[str, Any] = opened.run(
            f"""(() => {{
                const {{ times, columns }} = data.seriesOfRow.get({row});
                return {{ times: [...times], columns: columns.map((each) => [...each]) }};
            }})()"""
        )
        assert found["times"] == [round(at) for at in series.times]
        for column, values in zip(found["columns"], series.columns, strict=True):
            step = (max(values) - min(values)) / 0xFFFE
            # The script has single precision.
            assert column == pytest.approx(list(values), abs=step + 1e-3, rel=1e-6)


def test_a_mark_opens_its_backtrace_and_the_log(opened: Browser) -> None:
    number = opened.run("facts.marks.findIndex((mark) => mark.backtrace.length > 2)")
    opened.click(*place_of_mark(opened, number))
    mark = opened.run(f"facts.marks[{number}]")
    shown = opened.run("byId('failure').innerText")
    assert mark["reason"] in shown
    assert "\n".join(mark["backtrace"]) in shown
    assert "Last output (20 lines)" in shown
    assert opened.run("byId('failures').querySelector('[aria-current]').dataset.mark") == str(
        number
    )
    # The log stands at that moment, on a line that is in sight.
    here = opened.run("document.querySelector('#log .here .time').textContent")
    assert here == opened.run(f"clock({mark['at']})")


def test_lines_without_a_name_may_be_of_its_nodes(browser: Browser, hostile_page: Path) -> None:
    browser.open(hostile_page)
    browser.run(
        "showFailure(facts.marks.findIndex((mark) => facts.rows[mark.row].kind === 'node'))"
    )
    assert browser.run("document.querySelector('#failure .output').innerText").endswith(HOSTILE[0])


def test_zoom_is_the_same_on_all_plots(opened: Browser) -> None:
    whole = opened.run(RANGE)
    x, y = opened.run(
        """(() => {
            byId('timeline-card').scrollIntoView();
            const box = plots[1].canvas.getBoundingClientRect();
            return [box.left + labelWidth + 400, box.top + 40];
        })()"""
    )
    under = opened.run(f"timeAt(plots[1].canvas, {x})")
    opened.mouse("mouseMoved", x, y)
    opened.mouse("mouseWheel", x, y, deltaX=0, deltaY=-300, modifiers=2)
    opened.until(f"axis.end - axis.begin < {whole[1]} * 0.5")
    opened.drawn()
    assert len(set(opened.run(PLOTS))) == 1
    assert opened.run(f"timeAt(plots[1].canvas, {x})") == pytest.approx(under)
    # Dragging over a part shows that part.
    first, second = opened.run(
        f"[timeAt(plots[1].canvas, {x}), timeAt(plots[1].canvas, {x + 100})]"
    )
    opened.mouse("mousePressed", x, y, button="left", buttons=1, clickCount=1)
    opened.mouse("mouseMoved", x + 100, y, button="left", buttons=1)
    opened.mouse("mouseReleased", x + 100, y, button="left", buttons=1, clickCount=1)
    opened.drawn()
    assert opened.run(RANGE) == pytest.approx([first, second])
    assert opened.run(PLOTS) == [f"{opened.run('`${axis.begin} ${axis.end}`')}"] * 5


def test_a_plain_wheel_scrolls_the_page(opened: Browser) -> None:
    before = opened.run(RANGE)
    opened.run("scrollTo(0, 0)")
    opened.mouse("mouseWheel", 300, 700, deltaX=0, deltaY=200)
    opened.until("scrollY > 0")
    assert opened.run(RANGE) == before


def test_it_is_used_by_keyboard(opened: Browser) -> None:
    opened.press("n")
    opened.press("n")
    assert opened.run("timeline.mark") == 1
    opened.press("p")
    assert opened.run("timeline.mark") == 0
    assert opened.run("byId('failure').hidden") is False
    near = opened.run(RANGE)
    opened.press("-")
    far = opened.run(RANGE)
    assert far[1] - far[0] > near[1] - near[0]
    opened.press("+")
    opened.press("ArrowRight")
    later = opened.run(RANGE)
    assert later[0] > near[0]
    opened.press("ArrowLeft")
    opened.press("0")
    assert opened.run(RANGE) == [0, opened.run("axis.whole")]
    shown = opened.run("timeline.shown.length")
    opened.press("f")
    assert opened.run("timeline.shown.length") == opened.run("facts.rows.length") > shown
    opened.press("?")
    assert opened.run("byId('help').open")
    opened.run("byId('help').close()")
    # In the list, arrows go from failure to failure, and the focus with them.
    opened.run("byId('failures').querySelector('button').focus()")
    opened.press("ArrowDown")
    opened.press("ArrowDown")
    assert opened.run("document.activeElement.dataset.mark") == str(opened.run("timeline.mark"))
    # What is typed into a field is no command.
    opened.press("/")
    assert opened.run("document.activeElement.id") == "search"
    opened.call("Input.insertText", text="fn0")
    assert opened.run("byId('search').value") == "fn0"


def test_the_log_is_searched(opened: Browser) -> None:
    opened.run("byId('search').value = 'QUEUE length'")
    opened.run("byId('search').dispatchEvent(new Event('input'))")
    opened.until("byId('log-count').textContent.includes(' of ')")
    found = opened.run("log.chosen.map((number) => data.lines.texts[number])")
    everything = opened.run("data.lines.texts")
    assert found == [text for text in everything if "queue length" in text.lower()] != []
    visible = opened.run(
        "[...document.querySelectorAll('#log .line')].filter((line) => !line.hidden)"
        ".map((line) => line.lastChild.textContent)"
    )
    assert visible == found[: len(visible)]
    assert 10 < len(visible) < 100
    # To the end: the elements are used again.
    opened.run("byId('log').scrollTop = 1e9")
    opened.until(f"byId('log-space').innerText.includes({found[-1]!r})")
    opened.run("byId('level').value = '40'; filterLog()")
    levels = opened.run("log.chosen.map((number) => data.lines.levels[number])")
    assert set(levels) == {40}
    opened.run(
        "byId('search').value = ''; byId('level').value = '0'; byId('log-range').checked = true"
    )
    opened.run("setRange(60000, 90000); filterLog()")
    times = opened.run("log.chosen.map((number) => data.lines.times[number])")
    assert times[0] >= 60000
    assert times[-1] <= 90001


@pytest.mark.parametrize(
    ("typed", "milliseconds"),
    [("75", 75000), ("1:15", 75000), ("1:02:03.5s", 3723500), (" 2 s", 2000), ("soon", None)],
)
def test_times_can_be_typed(opened: Browser, typed: str, milliseconds: int | None) -> None:
    assert opened.run(f"parseClock({typed!r})") == milliseconds


def test_a_spike_of_one_sample_stays_visible(opened: Browser) -> None:
    """In the whole session, too, where many samples fall into one pixel."""
    opened.run(
        """(() => {
            const one = data.series[0];
            one.columns[0].fill(1);
            for (const each of data.series) each.columns[0].fill(1);
            one.columns[0][100] = 100;
            plots[0].key = '';
            timeline.selected = -1;
            drawNow();
        })()"""
    )
    spike = opened.run("Math.floor(xOf(data.series[0].times[100], plotWidth(plots[0].canvas)))")
    line = opacities(opened, "#plots canvas:nth-child(1)", 40)
    assert max(line[spike - 2 : spike + 3]) > 60
    away = line[spike + 6 : spike + 40]
    assert sum(value > 0 for value in away) < len(away) / 2  # lines of the grid


def test_pointing_at_a_row_singles_its_node_out(opened: Browser) -> None:
    before = opened.run("document.querySelector('#plots canvas').toDataURL()")
    x, y = place_of_mark(opened, 0)
    opened.mouse("mouseMoved", x - 40, y)
    opened.drawn()
    assert opened.run("timeline.hovered") == opened.run("facts.marks[0].row")
    assert opened.run("byId('tip').hidden") is False
    assert opened.run("document.querySelector('#plots canvas').toDataURL()") != before


def test_it_is_dark_where_the_browser_prefers_that(opened: Browser) -> None:
    light = opened.run("getComputedStyle(document.body).backgroundColor")
    picture = opened.run("byId('timeline').toDataURL()")
    opened.prefer("dark")
    opened.until("document.documentElement.dataset.theme === 'dark'")
    opened.drawn()
    assert opened.run("getComputedStyle(document.body).backgroundColor") != light
    assert opened.run("byId('timeline').toDataURL()") != picture
    opened.press("d")
    assert opened.run("document.documentElement.dataset.theme") == "light"
    assert opened.run("byId('timeline').toDataURL()") == picture


def test_it_prints_light_with_every_row(opened: Browser) -> None:
    opened.press("n")
    opened.prefer("dark")
    opened.until("document.documentElement.dataset.theme === 'dark'")
    opened.run(
        """addEventListener('beforeprint', () => {
            window.printed = [document.documentElement.dataset.theme,
                              byId('timeline').clientHeight, byId('log-print').textContent];
        })"""
    )
    assert opened.paper().startswith(b"%PDF")
    theme, height, written = opened.run("printed")
    assert theme == "light"
    assert height == opened.run("timeline.shown.length * rowHeight")
    assert opened.run("facts.marks[0].reason") in written
    assert opened.run("document.documentElement.dataset.theme") == "dark"


def test_hostile_text_is_text(browser: Browser, hostile_page: Path) -> None:
    page = hostile_page
    browser.open(page)
    title = browser.run("document.title")
    browser.run("facts.marks.forEach((_, number) => showFailure(number))")
    browser.press("f")
    browser.run("byId('log').scrollTop = 1e9")
    browser.drawn()
    assert browser.run("document.title") == title != "owned"
    assert browser.run("document.querySelectorAll('main img, main script').length") == 0
    assert browser.run("byId('title').textContent") == HOSTILE[0]
    assert browser.run(f"data.lines.texts.includes({HOSTILE[1]!r})")
    text = browser.run("document.body.innerText")
    assert not re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]", text)
    assert browser.errors == []
    assert browser.requests == [page.as_uri()]


def test_parameters_are_shown_when_their_node_is_opened(browser: Browser, folder: Path) -> None:
    made = Scene()
    made.started()
    made.parameters(1, "/arm", speed=1.0, frame=HOSTILE[0])
    made.parameters_changed(2, "/arm", changed={"speed": 2.5})
    made.no_parameters(3, "/deaf", "it did not answer in time")
    page = folder / "parameters.html"
    assert write_report(made.record(folder / "parameters.mcap"), page) == 0
    browser.open(page)
    nodes = "[...byId('parameters').querySelectorAll('details')]"
    assert not browser.run("byId('parameters-card').hidden")
    assert browser.run(f"{nodes}.map((each) => each.querySelector('summary').textContent)") == [
        "/arm (2 parameters, 1 change)",
        "/deaf (0 parameters)",
    ]
    cells = "byId('parameters').querySelectorAll('td')"
    assert browser.run(f"{cells}.length") == 0
    browser.run(f"{nodes}.forEach((each) => each.querySelector('summary').click())")
    until(lambda: browser.run(f"{cells}.length") == 8, "the tables")
    texts = browser.run(f"[...{cells}].map((each) => each.textContent)")
    assert texts == [
        *("frame", json.dumps(shown(HOSTILE[0])), "speed", "2.5"),
        *("2 s", "speed", "1.0", "2.5"),
    ]
    assert "it did not answer in time" in browser.run("byId('parameters').textContent")
    assert browser.run("document.title") != "owned"
    assert browser.errors == []
    browser.open(folder / "page.html")


def test_the_policy_stops_what_would_be_injected(browser: Browser, page: Path) -> None:
    """Were a text ever put in as markup, it would still run nothing and load nothing."""
    browser.open(page)
    browser.run(
        """(() => { const box = document.createElement('div');
        box.innerHTML = "<img src='http://192.0.2.1/x' onerror='document.title = 1'>"
            + "<iframe src='http://192.0.2.1/'></iframe>";
        document.body.append(box);
        const script = document.createElement('script');
        script.textContent = "document.title = 'owned'";
        document.body.append(script); })()"""
    )

    def refused() -> str:
        browser.run("1")  # takes what has happened
        return " ".join(each for each in browser.errors if "Content Security Policy" in each)

    words = ("inline event handler", "inline script", "Loading the image", "Framing")
    until(lambda: all(word in refused() for word in words), "four refusals")
    assert browser.run("document.title") not in {"1", "owned"}


def test_an_empty_session_is_shown(browser: Browser, folder: Path) -> None:
    page = folder / "empty.html"
    page_of(record(folder / "empty" / "session.mcap", []), page)
    browser.open(page)
    assert browser.run("byId('failed').hidden")
    assert "Nothing went wrong" in browser.run("byId('story-card').innerText")
    for key in ("n", "p", "+", "-", "f", "0"):
        browser.press(key)
    assert browser.errors == []


@pytest.mark.parametrize("name", ["page", "hostile"])
def test_it_fits_a_narrow_window(
    browser: Browser, page: Path, hostile_page: Path, name: str
) -> None:
    browser.open(page if name == "page" else hostile_page)
    for width in (390, 700):
        browser.size(width, 900)
        browser.drawn()
        assert browser.run("document.documentElement.scrollWidth <= innerWidth")
        # How the system came up is drawn, too.
        assert browser.run("document.querySelector('.stretch').offsetWidth >= 90")
    browser.press("n")
    assert browser.run("byId('failure').hidden") is False
    browser.size(1400, 900)
    browser.drawn()
    assert browser.run("document.documentElement.scrollWidth <= innerWidth")

"""The page of a real session, in a real browser, and its metrics."""

from __future__ import annotations

import asyncio
import json
import os
import re
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import axe_core_python
import psutil
import pytest
from prometheus_client.openmetrics.parser import text_string_to_metric_families

from benchmarks.browser import Browser, BrowserError, find_browser
from play_launch.cli.web import commands
from play_launch.cli.web.watch import Watch
from tests.cli.top.rows import row
from tests.cli.web.server import Server, serving
from tests.cli.web.test_admission import answers
from tests.integration.test_own_diagnostics import MONITOR
from tests.support.replay import Replay, replaying, run
from tests.support.waiting import until

if TYPE_CHECKING:
    from play_launch.control.client import ControlClient

PAGE = Path(__file__).parents[3] / "docs" / "web.md"
BROWSER = find_browser()
needs_browser = pytest.mark.skipif(
    BROWSER is None,
    reason="no Chromium; install one (Debian: chromium) or name it in PLAY_LAUNCH_BROWSER",
)
CONFIG = """\
version: 1
name: shown
environment: {ROS_AUTOMATIC_DISCOVERY_RANGE: LOCALHOST}
containers:
  - name: chat
    container_type: isolated
    composable_nodes:
      - package: play_launch_demo
        plugin: play_launch_demo::Talker
        name: talker
        expect: {chatter: {publishers: 1, min_rate: 5 Hz}}
"""
DIALOG = "document.querySelector('.q-dialog')"
BUTTONS = "[...document.querySelectorAll('button')]"


def test_the_configurations_of_the_documentation_are_right(tmp_path: Path) -> None:
    examples = re.findall(r"```yaml\n(version: .*?)```", PAGE.read_text(), re.DOTALL)
    assert len(examples) == 2
    for example in examples:
        config = tmp_path / "robot.yaml"
        config.write_text(example)
        run("check", config, code=0)


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Replay]:
    config = tmp_path / "shown.yaml"
    config.write_text(CONFIG)
    with replaying(config, tmp_path / "log") as replay:
        replay.read_until_states({"/talker": "loaded"})
        yield replay


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Browser]:
    assert BROWSER is not None
    with Browser(BROWSER, tmp_path / "profile") as started:
        started.size(1200, 900)
        yield started


def row_of(name: str) -> str:
    """The text of a row, as an expression of JavaScript."""
    return (
        "[...document.querySelectorAll('tbody tr')].map((each) => each.innerText)"
        f".find((each) => each.includes('{name}')) ?? ''"
    )


def click(browser: Browser, label: str) -> None:
    button = f"{BUTTONS}.findLast((each) => each.innerText.trim() === '{label}')"
    browser.until(f"{button} !== undefined")
    browser.run(f"{button}.click()")


def unfold(browser: Browser, title: str) -> None:
    heads = "[...document.querySelectorAll('.q-expansion-item .q-item')]"
    browser.run(f"{heads}.find((each) => each.innerText.includes('{title}')).click()")


def visit(browser: Browser, server: Server, state: str = "loaded") -> None:
    until(lambda: answers(server), "the page")
    browser.call("Page.navigate", url=server.invitations[-1])
    browser.until(f"({row_of('/talker')}).includes('{state}')")


def test_metrics_tell_the_states(session: Replay) -> None:
    with serving("--session", session.pid) as server:
        until(lambda: answers(server), "the page")
        status, headers, text = server.get("/metrics")
        assert status == 200
        assert headers["content-type"].startswith("application/openmetrics-text")
        families = {each.name: each for each in text_string_to_metric_families(text)}
        states = families["play_launch_unit_state"].samples
        up = {each.labels["unit"]: each.value for each in states if "up" in each.labels.values()}
        assert up == {"/chat": 1, "/chat:/talker": 1}
        assert families["play_launch_unit_restarts"].samples[0].name.endswith("_total")
        assert families["play_launch_session_up"].samples[0].value == 1
        (start,) = families["play_launch_session_start_seconds"].samples
        assert 0 < start.value < 60
        os.kill(session.pids()["/talker"], signal.SIGSEGV)
        session.read_until_states({"/talker": "crashed"})
        text = server.get("/metrics")[2]
        failed = (
            'failures_total{cause="signal",kind="component",machine="",unit="/chat:/talker"} 1.0'
        )
        assert failed in text
        session.read_until_states({"/talker": "loaded"})
        met = {"event": "expectation", "topic": "/chatter", "is_met": True}
        if not session.told(**met):  # before the crash
            session.until(**met)
        text = server.get("/metrics")[2]
        assert 'play_launch_topic_as_expected{machine="",topic="/chatter"} 1.0' in text
        assert 'play_launch_topic_breaks_total{machine="",topic="/chatter"} 0.0' in text
        assert "play_launch_recording_dropped_total 0" in text
        assert "play_launch_recording_lag_seconds 0" in text
        session.process.send_signal(signal.SIGINT)
        session.read_all()
        until(lambda: 'session_up{session=""} 0.0' in server.get("/metrics")[2], "its end")


def test_sessions_have_their_reports(session: Replay) -> None:
    with serving("--session", session.pid) as server:
        until(lambda: answers(server), "the page")
        name = session.bag.parent.resolve().name
        assert f"/report/{name}" in server.get("/sessions")[2]
        status, headers, text = server.get(f"/report/{name}")
        assert status == 200
        assert headers["content-type"].startswith("text/html")
        assert "/talker" in text
        for other in ("nothing", "..", "%2e%2e", "..%2f..%2fetc"):
            assert server.status(f"/report/{other}") in {404, 503}


@needs_browser
def test_the_connections_are_checked(session: Replay, browser: Browser) -> None:
    with serving("--session", session.pid) as server:
        visit(browser, server)
        try:
            unfold(browser, "Connections")
            browser.until("document.body.innerText.includes('everything connects')")
        finally:
            run("daemon", "stop", code=0)


@needs_browser
def test_what_nodes_report_is_shown(tmp_path: Path, browser: Browser) -> None:
    script, repaired = tmp_path / "monitor.py", tmp_path / "repaired"
    script.write_text(MONITOR)
    command = json.dumps([sys.executable, str(script), str(repaired)])
    config = tmp_path / "shown.yaml"
    config.write_text(f"{CONFIG}nodes:\n  - {{name: monitor, command: {command}}}\n")
    with replaying(config, tmp_path / "log") as replay, serving("--session", replay.pid) as server:
        visit(browser, server)
        unfold(browser, "Diagnostics")
        browser.until("/lidar: data\\s+ERROR: no data/.test(document.body.innerText)")
        repaired.touch()
        browser.until("/lidar: data\\s+OK: fine/.test(document.body.innerText)")
        children = psutil.Process(server.process.pid).children()
        (listener,) = (each for each in children if "--listen" in each.cmdline())
        browser.call("Page.navigate", url="about:blank")
        psutil.wait_procs([listener], 40)
        assert not listener.is_running()


def test_a_listener_that_has_much_to_tell_at_its_end_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = tmp_path / "play-launch"
    script.write_text(
        "#!/usr/bin/env python3\n"
        "import json, signal, threading\n"
        "stop = threading.Event()\n"
        "signal.signal(signal.SIGTERM, lambda *_: stop.set())\n"
        "line = json.dumps({'name': 'lidar'})\n"
        "print(line, flush=True)\n"
        "stop.wait()\n"
        "for _ in range(500_000): print(line)\n"
    )
    script.chmod(0o755)
    monkeypatch.setattr(commands, "program", lambda: script)

    async def scenario() -> None:
        asked = commands.Commands(None)
        listening = asyncio.create_task(asked.run())
        while not asked.diagnostics("/log"):
            await asyncio.sleep(0.02)
        listening.cancel()
        await asyncio.wait([listening], timeout=60)
        assert listening.done()

    asyncio.run(scenario())


@needs_browser
def test_topics_are_compared_with_what_is_expected(session: Replay, browser: Browser) -> None:
    session.until(event="expectation", topic="/chatter", is_met=True)
    with serving("--session", session.pid) as server:
        visit(browser, server)
        unfold(browser, "Topics")
        browser.until("document.body.innerText.includes('as expected')")
        session.ask("unload", "talker", code=0)
        browser.until("document.body.innerText.includes('0 publishers instead of 1')")


@needs_browser
def test_how_the_system_came_up_is_a_click_away(session: Replay, browser: Browser) -> None:
    with serving("--session", session.pid) as server:
        visit(browser, server)
        link = "[...document.querySelectorAll('a')].find((each) => each.innerText === 'Bring-up')"
        browser.until(f"{link}.href.includes('/report/')")
        browser.call("Page.navigate", url=browser.run(f"{link}.href"))
        browser.until("document.documentElement.dataset.ready === 'yes'")
        shown = browser.run("document.querySelector('#bring-up-card').innerText")
        assert "The last was /talker (loaded)" in shown
        place = "document.querySelector('#bring-up-card').getBoundingClientRect()"
        browser.until(f"{place}.top >= 0 && {place}.bottom <= innerHeight")


@needs_browser
def test_a_bring_up_moves_on_the_page(tmp_path: Path, browser: Browser) -> None:
    slow = "plugin: play_launch_demo::SlowConstructor\n        parameters: {seconds: 8.0}"
    config = tmp_path / "shown.yaml"
    config.write_text(CONFIG.replace("plugin: play_launch_demo::Talker", slow))

    def shows(text: str) -> bool:
        with suppress(BrowserError):  # it is being loaded again
            return bool(browser.run(f"document.body.innerText.includes('{text}')"))
        return False

    with (
        replaying(config, tmp_path / "log") as replay,
        serving("--session", replay.pid) as server,
    ):
        visit(browser, server, "loading")
        page = f"report/{replay.bag.parent.resolve().name}"
        browser.call("Page.navigate", url=f"{server.url}{page}")
        until(lambda: shows("Never came up: /talker."), "its state")
        until(lambda: shows("The last was /talker (loaded)"), "its end")
        assert "refresh" not in server.get(f"/{page}")[1]


@pytest.mark.parametrize(("age", "expected"), [(1, True), (600, False)])
def test_an_old_session_does_not_come_up(age: int, expected: bool) -> None:
    watch = Watch(None)
    watch.rows = [row("/talker", "starting")]
    hello = SimpleNamespace(folder="/log/one", started_ns=time.time_ns() - age * 1_000_000_000)
    watch._client = cast("ControlClient", SimpleNamespace(hello=hello))
    assert watch.comes_up("one") is expected
    assert not watch.comes_up("another")


@needs_browser
def test_a_crash_appears_and_a_click_reloads(session: Replay, browser: Browser) -> None:
    with serving("--session", session.pid, "--allow-control", count=2) as server:
        visit(browser, server)
        curves = "each.querySelectorAll('polyline').length === 2"  # CPU and memory
        browser.until(f"[...document.querySelectorAll('tbody tr')].some((each) => {curves})")
        os.kill(session.pids()["/talker"], signal.SIGSEGV)
        browser.until(f"/loaded\\s.*\\s1\\s/s.test({row_of('/talker')})")
        click(browser, "/talker")
        browser.until("document.body.innerText.includes('SIGSEGV')")
        click(browser, "reload")
        browser.until("document.body.innerText.includes('reload /talker?')")
        click(browser, "reload")
        browser.until("document.body.innerText.includes('/talker reloaded')")
        browser.until("document.querySelector('.q-dialog').innerText.includes('publishing')")
        unfold(browser, "Findings")
        browser.until("document.body.innerText.includes('/talker in /chat crashed at')")
        browser.until("document.body.innerText.includes('Cause: SIGSEGV')")
        assert not browser.errors


@needs_browser
def test_parameters_are_shown_and_set(session: Replay, browser: Browser) -> None:
    with serving("--session", session.pid, "--allow-control", count=2) as server:
        visit(browser, server)
        click(browser, "/talker")
        browser.until(f"{DIALOG}.innerText.includes('Declared')")
        unfold(browser, "Parameters")
        browser.until(f"/rate\\s+10.0?\\s/.test({DIALOG}.innerText)")
        field = f"{DIALOG}.querySelector('[aria-label=\"New value\"]')"
        browser.run(f"{field}.value = '4.0', {field}.dispatchEvent(new Event('input'))")
        click(browser, "SET")
        browser.until(f"/rate\\s+4.0?\\s/.test({DIALOG}.innerText)")
    assert session.ask("param", "get", "/talker", "rate").stdout.strip() == "4.0"


@needs_browser
def test_it_is_accessible(session: Replay, browser: Browser) -> None:
    script = Path(axe_core_python.__file__).with_name("axe.min.js").read_text(encoding="utf-8")
    found = "axe.run().then((all) => all.violations.map((each) => [each.id, each.nodes[0].html]))"
    with serving("--session", session.pid, "--allow-control", count=2) as server:
        visit(browser, server)
        browser.run(f"{script};0")
        assert browser.run(found) == []
        click(browser, "/talker")
        browser.until(f"{DIALOG}.innerText.includes('Declared')")
        assert browser.run(found) == []
        browser.call("Page.navigate", url=server.invitations[-1].replace("?", "sessions?"))
        browser.until("document.body.innerText.includes(', running')")
        browser.run(f"{script};0")
        assert browser.run(found) == []


@needs_browser
def test_a_read_only_page_has_no_buttons(session: Replay, browser: Browser) -> None:
    browser.size(390, 800)
    with serving("--session", session.pid) as server:
        visit(browser, server)
        assert browser.run("document.documentElement.scrollWidth") == 390
        click(browser, "/talker")
        browser.until("document.querySelector('.q-dialog').innerText.includes('Declared')")
        labels = browser.run(f"{BUTTONS}.map((each) => each.innerText.trim())")
        assert not {"stop", "restart", "reload", "unload"} & set(labels)
        problem = "document.querySelector('[role=alert]').innerText"
        session.process.send_signal(signal.SIGSTOP)
        browser.until(f"{problem}.includes('has not answered for')")
        session.process.send_signal(signal.SIGCONT)
        browser.until(f"{problem} === ''")
        session.process.send_signal(signal.SIGINT)
        session.read_all()
        browser.until(f"{problem} !== ''")
        hosts = {each.partition("//")[2].partition("/")[0] for each in browser.requests}
        assert hosts <= {f"127.0.0.1:{server.port}"}, "the page works without a network"


def test_a_page_belongs_to_a_system(tmp_path: Path) -> None:
    config = tmp_path / "shown.yaml"
    config.write_text(f"{CONFIG}web: {{port: 0, allow_control: true}}\n")
    with replaying(config, tmp_path / "log") as replay:
        look = replay.until(event="output", process="page")
        act = replay.until(event="output", process="page")
        assert look["text"].endswith("(to look)")
        assert act["text"].endswith("(to act)")
        secret = act["text"].partition("token=")[2].partition(" ")[0]
        first = psutil.Process(act["pid"])
        server = Server(replay.process, [act["text"]])
        until(lambda: answers(server), "the page")
        assert 'unit="/chat:/talker"' in server.get("/metrics", Authorization=f"Bearer {secret}")[2]
        first.kill()
        logged = replay.until(event="log", name="play_launch.process.companion")
        assert "started again" in logged["message"]
        again = replay.until(event="output", process="page")
        assert again["pid"] != first.pid
        second = psutil.Process(again["pid"])
        assert [row["name"] for row in json.loads(replay.ask("ps", "--json").stdout)] == [
            "/chat",
            "/talker",
        ]
        replay.process.send_signal(signal.SIGINT)
        replay.read_all()
        assert replay.process.wait(20) == 128 + signal.SIGINT
        assert not second.is_running()
        assert secret.encode() not in replay.bag.read_bytes()


def test_a_page_ends_with_a_supervisor_that_is_killed(tmp_path: Path) -> None:
    config = tmp_path / "brief.yaml"
    config.write_text("version: 1\nweb: {port: 0}\nnodes: [{command: [sleep, '1000']}]\n")
    with replaying(config, tmp_path / "log") as replay:
        page = psutil.Process(replay.until(event="output", process="page")["pid"])
        replay.process.kill()
        until(lambda: not page.is_running(), "the end of the page")


def test_a_system_that_ends_at_once_needs_no_page(tmp_path: Path) -> None:
    config = tmp_path / "brief.yaml"
    config.write_text(
        "version: 1\nweb: {port: 0}\nnodes: [{command: [sleep, '0.2'], on_exit: shutdown}]\n"
    )
    done = run("replay", config, "--log-dir", tmp_path / "log", code=0)
    assert "the session can no longer be controlled" not in done.stdout + done.stderr
    assert "page" not in done.stdout


def test_the_demo_has_a_page(tmp_path: Path) -> None:
    words = ("demo", "--web", "--seconds", "18", "--json", "--log-dir", str(tmp_path))
    events = [json.loads(line) for line in run(*words).stdout.splitlines()]
    said = [each.get("text") or each.get("message", "") for each in events]
    # The port may be taken, and then this is said.
    assert any("http://127.0.0.1:8080/?token=" in each or "--port 8080" in each for each in said)
    crashed = {each["node"] for each in events if each.get("state") == "crashed"}
    assert crashed == {"/unlucky"}
    found = {each["topic"]: each["is_met"] for each in events if each["event"] == "expectation"}
    assert found == {"/chatter": True, "/heartbeat": False}
    explained = json.loads(run("explain", "--json", tmp_path / "latest", code=1).stdout)
    assert "/heartbeat" in {each["name"] for each in explained["findings"]}

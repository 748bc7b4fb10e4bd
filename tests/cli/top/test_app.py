"""The screen without a terminal, on the real protocol, before sessions that do what is wanted."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Callable, Coroutine
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from blockbuster import blockbuster_ctx
from textual.widgets import Input
from textual.widgets._footer import FooterKey

from play_launch.cli.top.app import ScreenEnd, TopApp
from play_launch.cli.top.modals import Question
from play_launch.control.messages import SessionHello
from play_launch.control.protocol import Code, OperationError
from play_launch.control.registration import LINKS, ControlSocket
from play_launch.control.server import serving
from play_launch.control.sessions import connect_to
from tests.cli.top.rows import NOTHING
from tests.support.waiting import LIMIT

if TYPE_CHECKING:
    from textual.pilot import Pilot

    from play_launch.control.messages import Caller, Request

ABOUT = SessionHello(
    version="0.1.0", pid=1, name="robot", session="6c1f", folder="/robot", started_ns=7
)


def row(name: str, state: str = "running", kind: str = "process", **fields: Any) -> dict[str, Any]:
    return {**NOTHING, "name": name, "kind": kind, "state": state, **fields}


def output(text: str, source: str = "/a") -> dict[str, Any]:
    level = 40 if text.startswith("[ERROR]") else 20
    return {"event": "output", "stamp_ns": 0, "source": source, "text": text, "level": level}


class Session:
    """Answers as it is set up to."""

    def __init__(self) -> None:
        self.rows: Any = [row("/a"), row("/b", "stopped"), row("/camera", cpu_percent=5.0)]
        self.asked = 0
        self.operations: list[tuple[str, dict[str, Any]]] = []
        self.answer: Callable[[], Coroutine[Any, Any, object]] = self._done
        self.caller: Caller | None = None
        self.is_followed = asyncio.Event()

    async def __call__(self, request: Request, caller: Caller) -> object:
        match request.op:
            case "ps":
                self.asked += 1
                return self.rows
            case "events":
                self.caller = caller
                self.is_followed.set()
                await asyncio.Event().wait()
        self.operations.append((request.op, json.loads(bytes(request.arguments))))
        return await self.answer()

    async def _done(self) -> object:
        return {"results": []}

    async def say(self, *events: dict[str, Any]) -> None:
        async with asyncio.timeout(LIMIT):
            await self.is_followed.wait()
        assert self.caller is not None
        for event in events:
            await self.caller.send("event", event)


class Scene:
    """A session, the screen before it, and a person."""

    def __init__(self, session: Session, app: TopApp, pilot: Pilot[ScreenEnd]) -> None:
        self.session = session
        self.app = app
        self.press = pilot.press
        self.resize = pilot.resize_terminal

    def lines(self, pane: str) -> list[str]:
        widget = self.app.screen_stack[0].query_one(pane if pane == "Footer" else f"#{pane}")
        texts = [widget.render_line(y).text.rstrip() for y in range(widget.size.height)]
        return [text for text in texts if text]

    def footer(self) -> str:
        keys = self.app.screen_stack[0].query(FooterKey)
        return "  ".join(f"{key.key_display} {key.description}" for key in keys)

    def names(self) -> list[str]:
        return [row.name for row in self.app.shown]

    async def until(self, done: Callable[[], bool], what: str) -> None:
        try:
            async with asyncio.timeout(LIMIT):
                while not done():
                    await asyncio.sleep(0.02)
        except TimeoutError:
            raise AssertionError(
                f"waited for {what}; {self.lines('table')} {self.footer()}"
            ) from None

    async def until_asked(self, question: str) -> None:
        def is_asked() -> bool:
            screen = self.app.screen
            return (
                isinstance(screen, Question)
                and screen.is_mounted
                and question in str(screen.query("Static").first().render())
            )

        await self.until(is_asked, question)


@pytest.fixture(autouse=True)
def links(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(LINKS, str(tmp_path / "links"))


@contextlib.asynccontextmanager
async def shown(folder: Path, size: tuple[int, int] = (80, 24)) -> AsyncIterator[Scene]:
    session = Session()
    async with contextlib.AsyncExitStack() as opened:
        door = await asyncio.to_thread(ControlSocket, str(folder))
        opened.callback(door.close)
        await opened.enter_async_context(serving(door, ABOUT, session))
        client = opened.enter_context(await asyncio.to_thread(connect_to, str(folder)))
        app = TopApp(client)
        pilot = await opened.enter_async_context(app.run_test(size=size))
        scene = Scene(session, app, pilot)
        await scene.until(lambda: app.rows is not None, "rows")
        await pilot.pause()
        with blockbuster_ctx("play_launch"):
            yield scene


def acted(folder: Path, act: Callable[[Scene], Coroutine[Any, Any, None]], **how: Any) -> ScreenEnd:
    """Let a person act; return why the screen was left."""

    async def main() -> ScreenEnd:
        async with shown(folder, **how) as scene:
            await act(scene)
            await scene.press("q")
        end = scene.app.return_value
        assert end is not None
        return end

    return asyncio.run(main())


def test_what_runs_is_shown_at_80_by_24(tmp_path: Path) -> None:
    async def act(scene: Scene) -> None:
        await scene.session.say(output("[INFO] [1.5] [a]: hello"))
        await scene.until(lambda: "hello" in "".join(scene.lines("log")), "a line")
        assert scene.lines("head")[0].startswith("robot (pid ")
        assert scene.lines("head")[0].endswith("2 of 3 up, 1 inactive")
        title, first = scene.lines("table")[:2]
        assert title.split() == [
            "NAME", "STATE", "PID", "UP", "RST", "CPU%", "MEM", "LAST", "LINE",
        ]  # fmt: skip
        assert first.split() == ["/a", "running", "-", "-", "0", "-", "-", "hello"]
        assert scene.lines("detail") == ["/a, process"]
        await scene.until(lambda: "r restart  x stop" in scene.footer(), "the keys")

    assert acted(tmp_path, act) == ScreenEnd()


@pytest.mark.parametrize(
    ("key", "answer", "operations"),
    [
        ("r", "y", [("restart", "/a")]),
        ("x", "y", [("stop", "/a")]),
        ("x", "n", []),
        ("x", "escape", []),
        ("x", "enter", []),
        ("x", "q", []),
    ],
)
def test_only_a_yes_does_something(
    tmp_path: Path, key: str, answer: str, operations: list[tuple[str, str]]
) -> None:
    async def act(scene: Scene) -> None:
        await scene.press(key)
        await scene.until_asked(" /a?")
        await scene.press(answer)
        await scene.until(lambda: len(scene.app.screen_stack) == 1, "the question to go")
        if operations:
            await scene.until(lambda: "ed" in scene.lines("detail")[0], "the outcome")
        found = [(name, *asked["names"]) for name, asked in scene.session.operations]
        assert found == operations

    acted(tmp_path, act)


def test_what_failed_says_why(tmp_path: Path) -> None:
    async def refuse() -> object:
        raise OperationError(Code.REFUSED, "the session is \x1b[2Jbeing stopped")

    async def act(scene: Scene) -> None:
        scene.session.answer = refuse
        await scene.press("r", "y")
        await scene.until(lambda: "failed" in scene.lines("detail")[0], "the failure")
        assert scene.lines("detail") == ["restart /a failed: the session is being stopped"]

    acted(tmp_path, act)


def test_keys_that_are_typed_ahead_are_what_they_are_meant_to_be(tmp_path: Path) -> None:
    async def act(scene: Scene) -> None:
        # Among the letters are keys that would do something.
        await scene.press("slash", *"sys", "ctrl+u", *"camra", "backspace", "backspace", *"era")
        assert scene.app.screen.query_one(Input).value == "camera"
        await scene.press("enter", "r")
        await scene.until_asked("restart /camera?")
        assert scene.session.operations == []
        await scene.press("n")
        assert scene.names() == ["/camera"]
        assert "1 with 'camera'" in scene.lines("head")[0]
        await scene.press("escape")
        assert scene.names() == ["/a", "/b", "/camera"]
        assert scene.lines("detail") == ["/camera, process"], "the selection stays"

    acted(tmp_path, act)


def test_rows_are_sorted_and_the_selection_stays_with_its_row(tmp_path: Path) -> None:
    async def act(scene: Scene) -> None:
        await scene.press("down")
        orders = []
        for _ in range(7):
            await scene.press("o")
            orders.append(scene.names())
        assert orders[0] == ["/a", "/b", "/camera"]
        assert orders[2] == ["/camera", "/a", "/b"], "by CPU"
        assert orders[6] == ["/a", "/b", "/camera"]
        await scene.press("o", "O")
        assert scene.names() == ["/camera", "/b", "/a"]
        assert scene.lines("detail") == ["/b, process"]
        assert scene.lines("head")[0].endswith("; by name, reversed")
        # It goes: what stands in its place is selected then.
        scene.session.rows = [each for each in scene.session.rows if each["name"] != "/b"]
        await scene.until(lambda: scene.names() == ["/camera", "/a"], "a row less")
        assert scene.lines("detail") == ["/a, process"]
        scene.session.rows = []
        await scene.until(lambda: scene.lines("detail") == ["nothing is declared"], "no rows")
        await scene.press("r", "down", "enter", "end")
        assert scene.lines("detail") == ["nothing is declared"]

    acted(tmp_path, act)


def test_the_log_is_chosen_and_scrolled(tmp_path: Path) -> None:
    async def act(scene: Scene) -> None:
        lines = [output(f"line {number}", "/b" if number % 2 else "/a") for number in range(100)]
        await scene.session.say(*lines, output("[ERROR] [1.5] [x]: bad"))
        await scene.until(lambda: "bad" in "".join(scene.lines("log")), "the last line")
        await scene.press("enter")
        assert scene.lines("log-title") == ["LOG of /a"]
        assert scene.lines("log")[-2].endswith("/a: line 98")
        await scene.press("tab", "pageup", "up")
        height = len(scene.lines("log"))
        assert scene.lines("log-title") == [f"LOG of /a, {height} lines below"]
        held = scene.lines("log")
        await scene.session.say(output("later"))
        await scene.until(lambda: f"{height + 1} lines" in scene.lines("log-title")[0], "one more")
        assert scene.lines("log") == held, "what is read stays where it is"
        await scene.press("end")
        assert scene.lines("log")[-1].endswith("/a: later")
        await scene.press("l", "l", "l")
        assert scene.lines("log-title") == ["LOG of /a, error and above"]
        assert [line.split()[1:] for line in scene.lines("log")] == [["E", "x:", "bad"]]
        await scene.press("tab", "escape")
        assert scene.lines("log-title") == ["LOG of all, error and above"]

    acted(tmp_path, act)


def test_lines_of_a_flood_that_are_not_drawn_are_counted(tmp_path: Path) -> None:
    async def act(scene: Scene) -> None:
        for number in range(700):  # all between two updates
            scene.app.on_line(output(f"line {number}"))
        await scene.until(lambda: "line 699" in "".join(scene.lines("log")), "the last line")
        await scene.press("tab", "home")
        assert scene.lines("log")[0] == "(200 lines not drawn; l, or choosing a row, draws all)"

    acted(tmp_path, act)


def test_hostile_names_and_lines_keep_the_screen_in_order(tmp_path: Path) -> None:
    async def act(scene: Scene) -> None:
        name = "/\x1b[2J\x1b]0;title\x07猫" + "猫" * 80 + "\u202eend"
        scene.session.rows = [row(name, "runn\ning\x1b[31m", reason="\x9b31m\ud83d")]
        await scene.session.say(output("\x1b[2J🤖" * 5000, name), output("\x00\x07\r", name))
        await scene.until(lambda: "🤖" in "".join(scene.lines("log")), "the line")
        await scene.until(lambda: "猫" in scene.lines("table")[1], "the row")
        for pane in ("head", "table", "detail", "log-title", "log"):
            assert all(line.isprintable() for line in scene.lines(pane)), pane
        await scene.press("x")
        await scene.until_asked("stop /猫")
        await scene.press("y")
        await scene.until(lambda: bool(scene.session.operations), "the operation")
        assert scene.session.operations[0][1]["names"] == [name], "as the session knows it"

    acted(tmp_path, act)


@pytest.mark.parametrize("rows", [None, [{"name": 5}], {"a": 1}])
def test_an_answer_that_is_none_ends_it_with_the_reason(tmp_path: Path, rows: Any) -> None:
    async def act(scene: Scene) -> None:
        scene.session.rows = rows
        await scene.until(lambda: scene.app.return_value is not None, "the end")

    end = acted(tmp_path, act)
    assert end.is_lost
    assert "not understood" in end.reason


def test_every_size_has_a_screen(tmp_path: Path) -> None:
    async def act(scene: Scene) -> None:
        scene.session.rows = [row(f"/node_{number:03}") for number in range(110)]
        await scene.until(lambda: len(scene.app.rows or ()) == 110, "the rows")
        await scene.press("end")
        assert scene.names()[-1] == "/node_109"
        for width, height in ((20, 5), (1, 1), (200, 60), (80, 24)):
            await scene.resize(width, height)
            await scene.press("up", "down", "question_mark", "q")
        assert scene.names()[-1] == "/node_109"
        assert max(map(len, scene.lines("table"))) <= 80

    acted(tmp_path, act)

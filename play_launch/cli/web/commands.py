"""What the page has other commands do, one at a time: reports, the graph, parameters."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from play_launch.cli.systemd_unit import program
from play_launch.control.protocol import ROS_VARIABLES, OperationError
from play_launch.control.sessions import NoSessionError, connect
from play_launch.postmortem.archive import list_sessions
from play_launch.recording.session import default_log_folder

if TYPE_CHECKING:
    from collections.abc import Sequence

    from play_launch.postmortem.archive import SessionEntry

_MOST_SESSIONS: Final = 100
_LONGEST: Final = 120.0
_LISTENS: Final = 5.0
"""Seconds for which it listens after the last question."""
_AGAIN: Final = 5.0
"""Seconds until it listens again after it could not."""
_LONGEST_STATUS: Final = 1_000_000
_NOT_WHOLE: Final = 5
"""Exit code for a recording that is damaged or still written; there is a page all the same."""


class CommandError(Exception):
    """It was not carried out; the text is for people."""


class Commands:
    """Belongs to the thread of the event loop."""

    def __init__(self, session: str | None) -> None:
        self._session = session
        self._turn = asyncio.Lock()
        self._folder: Path | None = None
        """Log folder of the last session that was asked."""
        self._asked = asyncio.Event()
        self._asked_at = 0.0
        self._listens_to = ""
        self._statuses: dict[str, dict[str, Any]] = {}
        """By name."""
        self._deaf = ""
        """Why nothing is heard."""

    async def sessions(self) -> list[SessionEntry]:
        """Return the last sessions of the log folder, the newest first."""

        def found() -> list[SessionEntry]:
            with (
                contextlib.suppress(NoSessionError, OperationError, OSError),
                connect(self._session) as client,
            ):
                self._folder = Path(client.hello.folder).parent
            return list_sessions(self._folder or default_log_folder())

        return (await asyncio.to_thread(found))[: -_MOST_SESSIONS - 1 : -1]

    async def report(self, name: str) -> bytes:
        """Return the page of a session, which `sessions` has named; raises CommandError."""
        if name not in {entry.name for entry in await self.sessions()}:
            raise CommandError(f"there is no session {name} any more")
        with tempfile.TemporaryDirectory(prefix="play-launch-web-") as place:
            output = Path(place) / "report.html"
            folder = self._folder or default_log_folder()
            words = ["report", str(folder / name), "-o", str(output)]
            await self._run(words, {0, _NOT_WHOLE})
            return await asyncio.to_thread(output.read_bytes)

    async def explain(self, folder: str) -> list[str]:
        """Return what went wrong in a session so far, a text each; raises CommandError."""
        return (await self._run(["explain", "--", folder], {0, 1, _NOT_WHOLE})).split("\n\n")

    def diagnostics(self, folder: str) -> list[dict[str, Any]]:
        """Return what nodes report on /diagnostics by now, as `diagnostics --listen` prints it.

        `run` listens from the first question on; raises CommandError when it cannot.
        """
        self._asked_at, self._listens_to = time.monotonic(), folder
        self._asked.set()
        if self._deaf:
            raise CommandError(self._deaf)
        return list(self._statuses.values())

    async def run(self) -> None:
        """Listen while that is asked for, until cancelled."""
        while True:
            await self._asked.wait()
            try:
                await self._listen()
            except (OSError, ValueError) as error:
                self._deaf = str(error)
            self._statuses.clear()
            self._asked.clear()
            await asyncio.sleep(_AGAIN)

    async def _listen(self) -> None:
        words = ("diagnostics", "--listen", "--json", "--session", self._listens_to)
        child = await asyncio.create_subprocess_exec(
            *(program(), *words),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            limit=_LONGEST_STATUS,
        )
        assert child.stdout is not None
        assert child.stderr is not None
        self._deaf = ""
        try:
            while time.monotonic() - self._asked_at < _LISTENS:
                try:
                    async with asyncio.timeout(1.0):
                        line = await child.stdout.readline()
                except TimeoutError:
                    continue
                if not line:
                    self._deaf = (await child.stderr.read()).decode(errors="replace").strip()
                    return
                status = json.loads(line)
                self._statuses[status["name"]] = status
        finally:
            with contextlib.suppress(ProcessLookupError):
                child.terminate()
            await child.communicate()  # it may wait for its last lines to be read

    async def check_graph(self) -> list[dict[str, Any]]:
        """Return the problems of the session's graph: kind, name, text; raises CommandError."""
        environment = await asyncio.to_thread(self._session_environment)
        words = ["graph", "check", "--wait", "5s", "--json"]
        printed = await self._run(words, {0, 1}, environment)
        found: list[dict[str, Any]] = json.loads(printed)["problems"]
        return [each for each in found if each["kind"] != "unsubscribed"]

    async def parameters(self, session: str, node: str) -> dict[str, Any]:
        """Return the parameters of a node by their names; raises CommandError."""
        words = ["param", "dump", "--json", "--session", session, "--", node]
        found: dict[str, dict[str, Any]] = json.loads(await self._run(words, {0}))
        return next(iter(found.values()), {})

    async def set_parameter(self, session: str, node: str, name: str, value: str) -> None:
        """Set a parameter, ``value`` as YAML; raises CommandError, as when the node refuses."""
        await self._run(["param", "set", "--session", session, "--", node, name, value], {0})

    def _session_environment(self) -> dict[str, str]:
        try:
            with connect(self._session) as client:
                found = client.ask("environment")
                user = client.peer().uid
        except (NoSessionError, OperationError, OSError) as error:
            raise CommandError(str(error)) from None
        if user != os.geteuid():
            raise CommandError(f"run play-launch web as user {user}, whose session it is")
        ours = {name: value for name, value in os.environ.items() if not _is_of_ros(name)}
        theirs = {name: str(value) for name, value in found.items() if _is_of_ros(name)}
        return {**ours, **theirs}

    async def _run(
        self, words: Sequence[str], good: set[int], environment: dict[str, str] | None = None
    ) -> str:
        if self._turn.locked():
            raise CommandError("another page is waiting for such an answer; try again soon")
        async with self._turn:
            child = await asyncio.create_subprocess_exec(
                program(),
                *words,
                env=environment,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.PIPE,
            )
            try:
                async with asyncio.timeout(_LONGEST):
                    stdout, stderr = await child.communicate()
            except TimeoutError:
                raise CommandError(f"play-launch {words[0]} takes too long") from None
            finally:
                if child.returncode is None:
                    with contextlib.suppress(ProcessLookupError):
                        child.kill()
                    await child.wait()
        if child.returncode not in good:
            raise CommandError(stderr.decode(errors="replace").strip() or "it failed")
        return stdout.decode(errors="replace")


def _is_of_ros(name: str) -> bool:
    return name.startswith(ROS_VARIABLES)

"""What the page has other commands do, one at a time: reports, the graph, parameters."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import tempfile
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

    async def diagnostics(self, folder: str) -> list[dict[str, Any]]:
        """Return what nodes reported on /diagnostics so far, as `explain --json` has it."""
        printed = await self._run(["explain", "--json", "--", folder], {0, 1, _NOT_WHOLE})
        found: list[dict[str, Any]] = json.loads(printed)["diagnostics"]
        return found

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

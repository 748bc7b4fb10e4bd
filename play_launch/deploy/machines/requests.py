"""Requests of clients that are for all machines: shared out by unit, and answered as one."""

from __future__ import annotations

import asyncio
import contextlib
import time
from typing import TYPE_CHECKING, Any, Final

import anyio
from msgspec import json, to_builtins

from play_launch.config.model import ContainerConfig
from play_launch.config.node_key import NodeKey
from play_launch.control.feed import KEPT, Backlog, ClientQueue
from play_launch.control.messages import (
    ChangeRequest,
    EventsRequest,
    UnitRow,
    WaitRequest,
    read_arguments,
)
from play_launch.control.protocol import MEMBER_ACTIONS, NODE_ACTIONS, Code, OperationError
from play_launch.control.units import OF_ANOTHER_PROGRAM, meant
from play_launch.deploy.machines.hosts import LinkLost
from play_launch.deploy.machines.part import BEGUN
from play_launch.recording.console_format import logger_of, loggers_in
from play_launch.supervisor.events import MachineState

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence

    from play_launch.config.model import ReplayConfig
    from play_launch.control.messages import Caller, Request
    from play_launch.control.units import Target
    from play_launch.deploy.machines.part import Part

    Change = Callable[[ChangeRequest, Caller], Awaitable[object]]
    """Carries out `apply`."""

_ACTIONS: Final = frozenset((*MEMBER_ACTIONS, *NODE_ACTIONS, "signal", "wait"))
_OTHERS: Final = (
    "apply",
    "environment",
    "events",
    "expectations",
    "recording",
    "snapshot",
    "system",
)
_LISTS: Final = frozenset(("ps", "status", "parameters"))
_NOTICED: Final = 0.5
"""Seconds in which the loss of a machine is noticed, until it is asked again."""
_LEAST: Final = 0.001
_ANSWER: Final = 5.0
"""Seconds for the rows of a machine; its session may be stopped, or very busy."""
_LATER: Final = 2.0
"""The same for one that has not answered last time."""
_UNKNOWN: Final[dict[str, Any]] = {
    "last_restarts": (),
    "waits_for": "",
    "wanted": True,
    "command": (),
    "resources": {},
    "declared": "",
    "output": (),
}
"""What `status` tells besides, of a unit whose machine does not answer."""


class _MachineLostError(OperationError):
    """The machine was lost before it had answered."""


class Requests:
    """Operations on all machines of a system. Belongs to the thread of the event loop."""

    def __init__(self, parts: Mapping[str, Part], change: Change) -> None:
        self._parts = parts
        self._change = change
        self._events: Backlog[dict[str, Any]] = Backlog(KEPT)
        self._followers: list[Callable[[dict[str, Any]], None]] = []
        self._silent: set[str] = set()
        """Machines that have not answered when they were asked last."""

    async def __call__(self, request: Request, caller: Caller) -> object:
        arguments = _object(request.arguments)
        if request.op in _LISTS:
            return await self._rows(request.op, arguments)
        if request.op in _ACTIONS:
            return await self._act(request.op, arguments, caller)
        match request.op:
            case "events":
                return await self._follow(read_arguments(request.arguments, EventsRequest), caller)
            case "apply":
                return await self._change(read_arguments(request.arguments, ChangeRequest), caller)
            case "environment":
                return await self._first("environment", caller)
            case "snapshot":
                found = [*(await self._all("snapshot", caller)).values()]
                return {key: sum(each[key] for each in found) for key in found[0]} if found else {}
            case "recording":
                found = [*(await self._answering("recording")).values()]
                return {
                    "dropped": sum(each["dropped"] for each in found),
                    "topic_drops": sum(each["topic_drops"] for each in found),
                    "lag": max((each["lag"] for each in found), default=0.0),
                    "error": next((each["error"] for each in found if each["error"]), ""),
                }
            case "system":
                times = [each["up_after_s"] for each in (await self._answering("system")).values()]
                is_up = len(times) == len(self._parts) and None not in times
                return {"up_after_s": max(times) if is_up else None}
            case "expectations":
                answers = await self._answering("expectations")
                return [
                    {**row, "machine": name}
                    for name in sorted(answers, key=[*self._parts].index)
                    for row in answers[name]
                ]
        known = ", ".join(sorted((*_LISTS, *_ACTIONS, *_OTHERS)))
        text = f"unknown operation {request.op!r:.80}; there are: {known}"
        raise OperationError(Code.UNKNOWN_OPERATION, text)

    def _reachable(self) -> list[Part]:
        return [part for part in self._parts.values() if part.state is MachineState.RUNNING]

    async def _first(self, operation: str, caller: Caller) -> object:
        for part in sorted(self._reachable(), key=lambda each: not each.machine.local):
            return await self.result(part, operation, {}, caller)
        raise OperationError(Code.REFUSED, "no machine can be reached")

    async def stream(
        self, part: Part, operation: str, arguments: Mapping[str, Any], caller: Caller
    ) -> AsyncIterator[dict[str, Any]]:
        """Request an operation of one machine; raises OperationError, also when it is lost."""
        try:
            channel = await part.open()
        except LinkLost as lost:
            text = f"machine {part.name} is unreachable: {lost}"
            raise _MachineLostError(Code.REFUSED, text) from None
        has_result = False
        try:
            async for message in channel.stream(operation, arguments, caller.command):
                has_result = "result" in message
                yield message
        except LinkLost as lost:
            text = f"the connection to {part.name} was lost meanwhile: {lost}"
            raise _MachineLostError(Code.FAILED, text) from None
        finally:
            channel.close()
        if not has_result:
            raise _MachineLostError(Code.FAILED, f"the session of {part.name} has ended meanwhile")

    async def result(
        self, part: Part, operation: str, arguments: Mapping[str, Any], caller: Caller
    ) -> Any:
        result: Any = None
        async for each in self.stream(part, operation, arguments, caller):
            result = each.get("result", result)
        return result

    async def _all(self, operation: str, caller: Caller) -> dict[str, Any]:
        """Request an operation of all machines at once; raises OperationError if one refuses."""
        found: dict[str, Any] = {}
        errors: list[OperationError] = []

        async def ask(part: Part) -> None:
            try:
                found[part.name] = await self.result(part, operation, {}, caller)
            except OperationError as error:
                errors.append(error)

        async with anyio.create_task_group() as tasks:
            for part in self._reachable():
                tasks.start_soon(ask, part)
        if errors:
            raise errors[0]
        return found

    async def _answering(self, operation: str) -> dict[str, Any]:
        """Ask all machines at once; return what those say that answer, by their names."""
        found: dict[str, Any] = {}

        async def ask(part: Part) -> None:
            with contextlib.suppress(LinkLost, OperationError, TimeoutError):
                found[part.name] = await self._soon(part, operation)

        async with anyio.create_task_group() as tasks:
            for part in self._reachable():
                tasks.start_soon(ask, part)
        return found

    async def _soon(self, part: Part, operation: str, arguments: object = None) -> Any:
        """Ask a machine; raises TimeoutError, sooner where it has not answered last time."""
        try:
            async with asyncio.timeout(_LATER if part.name in self._silent else _ANSWER):
                answer = await part.ask(operation, arguments)
        except TimeoutError:
            self._silent.add(part.name)
            raise
        self._silent.discard(part.name)
        return answer

    async def _rows(self, operation: str, arguments: Mapping[str, Any]) -> list[dict[str, Any]]:
        names = arguments.get("names", ())
        targets = self._by_machine(operation, names) if names else dict.fromkeys(self._parts, ())
        found: dict[str, list[dict[str, Any]]] = {}
        errors: list[OperationError] = []

        async def ask(part: Part, wanted: Sequence[str]) -> None:
            rows: list[dict[str, Any]] = []
            try:
                rows = await self._soon(part, operation, {"names": wanted})
                if operation == "ps" and not wanted:
                    part.rows = rows
            except OperationError as error:
                errors.append(error)
            except (LinkLost, TimeoutError):
                rows = [] if operation == "parameters" else _unreachable(part, wanted)
                if operation == "status":
                    rows = [{**row, **_UNKNOWN, "since_ns": part.since_ns} for row in rows]
            found[part.name] = [{**part.here(row), "machine": part.name} for row in rows]

        async with anyio.create_task_group() as tasks:
            for name, wanted in targets.items():
                tasks.start_soon(ask, self._parts[name], wanted)
        if errors:
            raise errors[0]
        return [row for name in self._parts for row in found.get(name, ())]

    async def _wait(self, part: Part, arguments: dict[str, Any], caller: Caller) -> Any:
        """Have a machine wait; if it is lost meanwhile, wait for it and ask again."""
        limit = read_arguments(json.encode(arguments), WaitRequest).timeout
        deadline = anyio.current_time() + limit
        while True:
            with anyio.move_on_after(deadline - anyio.current_time()):
                await part.until_not(BEGUN)
            if part.name not in self._parts:  # the others have started without it
                return {"results": []}
            left = max(deadline - anyio.current_time(), _LEAST)
            try:
                return await self.result(part, "wait", {**arguments, "timeout": left}, caller)
            except _MachineLostError as lost:
                if part.state not in {*BEGUN, MachineState.RUNNING}:
                    raise
                if left == _LEAST:
                    raise OperationError(Code.TIMEOUT, str(lost)) from None
            # Its loss may not have been noticed yet.
            with anyio.move_on_after(min(left, _NOTICED)):
                part.changed.clear()
                await part.changed.wait()

    async def _act(self, operation: str, arguments: dict[str, Any], caller: Caller) -> object:
        names = arguments.get("names", ())
        targets = self._by_machine(operation, names) if names else dict.fromkeys(self._parts, ())
        results: list[dict[str, Any]] = []
        errors: list[OperationError] = []

        async def ask(part: Part, wanted: Sequence[str]) -> None:
            asked = {**arguments, "names": list(wanted)}
            try:
                if operation == "wait":
                    result = await self._wait(part, asked, caller)
                else:
                    result = await self.result(part, operation, asked, caller)
                results.extend(result["results"])
            except OperationError as error:
                errors.append(error)
                found = error.details.get("results")
                results.extend(found if isinstance(found, list) else ())

        async with anyio.create_task_group() as tasks:
            for name, wanted in targets.items():
                tasks.start_soon(ask, self._parts[name], wanted)
        if errors:
            if results:
                errors[0].details["results"] = results
            raise errors[0]
        return {"results": results}

    def _by_machine(self, operation: str, names: Sequence[str]) -> dict[str, Sequence[str]]:
        """Find the units that names mean, by their machines; raises OperationError."""
        places: dict[Target, str] = {}
        guests: dict[Target, str] = {}
        for part in self._parts.values():
            for row in part.rows or _declared(part.config):
                key = NodeKey(row["container"], row["name"]) if row["container"] else row["name"]
                places[key] = part.name
                if row.get("is_guest"):
                    guests[key] = OF_ANOTHER_PROGRAM
        members = [each for each in places if isinstance(each, str)]
        nodes = [each for each in places if isinstance(each, NodeKey) and each not in guests]
        found: dict[str, Sequence[str]] = {}
        for target in meant(operation, names, members, nodes, guests):
            found[places[target]] = (*found.get(places[target], ()), str(target))
        return found

    # Events.

    def take(self, event: dict[str, Any]) -> None:
        """Take an event of any machine."""
        self._events.append(event, *_line_of(event))
        for follower in self._followers:
            follower(event)

    async def _follow(self, request: EventsRequest, caller: Caller) -> object:
        """Send the events of all machines, as `events` of one session does."""
        targets = self._by_machine("events", request.names) if request.names else None
        wanted = _Wanted(request, targets)
        waiting = ClientQueue()

        def append(event: dict[str, Any]) -> None:
            if wanted(event):
                waiting.append(lambda: event, *_line_of(event))

        past = [] if request.only_new else [each for each in self._events if wanted(each)]
        self._followers.append(append)
        try:
            for event in sorted(past, key=lambda each: each["stamp_ns"]):
                await caller.send("event", event)
            if request.follow:
                await waiting.send(caller.send)
        finally:
            self._followers.remove(append)
        return {"events": "sent"}


def _line_of(event: Mapping[str, Any]) -> tuple[str, int]:
    if event["event"] != "output":
        return "", 0
    return f"{event['machine']}:{event['process']}", len(event["text"])


class _Wanted:
    """Whether a client wants an event."""

    def __init__(self, request: EventsRequest, targets: Mapping[str, Sequence[str]] | None) -> None:
        self._kinds = frozenset(request.kinds)
        self._names: set[str] | None = None
        self._loggers: set[str] = set()
        if targets is not None:
            keys = [each for found in targets.values() for each in found]
            nodes = [NodeKey.parsed(key).name for key in keys if ":/" in key]
            self._names = {*keys, *nodes}
            # The output of nodes comes through their container.
            self._loggers = {*map(logger_of, nodes)}

    def __call__(self, event: Mapping[str, Any]) -> bool:
        kind = event["event"]
        if kind not in self._kinds and (self._kinds or kind == "output"):
            return False
        if self._names is None:
            return True
        if kind == "output" and not self._loggers.isdisjoint(loggers_in(event["text"])):
            return True
        of = {event.get(each) for each in ("name", "node", "container", "process", "key")}
        return not self._names.isdisjoint(of)


def _unreachable(part: Part, wanted: Sequence[str]) -> list[dict[str, Any]]:
    """Return the rows as they were, of a machine that does not answer or not yet."""
    since = time.strftime("%H:%M:%S", time.localtime(part.since_ns / 1e9))
    unknown = {"cpu_percent": None, "memory_bytes": None, "uptime_s": None}
    return [
        {
            **row,
            **unknown,
            "state": "unreachable" if part.state is MachineState.RUNNING else str(part.state),
            "reason": f"since {since}, was {row['state']}" if row["state"] else part.reason,
        }
        for row in part.rows or _declared(part.config)
        if not wanted or {row["name"], f"{row['container']}:{row['name']}"} & set(wanted)
    ]


def _declared(config: ReplayConfig) -> list[dict[str, Any]]:
    """Return the rows of what has not been seen yet."""
    units: list[tuple[str, str | None, str]] = [
        ("container" if isinstance(each, ContainerConfig) else "process", None, each.full_name)
        for each in config.members
    ]
    for container in config.containers:
        place = units.index(("container", None, container.full_name)) + 1
        units[place:place] = [
            ("component", container.full_name, node.key.name) for node in container.composable_nodes
        ]
    rows = [
        UnitRow(
            name=name,
            kind=kind,  # type: ignore[arg-type]
            container=container,
            state="",
            reason="",
            managed=None,
            pid=None,
            restarts=0,
            uptime_s=None,
            exit_code=None,
            signal=None,
            crashes=0,
            cpu_percent=None,
            memory_bytes=None,
            memory_kind=None,
            cgroup=None,
        )
        for kind, container, name in units
    ]
    return [to_builtins(row) for row in rows]


def _object(arguments: object) -> dict[str, Any]:
    try:
        found = json.decode(bytes(arguments))  # type: ignore[call-overload]
    except ValueError as error:
        raise OperationError(Code.BAD_ARGUMENTS, str(error)) from None
    if not isinstance(found, dict):
        raise OperationError(Code.BAD_ARGUMENTS, "expected an object")
    return found

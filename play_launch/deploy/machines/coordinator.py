"""All machines of a system together: their order, their conditions, and the requests of clients."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections import deque
from typing import TYPE_CHECKING, Any, Final

import anyio
from msgspec import json, to_builtins
from msgspec.structs import asdict

from play_launch import ExitCode
from play_launch.config.machines import part_of, stopped_after, used_machines
from play_launch.config.model import ContainerConfig, DiscoveryBy
from play_launch.config.node_key import NodeKey
from play_launch.config.problems import ConfigError
from play_launch.control.messages import ChangeRequest, EventsRequest, UnitRow, read_arguments
from play_launch.control.protocol import MEMBER_ACTIONS, NODE_ACTIONS, Code, OperationError
from play_launch.control.serve import read_change
from play_launch.control.units import chosen
from play_launch.deploy.machines.hosts import HostError, LinkLost
from play_launch.deploy.machines.part import Part, PartState
from play_launch.deploy.unit import stop_seconds
from play_launch.recording.console_format import logger_of, loggers_in

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Mapping, Sequence

    from play_launch.config.model import ReplayConfig
    from play_launch.control.messages import Caller, Request
    from play_launch.control.units import Target

    Show = Callable[[str, dict[str, Any]], None]
    """Shows an event of a machine."""

_log = logging.getLogger(__name__)
_EVENTS: Final = 5000
"""Events of all machines that are kept for clients."""
_QUEUE: Final = 5000
_ACTIONS: Final = frozenset((*MEMBER_ACTIONS, *NODE_ACTIONS, "signal", "wait"))
_LISTS: Final = frozenset(("ps", "status", "parameters"))
_BRING_UP: Final = 600.0
"""Seconds until a start that is to be left alone counts as done."""
_CLOSING: Final = 60.0
"""Seconds until all recordings are closed."""
_FAILED: Final = frozenset(("gave up", "load failed", "crashed", "lost"))


class Coordinator:
    """The parts of a system. Belongs to the thread of the event loop."""

    def __init__(
        self, config: ReplayConfig, arguments: Sequence[str], program: str, show: Show
    ) -> None:
        """Prepare; ``program`` is play-launch on this machine."""
        self.config = config
        self._show = show
        self._events: deque[dict[str, Any]] = deque(maxlen=_EVENTS)
        self._followers: list[Callable[[dict[str, Any]], None]] = []
        self._met_changed = asyncio.Event()
        self._ended = asyncio.Event()
        self._over = asyncio.Event()
        """Whether no machine has anything left to do."""
        self._failures: dict[str, str] = {}
        self.parts = {
            name: Part(part_of(config, name), arguments, program, self._take, self._met_changed.set)
            for name in used_machines(config)
        }

    async def run(self, stop: asyncio.Event, *, detach: bool = False) -> int:
        """Bring all machines up, accompany them until ``stop`` or their end; return the exit code.

        With ``detach`` it returns once all are up, and they run on; the next coordinator adopts
        them. Raises HostError when a machine that is not optional cannot be used; nothing was
        started then.
        """
        await self._prepare()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(self._exchange_conditions)
            tasks.start_soon(self._accompany_all)
            tasks.start_soon(self._watch_for_the_end)
            if detach:
                await _first_done(stop.wait(), self._ended.wait(), self._all_loaded())
            else:
                await _first_done(stop.wait(), self._ended.wait())
            code = self._exit_code()
            if not detach or stop.is_set():
                await self._stop()
            tasks.cancel_scope.cancel()
        for part in self.parts.values():
            part.close()
        return code

    def publish(self, event: dict[str, Any]) -> None:
        """Take an event of the coordinator itself."""
        self._take("", event)

    async def _all_loaded(self) -> None:
        """Wait until all units of all machines are up, or failed for good."""

        async def loaded(part: Part) -> None:
            while part.state is not PartState.RUNNING:
                part.changed.clear()
                await part.changed.wait()
            with contextlib.suppress(OperationError, LinkLost):
                await part.ask("wait", {"timeout": _BRING_UP})

        async with anyio.create_task_group() as tasks:
            for part in self.parts.values():
                tasks.start_soon(loaded, part)

    # Start and end.

    async def _prepare(self) -> None:
        """Prepare all machines at once; raises HostError with a line for each that fails."""
        problems: dict[str, str] = {}

        async def prepare(part: Part) -> None:
            try:
                await part.prepare()
            except HostError as error:
                problems[part.name] = str(error)

        async with anyio.create_task_group() as tasks:
            for part in self.parts.values():
                tasks.start_soon(prepare, part)
        fatal = [name for name in problems if not self.config.machines[name].optional]
        if fatal:
            for part in self.parts.values():
                part.close()
            raise HostError("\n".join(f"machine {name}: {problems[name]}" for name in problems))
        for name, problem in problems.items():
            _log.warning("%s: %s; the others start without it", name, problem)
            part = self.parts.pop(name)
            part.close()
        if self.config.discovery is DiscoveryBy.PEERS:
            await self._share_addresses()

    async def _share_addresses(self) -> None:
        """Give each part the addresses of all, for ROS_STATIC_PEERS."""
        found = [part.host.address for part in self.parts.values() if part.host.address]
        local = [part for part in self.parts.values() if part.machine.local]
        if local and (others := [part for part in self.parts.values() if not part.machine.local]):
            # The address of this machine as another one sees it.
            output = await others[0].host.run('printf %s "${SSH_CONNECTION%% *}"')
            found += [output.stdout] if output.stdout else []
        for part in self.parts.values():
            part.peers = tuple(found)
            await part.change(part.config)

    async def _accompany_all(self) -> None:
        async with anyio.create_task_group() as tasks:
            for part in self.parts.values():
                tasks.start_soon(self._accompany, part)
        self._over.set()

    async def _accompany(self, part: Part) -> None:
        try:
            await part.run()
        except HostError as error:
            _log.error("%s: %s", part.name, error)
            self._failures[part.name] = str(error)
            part.fail(str(error))

    async def _watch_for_the_end(self) -> None:
        over = {PartState.ENDED, PartState.FAILED}
        while True:
            for part in self.parts.values():
                part.changed.clear()
            ends_all = next((each.name for each in self.parts.values() if each.ends_all), None)
            ended = {name for name, part in self.parts.items() if part.state in over}
            if ends_all in ended:
                _log.warning("%s ends the whole system (on_exit: shutdown)", ends_all)
            if len(ended) == len(self.parts) or ends_all in ended:
                self._ended.set()
                return
            await _first_done(*(part.changed.wait() for part in self.parts.values()))

    async def _stop(self) -> None:
        """Stop the machines, those first that depend on others."""
        before = stopped_after(self.config)
        left = set(self.parts)
        while left:
            now = {name for name in left if not before.get(name, frozenset()) & left} or set(left)
            left -= now
            async with anyio.create_task_group() as tasks:
                for name in sorted(now):
                    part = self.parts[name]
                    tasks.start_soon(part.stop, float(stop_seconds(part.config)))
        lost = any(each.state is PartState.UNREACHABLE for each in self.parts.values())
        with anyio.move_on_after(0 if lost else _CLOSING):
            await self._over.wait()
        for part in self.parts.values():
            if part.state is PartState.UNREACHABLE:
                _log.error("%s could not be stopped: %s", part.name, part.reason)

    def _exit_code(self) -> int:
        rows = [row for part in self.parts.values() for row in part.rows]
        if self._failures or any(row["state"] in _FAILED for row in rows):
            return ExitCode.NODE_FAILED
        if any(part.state is PartState.UNREACHABLE for part in self.parts.values()):
            return ExitCode.NODES_MISSING
        return ExitCode.OK

    async def _exchange_conditions(self) -> None:
        """Tell each machine what is met on the others."""
        told: dict[str, list[list[str]]] = {}
        while True:
            await self._met_changed.wait()
            self._met_changed.clear()
            for part in tuple(self.parts.values()):
                others = (each for each in self.parts.values() if each is not part)
                met = sorted(list(each) for other in others for each in other.met)
                if told.get(part.name) != met:
                    told[part.name] = met
                    await part.tell(met)

    # Clients.

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
                return await self._first("environment")
            case "snapshot":
                found = [await part.ask("snapshot") for part in self._reachable()]
                return {key: sum(each[key] for each in found) for key in found[0]} if found else {}
        known = ", ".join(
            sorted((*_LISTS, *_ACTIONS, "apply", "environment", "events", "snapshot"))
        )
        text = f"unknown operation {request.op!r:.80}; there are: {known}"
        raise OperationError(Code.UNKNOWN_OPERATION, text)

    def _reachable(self) -> list[Part]:
        return [part for part in self.parts.values() if part.state is PartState.RUNNING]

    async def _first(self, operation: str) -> object:
        for part in sorted(self._reachable(), key=lambda each: not each.machine.local):
            return await part.ask(operation)
        raise OperationError(Code.REFUSED, "no machine can be reached")

    async def _rows(self, operation: str, arguments: Mapping[str, Any]) -> list[dict[str, Any]]:
        names = arguments.get("names", ())
        targets = self._by_machine(names) if names else dict.fromkeys(self.parts, ())
        found: dict[str, list[dict[str, Any]]] = {}

        async def ask(part: Part, wanted: Sequence[str]) -> None:
            try:
                rows = await part.ask(operation, {"names": wanted})
                if operation == "ps" and not wanted:
                    part.rows = rows
            except LinkLost:
                rows = [] if operation == "parameters" else _unreachable(part, wanted)
            found[part.name] = [{**part.here(row), "machine": part.name} for row in rows]

        async with anyio.create_task_group() as tasks:
            for name, wanted in targets.items():
                tasks.start_soon(ask, self.parts[name], wanted)
        return [row for name in self.parts for row in found.get(name, ())]

    async def _wait_for_machines(self, limit: float) -> None:
        """Wait until no machine is on its way any more."""
        begun = {PartState.CONNECTING, PartState.STARTING}
        with anyio.move_on_after(limit):
            for part in self.parts.values():
                while part.state in begun:
                    part.changed.clear()
                    await part.changed.wait()

    async def _act(self, operation: str, arguments: dict[str, Any], caller: Caller) -> object:
        if operation == "wait":
            await self._wait_for_machines(float(arguments.get("timeout", 60)))
        names = arguments.get("names", ())
        targets = self._by_machine(names) if names else dict.fromkeys(self.parts, ())
        results: list[dict[str, Any]] = []
        errors: list[OperationError] = []

        async def ask(part: Part, wanted: Sequence[str]) -> None:
            try:
                channel = await part.open()
            except LinkLost as lost:
                text = f"machine {part.name} is unreachable: {lost}"
                errors.append(OperationError(Code.REFUSED, text))
                return
            try:
                request = {**arguments, "names": list(wanted)}
                async for message in channel.stream(operation, request, caller.command):
                    results.extend(message.get("result", {}).get("results", ()))
            except OperationError as error:
                errors.append(error)
                found = error.details.get("results")
                results.extend(found if isinstance(found, list) else ())
            except LinkLost as lost:
                text = f"the connection to {part.name} was lost meanwhile: {lost}"
                errors.append(OperationError(Code.FAILED, text))
            finally:
                channel.close()

        async with anyio.create_task_group() as tasks:
            for name, wanted in targets.items():
                tasks.start_soon(ask, self.parts[name], wanted)
        if errors:
            if results:
                errors[0].details["results"] = results
            raise errors[0]
        return {"results": results}

    def _by_machine(self, names: Sequence[str]) -> dict[str, Sequence[str]]:
        """Find the units that names mean, by their machines; raises OperationError."""
        places: dict[Target, str] = {}
        for part in self.parts.values():
            for row in part.rows or _declared(part.config):
                key = NodeKey(row["container"], row["name"]) if row["container"] else row["name"]
                places[key] = part.name
        found: dict[str, Sequence[str]] = {}
        for target in chosen(names, list(places)):
            found[places[target]] = (*found.get(places[target], ()), str(target))
        return found

    # Events.

    def _take(self, machine: str, event: dict[str, Any]) -> None:
        event = {**event, "machine": machine}
        self._events.append(event)
        self._show(machine, event)
        for follower in self._followers:
            follower(event)

    async def _follow(self, request: EventsRequest, caller: Caller) -> object:
        """Send the events of all machines, as `events` of one session does."""
        wanted = _Wanted(request, self._by_machine(request.names) if request.names else None)
        queue: asyncio.Queue[dict[str, Any]] = asyncio.Queue(_QUEUE)
        missed = 0

        def append(event: dict[str, Any]) -> None:
            nonlocal missed
            if wanted(event):
                try:
                    queue.put_nowait(event)
                except asyncio.QueueFull:
                    missed += 1

        past = [] if request.only_new else [each for each in self._events if wanted(each)]
        self._followers.append(append)
        try:
            for event in sorted(past, key=lambda each: each["stamp_ns"]):
                await caller.send("event", event)
            while request.follow:
                await caller.send("event", await queue.get())
                if missed and queue.empty():
                    count, missed = missed, 0
                    await caller.send("missed", count)
        finally:
            self._followers.remove(append)
        return {"events": "sent"}

    # Changes.

    async def _change(self, request: ChangeRequest, caller: Caller) -> object:
        """Compare or change each machine's part; only those that differ are changed."""
        try:
            target = await asyncio.to_thread(read_change, request)
        except ConfigError as error:
            text = f"{request.path} cannot be used, nothing was changed\n{error.for_people()}"
            raise OperationError(Code.BAD_ARGUMENTS, text) from None
        except ValueError as error:
            raise OperationError(Code.BAD_ARGUMENTS, str(error)) from None
        if request.text is not None:
            raise OperationError(
                Code.BAD_ARGUMENTS, "a launch file has no machines; write it with dump first"
            )
        used = used_machines(target)
        if set(used) != set(self.parts):
            text = f"it runs on {', '.join(used)}, and this system on {', '.join(self.parts)}"
            raise OperationError(
                Code.REFUSED, f"{text}; stop it and replay the other configuration"
            )
        lost = [name for name in used if self.parts[name].state is not PartState.RUNNING]
        if lost:
            raise OperationError(Code.REFUSED, f"machine {lost[0]} is unreachable")
        await self._bring(target)
        plans = {name: await self._plan(self.parts[name], request) for name in used}
        steps = [step for plan in plans.values() for step in plan["steps"]]
        if request.dry_run:
            return {"plan": {"steps": steps}, "applying": None}
        await caller.send("plan", {"steps": steps})
        outcomes: list[dict[str, Any]] = []
        failures: list[str] = []

        async def apply(part: Part) -> None:
            channel = await part.open()
            try:
                arguments = self._for_part(part, request, dry_run=False)
                async for message in channel.stream("apply", arguments, caller.command):
                    if "step" in message:
                        await caller.send("step", message["step"])
                    outcomes.extend(
                        message.get("result", {}).get("applied", {}).get("outcomes", ())
                    )
            except (OperationError, LinkLost) as error:
                failures.append(f"{part.name}: {error}")
            finally:
                channel.close()

        async with anyio.create_task_group() as tasks:
            for name, plan in plans.items():
                if plan["steps"]:
                    tasks.start_soon(apply, self.parts[name])
        applied = {"plan": {"steps": steps}, "outcomes": outcomes, "rollback": None}
        if failures:
            raise OperationError(Code.FAILED, "; ".join(failures), applied=applied)
        self.config = target
        return {"applied": applied}

    async def _bring(self, target: ReplayConfig) -> None:
        for name, part in self.parts.items():
            try:
                await part.change(part_of(target, name))
            except (LinkLost, HostError) as error:
                raise OperationError(Code.REFUSED, f"machine {name}: {error}") from None

    async def _plan(self, part: Part, request: ChangeRequest) -> dict[str, Any]:
        try:
            found = await part.ask("apply", self._for_part(part, request, dry_run=True))
        except LinkLost as lost:
            raise OperationError(Code.REFUSED, f"machine {part.name}: {lost}") from None
        steps = [{**step, "machine": part.name} for step in found["plan"]["steps"]]
        return {"steps": steps}

    @staticmethod
    def _for_part(part: Part, request: ChangeRequest, *, dry_run: bool) -> dict[str, Any]:
        arguments = {**asdict(request), "path": part.source, "environment": {}, "dry_run": dry_run}
        del arguments["text"]
        return arguments


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
            "state": str(part.state),
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


async def _first_done(*works: Awaitable[object]) -> None:
    """Wait for the first of them, and cancel the others."""
    tasks = [asyncio.ensure_future(work) for work in works]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

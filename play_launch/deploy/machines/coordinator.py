"""All machines of a system together: their order, their conditions, and their end."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from typing import TYPE_CHECKING, Any, Final

import anyio

from play_launch import ExitCode
from play_launch.config.machines import DiscoveryBy, part_of, stopped_after, used_machines
from play_launch.control.event_words import event_object, words_of
from play_launch.control.protocol import OperationError
from play_launch.deploy.machines.hosts import HostError, LinkLost
from play_launch.deploy.machines.part import Part
from play_launch.deploy.machines.requests import Requests
from play_launch.deploy.unit import stop_seconds
from play_launch.supervisor.events import MachineState

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Sequence

    from play_launch.config.model import ReplayConfig
    from play_launch.supervisor.events import RunEvent

    Show = Callable[[str, dict[str, Any]], None]
    """Shows an event of a machine."""

_log = logging.getLogger(__name__)
_BRING_UP: Final = 600.0
"""Seconds until a start that is to be left alone counts as done."""
_CLOSING: Final = 60.0
"""Seconds until all recordings are closed."""
_FAILED: Final = frozenset(("gave up", "load failed", "crashed", "lost"))


class Coordinator:
    """The parts of a system. Belongs to the thread of the event loop."""

    def __init__(
        self,
        config: ReplayConfig,
        arguments: Sequence[str],
        program: str,
        show: Show,
        record: Callable[[RunEvent], None],
    ) -> None:
        """Prepare; ``program`` is play-launch on this machine."""
        self.config = config
        self._show = show
        self._record = record
        self._met_changed = asyncio.Event()
        self._ended = asyncio.Event()
        self._over = asyncio.Event()
        """Whether no machine has anything left to do."""
        self._failures: dict[str, str] = {}
        self.parts = {
            name: Part(
                part_of(config, name),
                arguments,
                program,
                on_event=self._take,
                on_met=self._met_changed.set,
                on_change=self.publish,
            )
            for name in used_machines(config)
        }
        self.requests = Requests(self.parts)
        self.on_change: Callable[[], None] = lambda: None
        """Called when the state of a machine has changed."""

    async def run(self, stop: asyncio.Event, hurry: asyncio.Event, *, detach: bool = False) -> int:
        """Bring all machines up, accompany them until ``stop`` or their end; return the exit code.

        With ``hurry`` it waits for no machine that is being stopped. With ``detach`` it returns
        once all are up, and they run on; the next coordinator adopts them. Raises HostError when a
        machine that is not optional cannot be used; nothing was started then.
        """
        await _first_done(self._prepare(), stop.wait())
        if stop.is_set():
            for part in self.parts.values():
                part.close()
            return ExitCode.OK
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
                await _first_done(self._stop(), hurry.wait())
                for part in self.parts.values():
                    await part.request_end()
            tasks.cancel_scope.cancel()
        for part in self.parts.values():
            part.close()
        return code

    def publish(self, event: RunEvent) -> None:
        """Take an event of the coordinator itself."""
        self._record(event)
        self._take("", event_object(event) | words_of(event)._asdict())

    def _take(self, machine: str, event: dict[str, Any]) -> None:
        event = {"machine": machine, **event}
        self.requests.take(event)
        self._show(machine, event)

    def recordings(self) -> dict[str, dict[str, Any]]:
        """Say where each part is recorded, and by how much its clock is ahead."""
        return {
            part.name: {
                "local": part.machine.local,
                "ssh": part.machine.ssh,
                "folder": part.hello["folder"],
                "session": part.hello["session"],
                "offset_ns": part.offset_ns,
            }
            for part in self.parts.values()
            if part.hello
        }

    async def _all_loaded(self) -> None:
        """Wait until all units of all machines are up, or failed for good."""

        async def loaded(part: Part) -> None:
            while part.state is not MachineState.RUNNING:
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
            part.put(MachineState.FAILED, problem)
            part.close()
        if self.config.discovery is DiscoveryBy.PEERS:
            try:
                await self._share_addresses()
            except LinkLost as lost:
                raise HostError(f"a machine was lost: {lost}") from None

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
            await part.adopt(part.config, await part.bring(part.config))

    async def _accompany_all(self) -> None:
        async with anyio.create_task_group() as tasks:
            for part in self.parts.values():
                tasks.start_soon(self._accompany, part)
        self._over.set()

    async def _accompany(self, part: Part) -> None:
        try:
            await part.run()
        except HostError as error:
            self._fail(part, error)
        except Exception as error:  # noqa: BLE001 - the other machines continue
            _log.exception("%s cannot be accompanied any more", part.name)
            self._fail(part, error)

    def _fail(self, part: Part, error: Exception) -> None:
        self._failures[part.name] = str(error)
        part.put(MachineState.FAILED, str(error))

    async def _watch_for_the_end(self) -> None:
        over = {MachineState.ENDED, MachineState.FAILED}
        while True:
            for part in self.parts.values():
                part.changed.clear()
            self.on_change()
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
        before = stopped_after(self.requests.applied or self.config)
        left = set(self.parts)
        while left:
            now = {name for name in left if not before.get(name, frozenset()) & left} or set(left)
            left -= now
            async with anyio.create_task_group() as tasks:
                for name in sorted(now):
                    part = self.parts[name]
                    tasks.start_soon(part.stop, float(stop_seconds(part.config)))
        lost = any(each.state is MachineState.UNREACHABLE for each in self.parts.values())
        with anyio.move_on_after(0 if lost else _CLOSING):
            await self._over.wait()
        for part in self.parts.values():
            if part.state is MachineState.UNREACHABLE:
                _log.error("%s could not be stopped: %s", part.name, part.reason)

    def _exit_code(self) -> int:
        rows = [row for part in self.parts.values() for row in part.rows]
        if self._failures or any(row["state"] in _FAILED for row in rows):
            return ExitCode.NODE_FAILED
        if any(part.state is MachineState.UNREACHABLE for part in self.parts.values()):
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


async def _first_done(*works: Awaitable[object]) -> None:
    """Wait for the first of them, and cancel the others; raises what it raises."""
    tasks = [asyncio.ensure_future(work) for work in works]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

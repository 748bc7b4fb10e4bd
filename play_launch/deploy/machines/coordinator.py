"""All machines of a system together: their order, their conditions, and their end."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from typing import TYPE_CHECKING, Any, Final
from uuid import uuid4

import anyio
from msgspec import convert
from msgspec.structs import replace

from play_launch import ExitCode
from play_launch.config.machines import (
    DiscoveryBy,
    discovery_problems,
    part_of,
    stopped_after,
    used_machines,
)
from play_launch.control.event_words import event_object, words_of
from play_launch.control.messages import UnitRow
from play_launch.control.protocol import Code, OperationError
from play_launch.control.units import health_counts
from play_launch.deploy.machines.applying import Applying, without_units
from play_launch.deploy.machines.hosts import HostError, LinkLost
from play_launch.deploy.machines.part import BEGUN, OVER, Part
from play_launch.deploy.machines.reach import reach_problems, report_of
from play_launch.deploy.machines.requests import Requests
from play_launch.deploy.sd_notify import Seen
from play_launch.deploy.unit import stop_seconds
from play_launch.process.descendants import first_of
from play_launch.supervisor.events import MachineState

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from anyio.abc import TaskGroup

    from play_launch.config.machines import MachineConfig
    from play_launch.config.model import ReplayConfig
    from play_launch.deploy.machines.reach import Report
    from play_launch.recording.recorder import Recorder
    from play_launch.supervisor.events import MachineChanged, RunEvent

    Show = Callable[[dict[str, Any]], None]
    """Shows an event of a machine."""

_log = logging.getLogger(__name__)
_BRING_UP: Final = 600.0
"""Seconds until a start that is to be left alone counts as done."""
_CLOSING: Final = 60.0
"""Seconds until all recordings are closed."""
_TELLING: Final = 5.0  # seconds until all have told the exit code that they would have
_ABSENT: Final = 5.0
"""Seconds before an absent machine is tried again."""


class Coordinator:
    """The parts of a system. Belongs to the thread of the event loop."""

    def __init__(
        self,
        config: ReplayConfig,
        arguments: Sequence[str],
        program: str,
        show: Show,
        recorder: Recorder,
    ) -> None:
        """Prepare; ``program`` is play-launch on this machine."""
        self.config = config
        self.arguments = arguments
        self._program = program
        self._show = show
        self._recorder = recorder
        self._met_changed = asyncio.Event()
        self._changed = asyncio.Event()
        """Set when the state of a machine has changed."""
        self._followed: dict[Part, anyio.CancelScope] = {}
        """Those whose session may be running."""
        self._tasks: TaskGroup | None = None
        """Of what goes on while the system runs; None before and once it is to stop."""
        self._ended = asyncio.Event()
        self._failures: dict[str, str] = {}
        self.parts = {
            name: self.part(part_of(config, name), arguments) for name in used_machines(config)
        }
        """By machine; one that was removed stays as it ended."""
        self._left: set[str] = set()
        """Machines on which something of the system may run."""
        self._absent: set[str] = set()
        """Optional machines that were absent and are to be added."""
        self._recordings: dict[str, dict[str, Any]] = {}
        """By session: one that was killed, and one of a machine that was removed, is kept."""
        self._applying = Applying(self)
        self.requests = Requests(self.parts, self._applying)
        self._is_up = False
        self.on_change: Callable[[], None] = lambda: None
        """Called when a machine, what is applied, or whether all is up has changed."""

    async def run(
        self,
        stop: asyncio.Event,
        hurry: asyncio.Event,
        *,
        left: Sequence[MachineConfig] = (),
        detach: bool = False,
    ) -> int:
        """Bring all machines up, accompany them until ``stop`` or their end; return the exit code.

        What runs on machines of ``left``, of an earlier run, is ended first where they are not in
        the configuration. With ``hurry`` it waits for no machine that is being stopped. With
        ``detach`` it returns once all are up, and they run on; the next coordinator adopts them.
        Raises HostError when a machine that is not optional cannot be used; nothing was started.
        """
        await first_of(self._begin(left), stop.wait())
        if stop.is_set():
            for part in self.parts.values():
                await part.close()
            return ExitCode.OK
        async with anyio.create_task_group() as tasks:
            self._tasks = tasks
            tasks.start_soon(self._exchange_conditions)
            for part in self.parts.values():
                self.follow(part)
            tasks.start_soon(self._watch_for_the_end)
            tasks.start_soon(self._add_absent)
            if detach:
                await first_of(stop.wait(), self._ended.wait(), self._all_loaded())
            else:
                tasks.start_soon(self._all_loaded)
                await first_of(stop.wait(), self._ended.wait())
            self._tasks = None
            is_lost = any(p.state is MachineState.UNREACHABLE for p in self.parts.values())
            codes: set[int] = {ExitCode.NODES_MISSING} if is_lost else set()
            codes |= {ExitCode.NODE_FAILED} if self._failures else set()
            used = () if stop.is_set() else used_machines(self.config)
            telling = [self.parts[name] for name in used if name in self.parts]
            with anyio.move_on_after(_TELLING):
                for part in telling:
                    await part.update_exit_code()
            if not detach or stop.is_set():
                await first_of(self._stop(), hurry.wait())
                for part in self.parts.values():
                    await part.request_end()
            tasks.cancel_scope.cancel()
        for part in self.parts.values():
            await part.close()
        codes |= {part.exit_code for part in telling}
        return min(codes - {ExitCode.OK}, default=ExitCode.OK)  # a failure before what is missing

    @property
    def there(self) -> dict[str, Part]:
        """Those that have neither ended nor failed."""
        return {name: part for name, part in self.parts.items() if part.state not in OVER}

    def part(self, config: ReplayConfig, arguments: Sequence[str]) -> Part:
        """Prepare the part of a machine."""
        return Part(
            config,
            arguments,
            self._program,
            self._recorder.clock.now,
            on_event=self._take,
            on_met=self._met_changed.set,
            on_change=self._note,
        )

    def _note(self, change: MachineChanged) -> None:
        is_over = change.state is MachineState.ENDED
        (self._left.discard if is_over else self._left.add)(change.machine)
        self.publish(change)
        self._changed.set()

    def publish(self, event: RunEvent) -> None:
        """Take an event of the coordinator itself."""
        self._recorder.publish(event)
        self._take("", event_object(event) | words_of(event)._asdict())

    def _take(self, machine: str, event: dict[str, Any]) -> None:
        event = {"machine": machine, **event}
        self.requests.take(event)
        self._show(event)

    def recordings(self) -> list[dict[str, Any]]:
        """Say where all parts are and were recorded, and how much their clocks were ahead."""
        for part in self.parts.values():
            if part.hello:
                self._recordings[part.hello["session"]] = {
                    "machine": part.name,
                    "local": part.machine.local,
                    "ssh": part.machine.ssh,
                    "folder": part.hello["folder"],
                    "offsets": part.clock.offsets,
                }
        return [
            {**each, "system": self.config.name, "may_run": each["machine"] in self._left}
            for each in self._recordings.values()
        ]

    def seen(self) -> Seen:
        """Give what is reported to the service manager."""
        rows = [row for part in self.parts.values() for row in part.rows]
        states = {part.name: part.state for part in self.parts.values()}
        running = [*states.values()].count(MachineState.RUNNING)
        lost = [name for name, state in states.items() if state is MachineState.UNREACHABLE]
        units = health_counts(convert(rows, list[UnitRow], strict=False))
        summary = f"{running} of {len(states)} machines running, {units}"
        return Seen(
            is_up=self._is_up,
            pending=[name for name, state in states.items() if state in BEGUN],
            is_changing=self._applying.is_busy,
            summary=f"{summary}; unreachable: {', '.join(lost)}" if lost else summary,
        )

    async def _all_loaded(self) -> None:
        """Wait until all units of all machines are up, or failed for good."""

        async def loaded(part: Part) -> None:
            await part.until_not(BEGUN)
            with contextlib.suppress(OperationError, LinkLost):
                await part.ask("wait", {"timeout": _BRING_UP})

        async with anyio.create_task_group() as tasks:
            for part in self.parts.values():
                tasks.start_soon(loaded, part)
        self._is_up = True
        self.on_change()

    # Start and end.

    async def _begin(self, left: Sequence[MachineConfig]) -> None:
        await self._prepare_all()
        await self._check_discovery()
        used = used_machines(self.config)
        async with anyio.create_task_group() as tasks:
            for machine in left:
                if machine.name not in used:
                    tasks.start_soon(self._end_earlier, machine)

    async def _check_discovery(self) -> None:
        """Warn of what keeps nodes of two machines from finding each other."""
        names = [name for name in used_machines(self.config) if name in self.parts]
        multicast = self.config.discovery is DiscoveryBy.MULTICAST
        token = uuid4().hex
        reports: dict[str, Report] = {}

        async def ask(name: str) -> None:
            others = [each for each in names if each != name]
            with contextlib.suppress(LinkLost):
                found = await report_of(self.parts[name], token, others, multicast=multicast)
                if found is not None:
                    reports[name] = found

        if len(names) < 2:
            return
        async with anyio.create_task_group() as tasks:
            for name in names:
                tasks.start_soon(ask, name)
        reports = {name: reports[name] for name in names if name in reports}
        environs = {name: report["variables"] for name, report in reports.items()}
        problems = discovery_problems(self.config, environs)
        problems += reach_problems(reports, multicast=multicast and not problems)
        for problem in problems:
            _log.warning("%s", problem)

    async def _end_earlier(self, machine: MachineConfig) -> None:
        config = replace(without_units(self.config), machines={machine.name: machine})
        part = self.part(replace(config, machine=machine.name), ())
        try:
            if await part.end_earlier():
                _log.warning("%s: what an earlier run has left there was ended", machine.name)
        except (HostError, LinkLost, OperationError) as error:
            text = "%s: what an earlier run has left there may run on: %s"
            _log.warning(text, machine.name, error)
        finally:
            await part.close()

    async def _prepare_all(self) -> None:
        for part in await self.prepare(tuple(self.parts.values())):
            part.put(MachineState.FAILED, part.reason)
            del self.parts[part.name]
        if self.config.discovery is DiscoveryBy.PEERS:
            try:
                await self._share_addresses()
            except LinkLost as lost:
                raise HostError(f"a machine was lost: {lost}") from None

    async def prepare(self, parts: Sequence[Part]) -> list[Part]:
        """Prepare parts at once; return those of optional machines that cannot be used.

        Raises HostError with a line for each problem where another one cannot; all are closed then.
        """
        problems: dict[Part, HostError | LinkLost] = {}

        async def prepare(part: Part) -> None:
            try:
                await part.prepare()
            except (HostError, LinkLost) as error:
                problems[part] = error

        async with anyio.create_task_group() as tasks:
            for part in parts:
                tasks.start_soon(prepare, part)
        if any(not part.machine.optional for part in problems):
            for part in parts:
                await part.close()
            lines = (f"machine {part.name}: {problems[part]}" for part in parts if part in problems)
            raise HostError("\n".join(lines))
        for part, problem in problems.items():
            _log.warning("%s: %s; the others start without it", part.name, problem)
            part.reason = str(problem)
            await part.close()
            # Peers look for the addresses of the start only.
            if isinstance(problem, LinkLost) and part.config.discovery is not DiscoveryBy.PEERS:
                self._absent.add(part.name)
        return list(problems)

    async def _add_absent(self) -> None:
        """Add optional machines that were absent as soon as they answer."""
        while True:
            await asyncio.sleep(_ABSENT)
            for name in tuple(self._absent):
                if await self._has_joined(name):
                    self._absent.discard(name)

    async def _has_joined(self, name: str) -> bool:
        """Try to add a machine; return whether it need not be tried again."""
        config = self.config
        if name in self.there or name not in used_machines(config):
            return True
        part = self.part(part_of(config, name), self.arguments)
        joins = False
        try:
            await part.prepare()
            is_same = self.config is config and not self._applying.is_busy
            is_running = self._tasks is not None and not self._ended.is_set()
            joins = is_same and is_running and name not in self.there
            if joins:
                _log.warning("%s: it answers by now, and is started", name)
                self.parts[name] = part
                self.follow(part)
        except LinkLost:
            pass
        except HostError as error:
            _log.warning("%s: it answers by now, but cannot be used: %s", name, error)
            return True
        finally:
            if not joins:
                await part.close()
        return joins

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
            part.take(part.config, await part.bring(part.config))

    def follow(self, part: Part) -> None:
        """Start or adopt the session of a part, and accompany it; raises OperationError."""
        tasks = self.require_running()
        self._failures.pop(part.name, None)
        self._followed[part] = scope = anyio.CancelScope()
        tasks.start_soon(self._accompany, part, scope)

    async def _accompany(self, part: Part, scope: anyio.CancelScope) -> None:
        with scope:
            try:
                await part.run()
            except HostError as error:
                self._fail(part, error)
            except Exception as error:  # noqa: BLE001 - the other machines continue
                _log.exception("%s cannot be accompanied any more", part.name)
                self._fail(part, error)
        del self._followed[part]
        self._changed.set()

    def require_running(self) -> TaskGroup:
        """Return its tasks; raises OperationError while it is being started or stopped."""
        if self._tasks is None or self._ended.is_set():
            raise OperationError(Code.REFUSED, "the system is being started, or stopped")
        return self._tasks

    async def leave(self, part: Part) -> None:
        """Accompany a part no longer; what may run there goes on."""
        self._followed[part].cancel()
        await part.close()
        part.put(MachineState.ENDED, "it was removed while it was unreachable")
        self._left.add(part.name)

    def _fail(self, part: Part, error: Exception) -> None:
        self._failures[part.name] = str(error)
        part.put(MachineState.FAILED, str(error))

    async def _watch_for_the_end(self) -> None:
        while True:
            self._changed.clear()
            self.on_change()
            ends_all = next((each.name for each in self.parts.values() if each.ends_all), None)
            ended = {name for name, part in self.parts.items() if part.state in OVER}
            if ends_all in ended:
                _log.warning("%s ends the whole system (on_exit: shutdown)", ends_all)
            if len(ended) == len(self.parts) or ends_all in ended:
                self._ended.set()
                return
            await self._changed.wait()

    async def _stop(self) -> None:
        """Stop the machines, those first that depend on others."""

        async def stopped(parts: Iterable[Part]) -> None:
            async with anyio.create_task_group() as tasks:
                for part in parts:
                    tasks.start_soon(part.stop, float(stop_seconds(part.config)))

        before = stopped_after(self.config)
        left = set(self.parts)
        while left:
            now = {name for name in left if not before.get(name, frozenset()) & left} or set(left)
            left -= now
            await stopped(self.parts[name] for name in sorted(now))
        # A connection that was lost may have come back since its machine was to be stopped.
        await stopped(p for p in self.parts.values() if p.state is MachineState.RUNNING)
        lost = any(each.state is MachineState.UNREACHABLE for each in self.parts.values())
        with anyio.move_on_after(0 if lost else _CLOSING):
            while self._followed:
                self._changed.clear()
                await self._changed.wait()
        for part in self.parts.values():
            if part.state is MachineState.UNREACHABLE:
                _log.error("%s could not be stopped: %s", part.name, part.reason)

    async def _exchange_conditions(self) -> None:
        """Tell each machine what is met on the others."""
        while True:
            await self._met_changed.wait()
            self._met_changed.clear()
            for part in tuple(self.parts.values()):
                others = (each for each in self.parts.values() if each is not part)
                met = sorted(list(each) for other in others for each in other.met)
                if part.told != met:
                    await part.tell(met)

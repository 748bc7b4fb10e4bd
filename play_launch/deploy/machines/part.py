"""The part of one machine: brought there, started or adopted, followed, and stopped."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import shlex
import time
from typing import TYPE_CHECKING, Any, Final

import anyio

from play_launch import ExitCode
from play_launch.config.machines import Service
from play_launch.control.feed import USUAL_KINDS
from play_launch.control.protocol import Code, OperationError
from play_launch.deploy.machines.bundle import BUSY, Bundle, files_of, require_fit
from play_launch.deploy.machines.channel import Channel, OtherClock, links_of, session_of
from play_launch.deploy.machines.hosts import (
    HostError,
    LinkLost,
    SessionGone,
    about,
    connect,
    connect_at_first,
)
from play_launch.process.descendants import first_of
from play_launch.supervisor.events import MachineChanged, MachineState

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Container, Sequence

    from play_launch.config.machines import MachineConfig
    from play_launch.config.model import ReplayConfig
    from play_launch.deploy.machines.hosts import About, Host

_log = logging.getLogger(__name__)
_RETRY: Final = (0.25, 5.0)  # first and longest pause in seconds before a lost one is tried again
_APPEARS: Final = 60.0  # seconds from the start of a session to its socket, on a cold disk
_POLL: Final = 0.1
_ENDED_WELL: Final = {str(int(code)) for code in (ExitCode.OK, ExitCode.NODES_MISSING)}
_AGAIN: Final = 1.0  # seconds before a session that refused a request is followed again
_CLOCK_PERIOD: Final = 30.0
_STARTS: Final = 5  # of a session that was killed, in a minute
_REFRESH: Final = 0.3  # seconds between an event and the rows that are kept
BEGUN: Final = frozenset((MachineState.CONNECTING, MachineState.STARTING, MachineState.UNREACHABLE))
OVER: Final = frozenset((MachineState.ENDED, MachineState.FAILED))
_UNTIL_GONE: Final = """\
for i in $(seq 1000); do kill -0 {pid} 2> /dev/null || break; sleep 0.05; done"""


class Part:
    """Accompanies the session of one machine, from its start to its end."""

    def __init__(
        self,
        part: ReplayConfig,
        arguments: Sequence[str],
        program: str,
        recording_clock: Callable[[], int],
        *,
        on_event: Callable[[str, dict[str, Any]], None],
        on_met: Callable[[], None],
        on_change: Callable[[MachineChanged], None],
    ) -> None:
        """Prepare; ``program`` is play-launch on this machine, for the local part."""
        self._recording_clock = recording_clock
        self.machine: MachineConfig = part.machines[part.machine]
        self.name = part.machine
        self.config = part
        self.state = MachineState.CONNECTING
        self.reason = ""
        self.since_ns = time.time_ns()
        self.rows: list[dict[str, Any]] = []
        self.met: list[list[str]] = []  # conditions that others wait for
        self.exit_code: int = ExitCode.NODES_MISSING  # that its session would have
        self.hello: dict[str, Any] = {}
        self.clock = self._new_clock()
        self.changed = asyncio.Event()
        self.peers: tuple[str, ...] = ()
        self._arguments, self._program = tuple(arguments), program
        self._on_event, self._on_met, self._on_change = on_event, on_met, on_change
        self._host: Host | None = None
        self._about: About | None = None
        self._bundle: Bundle | None = None
        self._link, self._seen = "", 0
        self._stale = asyncio.Event()
        self.ends_all = False  # by a rule: `on_exit: shutdown`
        self._starts: list[float] = []
        self._is_adopting = False
        self.told: list[list[str]] = []  # conditions that are met elsewhere

    @property
    def bundle(self) -> Bundle:
        assert self._bundle is not None
        return self._bundle

    @property
    def host(self) -> Host:
        if self._host is None:
            raise LinkLost("not connected")
        return self._host

    async def open(self) -> Channel:
        """Connect to its session once more; raises LinkLost and OperationError."""
        if self.state is not MachineState.RUNNING and not self._is_adopting:
            raise LinkLost(self.reason or str(self.state))
        return await Channel.open(self.host, self._link)

    async def ask(self, operation: str, arguments: object = None) -> Any:
        """Raises LinkLost and OperationError."""
        channel = await self.open()
        try:
            return await channel.ask(operation, arguments)
        finally:
            channel.close()

    def here(self, row: dict[str, Any]) -> dict[str, Any]:
        """Return a row with the place of its declaration on this machine."""
        if self.machine.local or self._bundle is None or "declared" not in row:
            return row
        return {**row, "declared": row["declared"].removeprefix(f"{self.bundle.folder}/files")}

    async def prepare(self) -> None:
        """Connect, bring the files there, and let the machine check its part.

        Raises HostError where a person has to act, and LinkLost.
        """
        self._host, self._about = await connect_at_first(self.machine)
        self.take(self.config, await self.bring(self.config))
        await require_fit(self.host, self.bundle)

    async def run(self) -> None:
        """Start or adopt the session and follow it to its end; raises HostError."""
        self.put(MachineState.STARTING)
        try:
            await self.adopt(self.config, self.bundle)
            await self._attach(await self._adopted() or await self._start())
        except LinkLost as lost:
            await self._lose(lost)
        while self.state is not MachineState.ENDED:
            try:
                if self.state is MachineState.UNREACHABLE:
                    await self._return()
                if self.state is MachineState.RUNNING:
                    await self._follow()
            except LinkLost as lost:
                await self._lose(lost)
        if self.hello:
            with contextlib.suppress(LinkLost):  # its recording is closed
                await self.host.run(_UNTIL_GONE.format(pid=int(self.hello["pid"])))

    async def stop(self, limit: float) -> None:
        """End its session in order, and wait for that; one that is being started comes up first."""
        with anyio.move_on_after(limit):
            await self.until_not({MachineState.CONNECTING, MachineState.STARTING})
            await self.request_end()
            await self.until_not({MachineState.RUNNING})

    async def request_end(self) -> None:
        with contextlib.suppress(LinkLost, OperationError):
            await self.ask("end")

    async def end_earlier(self) -> bool:
        """End what an earlier coordinator has left running there; return whether there was any.

        Raises HostError, LinkLost and OperationError.
        """
        self._host, self._about = await connect_at_first(self.machine)
        if not (link := await self._running()):
            return False
        channel = await Channel.open(self.host, link)
        try:
            await channel.ask("end")
        finally:
            channel.close()
        await self.host.run(_UNTIL_GONE.format(pid=int(channel.hello["pid"])))
        return True

    async def until_not(self, states: Container[MachineState]) -> None:
        while self.state in states:
            self.changed.clear()
            await self.changed.wait()

    async def close(self) -> None:
        host, self._host = self._host, None
        if host is not None:
            await host.close()

    async def bring(self, part: ReplayConfig, arguments: Sequence[str] | None = None) -> Bundle:
        """Copy what a configuration needs there, unless it is there; nothing is changed yet.

        Raises HostError and LinkLost.
        """
        assert self._about is not None
        home = self._about.home

        def packed() -> tuple[Bundle, dict[str, bytes]]:
            files = files_of(part, part.machines[part.machine].copy)
            given = self._arguments if arguments is None else tuple(arguments)
            program, peers = self._program, self.peers
            return Bundle(part, given, files, home=home, program=program, peers=peers), files

        bundle, files = await asyncio.to_thread(packed)
        await bundle.bring(self.host, files)
        return bundle

    async def adopt(self, part: ReplayConfig, bundle: Bundle) -> None:
        """Take a configuration, also as what the machine starts next time; raises LinkLost."""
        self.take(part, bundle)
        await self.host.run(bundle.adopt_command())

    def take(self, part: ReplayConfig, bundle: Bundle) -> None:
        self.config, self._bundle, self._arguments = part, bundle, bundle.arguments
        self.machine = bundle.machine

    # Start.

    async def _running(self) -> str:
        """Return the link of a session of this part that runs already; empty if there is none."""
        assert self._about is not None
        return await session_of(self.host, self._about, self.name, self.config.name)

    async def _adopted(self) -> str:
        """Bring a session that runs already to this configuration; return its link, if any."""
        self._link = await self._running()
        if not self._link:
            return ""
        _log.info("%s: its session runs already and is adopted", self.name)
        self._is_adopting = True
        try:
            # What is changed may wait for what other machines are changed to.
            request = {"path": self.bundle.source, "arguments": self._arguments}
            await first_of(self.ask("apply", request), self._exchange())
        except OperationError as error:
            if error.code == Code.REFUSED:  # the change of an earlier connection goes on
                raise LinkLost(str(error)) from None
            text = "another configuration runs there, and cannot be changed to this one"
            raise HostError(f"{text}: {error}") from None
        finally:
            self._is_adopting = False
        return self._link

    async def _exchange(self) -> None:
        """Exchange conditions with other machines; raises OperationError and LinkLost."""
        await self.tell(self.told)
        await self.listen()
        raise SessionGone

    async def _start(self) -> str:
        """Start the session and return its link; empty if it has ended by now."""
        now = time.monotonic()
        self._starts = [each for each in self._starts if now - each < 60] + [now]
        if len(self._starts) > _STARTS:
            raise HostError("its session was killed again and again; see its journal or output")
        output = await self.host.run(self.bundle.start_command())
        if output.status:
            raise HostError(f"its session cannot be started: {output.stderr or output.stdout}")
        pid, folder = output.stdout.strip(), shlex.quote(self.bundle.folder)
        deadline = time.monotonic() + _APPEARS
        while time.monotonic() < deadline:
            if link := await self._running():
                return link
            if pid and (await self.host.run(f"kill -0 {pid}")).status:
                output = await self.host.run(f"cd {folder}; cat status; tail -n 5 output")
                status, _, tail = output.stdout.partition("\n")
                if BUSY in tail:
                    pid = ""
                elif status in _ENDED_WELL:
                    self.exit_code = int(status)
                    return ""
                else:
                    raise HostError(f"its session ended at once: {tail.strip()}")
            await asyncio.sleep(_POLL)
        raise HostError(f"its session did not answer within {_APPEARS:g} s")

    # A session that runs.

    async def _attach(self, link: str) -> None:
        if not link:
            if not self._seen:  # no event of it: an exit of such a unit ends it in any case
                rules = {each.on_exit for each in self.config.nodes}
                rules |= {each.on_exit for each in self.config.containers}
                self.ends_all = "shutdown" in rules
            self.put(MachineState.ENDED, "its session has ended")
            return
        channel = await Channel.open(self.host, link)
        channel.close()
        if channel.hello["session"] != self.hello.get("session"):
            if self.hello:
                _log.warning("%s: its session was started anew meanwhile", self.name)
            self._seen, self.exit_code = 0, ExitCode.OK
            self.clock = self._new_clock()
        self.hello, self._link = channel.hello, link
        self.put(MachineState.RUNNING)

    async def _follow(self) -> None:
        """Follow the session to its end; raises LinkLost."""
        self._stale.set()
        lost: list[LinkLost] = []

        async def guarded(work: Callable[[], Awaitable[None]]) -> None:
            try:
                await work()
            except SessionGone:
                pass
            except LinkLost as error:
                lost.append(error)
            except OperationError as error:
                _log.warning("%s: %s", self.name, error)
                await asyncio.sleep(_AGAIN)
            tasks.cancel_scope.cancel()

        async with anyio.create_task_group() as tasks:
            for work in (self._events, self.listen, self._keep_rows, self._care):
                tasks.start_soon(guarded, work)
        if lost:
            raise lost[0]
        await self._find_out_how_it_ended()

    async def _events(self) -> None:
        channel = await self.open()
        request = {"follow": True, "kinds": sorted({*USUAL_KINDS, "output"}), "since": self._seen}
        try:
            async for message in channel.stream("events", request):
                event = message.get("event")
                if event is not None:
                    self._seen = max(self._seen, event["number"])
                    self.ends_all |= event.get("sequel") == "shutdown"
                    if event["event"] != "output":
                        self._stale.set()
                    self._on_event(self.name, event)
                elif "missed" in message:
                    text = "%s: %s events came faster than the connection carries; all are recorded"
                    _log.warning(text, self.name, message["missed"])
        finally:
            channel.close()

    async def update_exit_code(self) -> None:
        with contextlib.suppress(LinkLost, OperationError):
            await self.listen(once=True)

    async def listen(self, *, once: bool = False) -> None:
        """Take the conditions and the exit code that it tells; raises as `ask`."""
        channel = await self.open()
        try:
            async for message in channel.stream("conditions"):
                self.exit_code = message.get("exit_code", self.exit_code)
                if "met" in message:
                    self.met = message["met"]
                    self._on_met()
                elif once:
                    return
        finally:
            channel.close()

    async def _keep_rows(self) -> None:
        """Keep the rows that are shown when the machine is lost."""
        while True:
            await self._stale.wait()
            self._stale.clear()
            await self.refresh()
            await asyncio.sleep(_REFRESH)

    async def refresh(self) -> None:
        """Raises LinkLost and OperationError."""
        self.rows = await self.ask("ps")

    async def tell(self, met: list[list[str]]) -> None:
        """Report the conditions that are met on other machines."""
        self.told = met
        if self.state is MachineState.RUNNING or self._is_adopting:
            with contextlib.suppress(LinkLost, OperationError):
                await self.ask("meet", {"met": met})

    async def _care(self) -> None:
        """Renew the lease, and measure the clock now and then."""
        await self.tell(self.told)
        measured = -math.inf
        lease = self.machine.stop_after
        while True:
            if math.isfinite(lease):
                await self.ask("lease", {"seconds": lease})
            if time.monotonic() - measured > _CLOCK_PERIOD:
                measured = time.monotonic()
                await self.clock.measure(self.open)
            await asyncio.sleep(min(lease / 4, _CLOCK_PERIOD))

    def _new_clock(self) -> OtherClock:
        return OtherClock(self.name, self.machine.max_clock_offset, self._recording_clock)

    async def _find_out_how_it_ended(self) -> None:
        """Attach to its session if it runs, else decide how it ended; raises LinkLost."""
        assert self._about is not None
        link = await self._running()
        # A session that ends in order removes its link when nothing of it runs any more.
        if link or self._link not in await links_of(self.host, self._about):
            await self._attach(link)
            return
        self.put(MachineState.STARTING, "the supervisor of its session was killed")
        if self.machine.local or self.machine.service is Service.NONE:
            await self._attach(await self._start())
            return
        deadline = time.monotonic() + _APPEARS
        while not (link := await self._running()):
            if time.monotonic() > deadline:
                raise HostError("systemd did not start its session again")
            await asyncio.sleep(_POLL)
        await self._attach(link)

    # A machine that is lost.

    async def _lose(self, lost: LinkLost) -> None:
        if self.state is not MachineState.UNREACHABLE:
            self.put(MachineState.UNREACHABLE, f"the connection is lost: {lost}")
        await self.close()

    async def _return(self) -> None:
        """Connect again, as often as it takes, and attach to what runs there."""
        pause, longest = _RETRY
        while True:
            try:
                self._host = await connect(self.machine)
                boot = "" if self._about is None else self._about.boot
                self._about = await about(self._host)
                break
            except (LinkLost, HostError) as error:
                await self.close()
                self.reason = str(error)
                await asyncio.sleep(pause)
                pause = min(2 * pause, longest)
        if self.hello and self._about.boot == boot:
            await self._find_out_how_it_ended()
        elif link := await (self._running() if self.hello else self._adopted()):
            await self._attach(link)
        else:
            _log.warning("%s: it was booted anew; its part is started", self.name)
            await self.adopt(self.config, await self.bring(self.config))
            await self._attach(await self._start())

    def put(self, state: MachineState, reason: str = "") -> None:
        self.state, self.reason, self.since_ns = state, reason, time.time_ns()
        self.changed.set()
        self._on_change(
            MachineChanged(stamp_ns=self.since_ns, machine=self.name, state=state, reason=reason)
        )

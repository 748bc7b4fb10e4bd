"""One container: its control channel, its nodes, and whether it still answers."""

from __future__ import annotations

import asyncio
import logging
import random
from functools import partial
from typing import TYPE_CHECKING

import anyio
from msgspec.structs import replace

from play_launch.actors.container.hello import description, isolation_shortfall
from play_launch.actors.container.limits import LIMITS, Limits
from play_launch.actors.container.nodes import ContainerNodes
from play_launch.actors.container.watch import ContainerWatch
from play_launch.actors.death import Death, death_of_container
from play_launch.actors.member import Member
from play_launch.actors.resource_report import report_shortfalls
from play_launch.core.events import REPORTED_LOGGER, ContainerState, ProcessEventKind
from play_launch.core.lifecycle import Patience
from play_launch.core.member import MemberInput
from play_launch.core.restart import OnExit
from play_launch.wire.channel import ChannelClosedError, ControlError, VersionMismatchError
from play_launch.wire.messages import Hello, Incoming, Shutdown, Status

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from play_launch.actors.container.attempts import AttemptNumbers
    from play_launch.actors.container.library_probes import LibraryProbes
    from play_launch.actors.order import StartOrder
    from play_launch.actors.ports import ControlLink, Launcher, ManagedProcess, StartError
    from play_launch.actors.publisher import Publisher
    from play_launch.actors.stop_requests import StopRequests
    from play_launch.actors.turn import StartTurn
    from play_launch.config.model import ContainerConfig
    from play_launch.process.exit import Exit

_log = logging.getLogger(__name__)
_reported = logging.getLogger(REPORTED_LOGGER)


class ContainerMember(Member):
    """Owns one container from the beginning of the run to its end."""

    def __init__(
        self,
        config: ContainerConfig,
        *,
        launcher: Launcher,
        publisher: Publisher,
        stop: StopRequests,
        attempts: AttemptNumbers,
        turn: StartTurn,
        order: StartOrder,
        probes: LibraryProbes | None = None,
        limits: Limits = LIMITS,
        jitter: Callable[[], float] = random.random,
    ) -> None:
        """Know the container.

        ``probes`` loads libraries in scratch processes; None where the container is not our own.
        """
        super().__init__(
            config.full_name,
            restart=config.restart,
            publisher=publisher,
            stop=stop,
            turn=turn,
            jitter=jitter,
        )
        self._config = config
        self._launcher = launcher
        self._publisher = publisher
        self._limits = limits
        self.nodes = ContainerNodes(
            config,
            publisher=publisher,
            escalation=self,
            attempts=attempts,
            patience=Patience(
                loading_timeout=config.loading_timeout, report_interval=limits.report_interval
            ),
            clock=self._loop.time,
            jitter=jitter,
            silence=limits.silence,
            deliver=self.deliver,
            order=order,
            groups=launcher.groups,
            probes=probes,
        )
        self._watch = ContainerWatch(self.name, clock=self._loop.time, limits=limits.watch)
        # Of the latest process:
        self._link: ControlLink | None = None
        self._listening: anyio.CancelScope | None = None
        self._said_everything = asyncio.Event()
        self._hello: Hello | None = None
        self._hello_due: float | None = None
        self._ready_at: float | None = None
        self._blames_loads = True

    def announce(self) -> None:
        """Publish that it and its nodes are declared."""
        self._publish_state("")
        self.nodes.announce()

    def adopt(self, config: ContainerConfig) -> None:
        """Take another configuration; what its process reads holds from the next start on.

        Its nodes are declared one by one, see `nodes`.
        """
        self._config = config
        self._restarter.limit(config.restart)
        self.nodes.patience = replace(self.nodes.patience, loading_timeout=config.loading_timeout)
        self.nodes.suspects.adopt(config)

    def close(self) -> None:
        """Do nothing at any later time."""
        super().close()
        self.nodes.suspects.close()

    def stop_container(self, reason: str) -> None:
        """Stop it for good, while the rest of the system runs on."""
        self.post(MemberInput.STOP, reason)

    def shut_down(self, reason: str) -> None:
        """Stop the whole system."""
        self._stop.request(reason=reason)

    def reload_hangs(self, reason: str) -> None:
        """Start it anew if it may hold the lock of a dead node; else the node is just slow."""
        if self._watch.may_hold_dead_locks:
            self._poisoned(f"a dead node may have left a lock: {reason}")

    def renew(self, reason: str) -> bool:
        """Start it anew in order; its nodes must share it, and restarts must be allowed."""
        shares = self._hello is not None and self._hello.mechanism == "shared_memory"
        is_ours = not self._config.attach and self._config.restart.max_restarts > 0
        if not shares or not is_ours or self.state is not ContainerState.RUNNING:
            return False
        _reported.warning("%s is started anew: %s", self.name, reason)
        self.post(MemberInput.RESTART, reason)
        return True

    def _look_for_dead_locks(self) -> None:
        if waiting := self._watch.waits_for_the_dead:
            self._poisoned(f"a node died with a lock: {waiting}")
            return
        limit = self._limits.reload_after_leak
        if self._watch.probably_holds_dead_locks and (name := self.nodes.slow_reload(limit)):
            self._poisoned(f"{name} is not loaded again, and cleaning up after a dead node failed")

    def _poisoned(self, reason: str) -> None:
        """Have it restarted because of a node that died, so not because of one that is loaded."""
        if self.state is ContainerState.RUNNING:
            self._blames_loads = False
        self.post(MemberInput.FROZEN, reason)

    # What a container has to say as a member.

    def _begin_sources(self) -> None:
        self._sources.begin(self.nodes.suspects.run)

    def _spawn(self) -> ManagedProcess:
        self._hello = None
        self._ready_at = None
        self._blames_loads = True
        self._said_everything = asyncio.Event()
        process, self._link = self._launcher.start_container(self._config, self._reports.on_output)
        return process

    def _started(self) -> None:
        assert self._link is not None
        # One that somebody else starts may come at any time, and a debugger may take any time.
        may_be_late = self._config.attach or self._config.prefix
        self._hello_due = None if may_be_late else self._loop.time() + self._limits.hello
        self._sources.begin(partial(self._listen, self._link, self._said_everything))

    def _death_of(self, exit_: Exit) -> Death:
        lived = None if self._ready_at is None else self._loop.time() - self._ready_at
        return death_of_container(exit_, self._killed_because, lived)

    def _die(self, death: Death) -> None:
        was_stopped = self.state is ContainerState.STOPPING
        ends_all = self._config.on_exit is OnExit.SHUTDOWN and not was_stopped
        # Another start would only be in the way of the end.
        super()._die(replace(death, permanent=True) if ends_all and not death.by_itself else death)
        if ends_all:
            self._stop.request(reason=f"{self.name} has ended")

    def _cannot_start(self, error: StartError) -> Death:
        return Death(str(error), permanent=error.permanent)

    def _begin_work(self) -> None:
        assert self._link is not None
        assert self._hello is not None
        self._ready_at = self._loop.time()
        if self._hello.full_node_name != self.name:
            _log.warning("%s calls itself %s", self.name, self._hello.full_node_name)
        self._publish(ProcessEventKind.READY, description(self._hello))
        shortfall = isolation_shortfall(self._config, self._hello)
        if shortfall and self._publisher.is_news(shortfall):
            _log.warning("%s: %s", self.name, shortfall)
        if self._process is not None:
            pid = self._hello.pid or self._process.pid
            report_shortfalls(self.name, self._config.resources, pid, self._publisher)
            self._launcher.groups.check(self.name, pid)
        if not self._config.prefix:  # a debugger may stop it
            pid = self._hello.pid or (self._process.pid if self._process else 0)
            self._watch.begin(self._link.send, pid)
        self.nodes.container_ready(self._link.send)

    def _lose(self, reason: str, *, comes_back: bool) -> None:
        self.nodes.container_lost(f"its container: {reason}")
        if comes_back:
            self.nodes.container_comes_back(self._death_reason if self._blames_loads else "")

    def _stops(self) -> None:
        self._hello_due = None
        self._watch.end()
        if not self._has_ended:
            self.nodes.container_stops()

    def _way_to_ask(self) -> Callable[[], bool] | None:
        return self._ask_to_stop if self._ready_at is not None else None

    def _ask_to_stop(self) -> bool:
        if self._link is None:
            return False
        try:
            self._link.send(Shutdown(reason=self._stop_reason))
        except ControlError:
            return False
        return True

    async def _last_words(self) -> None:
        # What it said last is still in the socket.
        with anyio.move_on_after(self._limits.last_words):
            await self._said_everything.wait()

    def _let_go(self) -> None:
        if self._listening is not None:
            self._listening.cancel()
            self._listening = None
        if self._link is not None:
            self._link.close()
            self._link = None
        self._hello_due = None
        self._watch.end()

    async def _clean_up(self) -> None:
        # A lock that a killed participant left would keep the next one waiting.
        if self.wanted:
            await self._launcher.clean_up()

    def _counts(self) -> bool:
        return not (self._blames_loads and self.nodes.suspects.excuse_death())

    def _sequel(self, delay: float) -> str:
        what = "looked for again" if self._config.attach else "starts again"
        return f"{what} in {delay:.2f} s"

    def _publish_state(self, reason: str) -> None:
        runs = self.state is ContainerState.RUNNING and self._hello is not None
        mechanism = self._hello.mechanism if runs and self._hello else ""
        self._publisher.publish_container(self.name, self.state, reason, mechanism)

    def _deadlines(self) -> Iterator[float | None]:
        yield from super()._deadlines()
        yield self._hello_due
        yield self._watch.next_deadline()
        yield self.nodes.next_deadline()

    def _on_time(self) -> None:
        super()._on_time()
        if self._hello_due is not None and self._loop.time() >= self._hello_due:
            self._hello_due = None
            reason = f"it did not say hello within {self._limits.hello:g} s"
            self._apply(MemberInput.HELLO_OVERDUE, reason)
        if frozen := self._watch.on_time():
            self._apply(MemberInput.FROZEN, frozen)
        self.nodes.on_time()

    # The conversation.

    async def _listen(self, link: ControlLink, said_everything: asyncio.Event) -> None:
        """Hear what the container says, up to the end of the channel."""
        with anyio.CancelScope() as self._listening:
            try:
                hello = await link.handshake(self._launcher.hello())
                self.deliver(partial(self._on_hello, hello))
                while True:
                    self.deliver(partial(self._on_message, await link.receive()))
            except VersionMismatchError as error:
                self.post(MemberInput.HELLO_MISMATCH, str(error))
            except ChannelClosedError as error:
                said_everything.set()
                # The channel ends a moment before the process does.
                await anyio.sleep(self._limits.exit_after_close)
                self.post(MemberInput.CHANNEL_BROKEN, str(error))
            except ControlError as error:
                self.post(MemberInput.CHANNEL_BROKEN, str(error))
            finally:
                said_everything.set()

    def _on_hello(self, hello: Hello) -> None:
        self._hello_due = None
        if self.state is ContainerState.STARTING:
            self._hello = hello
        self._apply(MemberInput.READY)

    def _on_message(self, message: Incoming) -> None:
        if isinstance(message, Hello):
            _log.warning("%s said hello again", self.name)
        elif isinstance(message, Status) and self._watch.hear(message):
            self._look_for_dead_locks()
            self.nodes.hear_silence(message.nodes)
        else:
            self.nodes.hear(message)

"""One ordinary executable."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

from play_launch.actors.death import Death, death_of_process
from play_launch.actors.member import Member
from play_launch.actors.resource_report import report_shortfalls
from play_launch.core.events import ContainerState, ProcessEventKind
from play_launch.core.member import MemberInput
from play_launch.core.restart import OnExit

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.actors.ports import Launcher, ManagedProcess, StartError
    from play_launch.actors.publisher import Publisher
    from play_launch.actors.stop_requests import StopRequests
    from play_launch.actors.turn import StartTurn
    from play_launch.config.model import ProcessConfig
    from play_launch.process.exit import Exit


class ProcessMember(Member):
    """Owns one executable from the beginning of the run to its end."""

    def __init__(
        self,
        config: ProcessConfig,
        *,
        launcher: Launcher,
        publisher: Publisher,
        stop: StopRequests,
        turn: StartTurn,
        jitter: Callable[[], float] = random.random,
    ) -> None:
        """Know the executable."""
        super().__init__(
            config.full_name,
            restart=config.restart,
            publisher=publisher,
            stop=stop,
            turn=turn,
            jitter=jitter,
        )
        self._config = config
        self._publisher = publisher
        self._launcher = launcher
        self._respawns = config.on_exit is OnExit.RESTART
        self._began = 0.0
        self._was_killed = False

    def adopt(self, config: ProcessConfig) -> None:
        """Take another configuration; what its process reads holds from the next start on."""
        self._config = config
        self._respawns = config.on_exit is OnExit.RESTART
        self._restarter.limit(config.restart)

    def _spawn(self) -> ManagedProcess:
        self._began = self._loop.time()
        return self._launcher.start_process(self._config, self._reports.on_output)

    def _started(self) -> None:
        assert self._process is not None
        resources = self._config.resources
        report_shortfalls(self.name, resources, self._process.pid, self._publisher)
        self._launcher.groups.check(self.name, self._process.pid)
        self._apply(MemberInput.READY)

    def _death_of(self, exit_: Exit) -> Death:
        is_asked = self.state in {ContainerState.STOPPING, ContainerState.KILLING}
        self._was_killed = (exit_.signal != 0 or exit_.is_lost) and not is_asked
        lived = self._loop.time() - self._began
        return death_of_process(exit_, lived, respawn=self._respawns)

    def _cannot_start(self, error: StartError) -> Death:
        return Death(str(error), permanent=error.permanent or not self._respawns)

    def _die(self, death: Death) -> None:
        was_stopped = self.state is ContainerState.STOPPING
        super()._die(death)
        # After that was published: the exit code of the run is that of the system as it is now.
        if self._config.on_exit is OnExit.SHUTDOWN and not was_stopped:
            self._stop.request(reason=f"{self.name} has ended")

    def _publish_state(self, reason: str) -> None:
        known = self._publisher.view.processes.get(self.name)
        # Without an exit to report, it would be shown as waiting for its start.
        if (
            self.state is ContainerState.STOPPED
            and known is not None
            and (known.restarting or known.waiting)
        ):
            self._publish(ProcessEventKind.STOPPED, reason)

    async def _clean_up(self) -> None:
        # Who writes to it, in this system or another, would go on writing into its memory, and may
        # wait for itself there if it is none of ours (docs/fastdds.md).
        if self._was_killed:
            await self._launcher.clean_up()

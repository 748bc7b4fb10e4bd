"""One ordinary executable."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

from play_launch.actors.death import Death, death_of_process
from play_launch.actors.member import Member
from play_launch.core.member import MemberInput

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.actors.ports import Launcher, ManagedProcess, StartError
    from play_launch.actors.publisher import Publisher
    from play_launch.actors.stop_requests import StopRequests
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
        jitter: Callable[[], float] = random.random,
    ) -> None:
        """Know the executable."""
        super().__init__(
            config.full_name, restart=config.restart, publisher=publisher, stop=stop, jitter=jitter
        )
        self._config = config
        self._launcher = launcher
        self._began = 0.0

    def _spawn(self) -> ManagedProcess:
        self._began = self._loop.time()
        return self._launcher.start_process(self._config, self._reports.on_output)

    def _started(self) -> None:
        self._apply(MemberInput.READY)

    def _death_of(self, exit_: Exit) -> Death:
        lived = self._loop.time() - self._began
        return death_of_process(exit_, lived, respawn=self._config.respawn)

    def _cannot_start(self, error: StartError) -> Death:
        return Death(str(error), permanent=error.permanent or not self._config.respawn)

"""Only the command line arms failpoints."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.support.isolated import survives

if TYPE_CHECKING:
    from tests.support.control_peer import StartContainer


def test_the_environment_arms_none(spawn: StartContainer) -> None:
    container = spawn(environment={"PLAY_LAUNCH_FAILPOINTS": "container.after_accept=abort"})
    with survives(container):
        container.loaded("Talker")


def test_one_that_does_not_exist_is_refused_in_one_line(spawn: StartContainer) -> None:
    container = spawn(greet=False, failpoints="container.nowhere=abort")
    assert container.wait() == 64
    (line,) = container.log.read_text().splitlines()
    assert "--failpoints" in line
    assert "container.nowhere" in line

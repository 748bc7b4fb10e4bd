"""What is declared and not there at the end: a line on the screen and exit code 3."""

from __future__ import annotations

import pytest

from play_launch.cli.show.lines import line_of
from play_launch.config.model import OnExit
from play_launch.process.exit import Exit
from play_launch.supervisor.events import (
    ComponentEventKind,
    ContainerState,
    NodeState,
    ProcessEventKind,
    RunEvent,
)
from play_launch.supervisor.view import SystemView

from .fakes import FakeContainer, FakeLauncher, container, process, system
from .jumping_loop import run
from .running import Running, running


class Unloads(FakeContainer):
    """Unloads a node on its own, as after a shutdown of the node's context or for somebody else."""

    def unload(self, name: str, error: str = "") -> None:
        held = next(each for each in self.held.values() if each.load.node_name == name)
        del self.held[held.unique_id]
        self.say(ComponentEventKind.UNLOADED, held, error)


def shown(events: list[RunEvent]) -> list[str]:
    view, lines = SystemView(), []
    for event in events:
        before, view = view, view.after(event)
        line = line_of(event, before, view)
        if line is not None and not line.is_progress:
            lines.append(line.text)
    return lines


@pytest.mark.parametrize("nodes", [("a",), ("a", "b"), ("a", "b", "x")])
@pytest.mark.parametrize(
    ("error", "told"),
    [
        ("", "/a unloaded: not at the supervisor's request"),
        ("/a shut its context down", "/a unloaded: /a shut its context down"),
    ],
)
async def test_a_node_that_was_unloaded_without_our_asking(
    nodes: tuple[str, ...], error: str, told: str
) -> None:
    fakes = FakeLauncher(makers={"/c": [Unloads]})
    async with running(system(container("c", *nodes)), fakes) as sys:
        await sys.until_loaded(len(nodes))
        fake = sys.launcher.containers["/c"][0]
        assert isinstance(fake, Unloads)
        fake.unload("a", error)
        await sys.until(lambda: NodeState.UNLOADED in sys.node_states("/a"))
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 3
    assert [each.node for each in sys.outcome.view.unloaded] == ["/a"]
    # The others are unloaded by the stop, which nobody wonders about.
    assert shown(sys.events) == [told]


def test_a_container_that_ended_in_order_and_unasked_is_missing_until_it_is_back() -> None:
    class Ends(FakeContainer):
        def crash(self, signal: int = 0) -> None:
            for unique_id in list(self.held):
                self.on_unload(unique_id)
            self.process.end(Exit())

    async def main(*, waits: bool) -> Running:
        fakes = FakeLauncher(makers={"/c": [Ends, FakeContainer]})
        async with running(system(container("c", "a", "b")), fakes) as sys:
            await sys.until_loaded(2)
            sys.launcher.containers["/c"][0].crash()
            await sys.until_state("/c", ContainerState.BACKOFF)
            if waits:
                await sys.until_loaded(2)
        return sys

    gone = run(main(waits=False))
    assert gone.outcome is not None
    assert gone.outcome.exit_code == 3
    lines = shown(gone.events)
    assert "/a unloaded: not at the supervisor's request" in lines
    assert any("exited with status 0; starts again in" in each for each in lines)
    back = run(main(waits=True))
    assert back.outcome is not None
    assert back.outcome.exit_code == 0


async def test_a_process_between_two_starts_is_missing() -> None:
    async with running(system(process("p", on_exit=OnExit.RESTART)), FakeLauncher()) as sys:
        await sys.until(lambda: ProcessEventKind.STARTED in sys.process_events("/p"))
        sys.launcher.processes["/p"][0].end(Exit(signal=11))
        await sys.until(lambda: ProcessEventKind.RESTARTING in sys.process_events("/p"))
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 3

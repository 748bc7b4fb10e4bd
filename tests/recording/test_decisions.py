"""Inputs in a recording: whatever happens to a system, it follows from them again."""

from __future__ import annotations

import random
from typing import Any

import pytest
from msgspec.structs import replace

from play_launch.cli.rerun import RecordedInputs, repeated
from play_launch.config.model import ParameterConfig, ParameterType, ParameterValue, TakenValues
from play_launch.container.cdr.messages import STATE_EVENT
from play_launch.recording import topics
from play_launch.recording.decisions import (
    Decision,
    DecisionLog,
    UnreadableInputError,
    read,
    written,
)
from play_launch.recording.forms import convert
from play_launch.supervisor import reducer
from play_launch.supervisor.difference import events_since
from play_launch.supervisor.inputs import Origin, Over, Started
from play_launch.supervisor.world import World
from tests.simulation import machine, systems


def states(events: list[Any]) -> list[dict[str, Any]]:
    found = [each for event in events for each in convert(event)]
    return [STATE_EVENT.read(each.data) for each in found if each.topic is topics.STATES]


def lived(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> tuple[list[Decision], list[dict[str, Any]]]:
    """Live a simulated life; return its inputs and what was published."""
    decisions: list[Decision] = []
    published: list[dict[str, Any]] = []
    log = DecisionLog(decisions.append)
    life = machine.Machine(seed)

    def publish(events: list[Any]) -> None:
        published.extend(states(events))
        for event in events:
            log.note(event)
            life.view = life.view.after(event)

    def reduce(world: Any, said: Any, now: float, chance: float) -> Any:
        log.add(now, said, chance)
        return decided(world, said, now, chance)

    decided = reducer.reduce
    monkeypatch.setattr(machine, "reduce", reduce)
    monkeypatch.setattr(life, "publish", publish)
    log.add(life.now, Origin(life.config, life.world.starts, life.world.limits, 0))
    life.begin()
    life.run(life.now + 60.0)
    log.add(life.now, Over())
    return decisions, published


@pytest.mark.parametrize("seed", range(40))
def test_a_simulated_life_follows_from_what_was_written(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    decisions, published = lived(seed, monkeypatch)
    again = [row for each in decisions for row in read(written([each]))]
    found = repeated(RecordedInputs(again, published, "", 0), None, None)
    assert found["differences"] == []
    assert (found["inputs"], found["states"]) == (len(decisions) - 1, len(published))


def test_secrets_and_what_decides_nothing_are_left_out() -> None:
    config = systems.system(random.Random(3))
    secret = ParameterConfig("pin", ParameterValue(ParameterType.INTEGER, 123456))
    boxes = [
        replace(
            box,
            environment={"TOKEN": "hunter2hunter2"},
            composable_nodes=tuple(
                replace(node, parameters=(secret,), package="of hunter2hunter2")
                for node in box.composable_nodes
            ),
        )
        for box in config.containers
    ]
    taken = TakenValues(variables={"TOKEN": "hunter2hunter2"})
    config = replace(config, text=b"hunter2hunter2", containers=tuple(boxes), taken=taken)
    log: list[Decision] = []
    decisions = DecisionLog(log.append)
    decisions.secrets = frozenset({"hunter2hunter2", "123456"})
    decisions.add(5.0, Origin(config, 16, World(config).limits, 0))
    data = written(log)
    assert b"hunter2" not in data
    (found,) = read(data)
    assert isinstance(found.said, Origin)
    assert found.said.config.start_rules == config.start_rules
    world = World(found.said.config)
    first = list(events_since(world, now=5.0, stamp_ns=0))
    assert first == list(events_since(World(config), now=5.0, stamp_ns=0))


def test_a_command_line_of_any_bytes_is_written() -> None:
    started = Started("/a", 1, 7, 8, ("cat", "/tmp/\udcff", "\0"))
    (found,) = read(written([Decision(3, 1.0, 0.5, 2, started)]))
    assert isinstance(found.said, Started)
    assert found.said.argv == ("cat", "/tmp/\\udcff", "\\x00")


def test_wrong_bits_are_noticed_or_lead_to_something_else(monkeypatch: pytest.MonkeyPatch) -> None:
    decisions, published = lived(1, monkeypatch)
    noise, unreadable = random.Random(1), 0
    for _ in range(300):
        at = noise.randrange(len(decisions))
        data = bytearray(written([decisions[at]]))
        data[noise.randrange(len(data))] ^= 1 << noise.randrange(8)
        try:
            wrong = read(bytes(data))
        except UnreadableInputError:
            unreadable += 1
            continue
        rows = [*decisions[:at], *wrong, *decisions[at + 1 :]]
        repeated(RecordedInputs(rows, published, "", 0), None, None)
    assert unreadable > 50

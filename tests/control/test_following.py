"""Clients that follow the events of a session, and read slowly."""

from __future__ import annotations

import select
from pathlib import Path
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from play_launch.control.feed import Backlog, FeedLimits
from play_launch.control.protocol import encode
from play_launch.control.sessions import connect_to
from tests.support.replay import replaying, run
from tests.support.waiting import until

FLOOD = """
version: 1
name: chatty
nodes:
  - {{name: sleeper, command: [sleep, "1000"]}}
  - name: flood
    command:
      - bash
      - -c
      - |
        until [ -e {go} ]; do read -t 0.05 <> <(:); done
        for i in {{1..40000}}; do echo "line $i is one of many"; done
        echo flooded
        exec sleep 1000
"""


def test_what_floods_displaces_only_its_own_lines(tmp_path: Path) -> None:
    go = tmp_path / "go"
    config = tmp_path / "chatty.yaml"
    config.write_text(FLOOD.format(go=go))
    arguments = {"follow": True, "kinds": ["output", "process"]}
    with replaying(config, tmp_path / "logs", "-q"):
        until(lambda: run("wait", "--timeout", "20").returncode == 0, "the session")
        folder = str((tmp_path / "logs" / "latest").resolve())
        with connect_to(folder) as client:
            client._connection.sendall(encode({"id": 1, "op": "events", "arguments": arguments}))
            assert select.select([client], [], [], 30)[0], "it has begun to send"
            go.touch()
            until(lambda: "flooded" in run("logs", "/flood").stdout, "the flood")
            assert run("restart", "/sleeper").returncode == 0
            found: list[dict[str, Any]] = []
            missed = 0
            texts: list[str] = []
            while not missed or "flooded" not in texts or found[-1]["source"] != "/sleeper":
                for message in client.arrived():
                    missed += message.get("missed", 0)
                    found += [message["event"]] if "event" in message else []
                texts = [each["text"] for each in found]
    numbers = [each["number"] for each in found]
    assert numbers == sorted(numbers)


@given(
    st.lists(st.tuples(st.sampled_from(["", "a", "b"]), st.integers(0, 9), st.booleans())),
    st.integers(1, 5),
    st.integers(0, 20),
)
def test_a_backlog_keeps_the_order_and_its_limits(
    given: list[tuple[str, int, bool]], count: int, text: int
) -> None:
    backlog: Backlog[int] = Backlog(FeedLimits(events=count, lines=count, text=text))
    expected: dict[str, list[tuple[int, int]]] = {"": [], "a": [], "b": []}
    for number, (process, size, pops) in enumerate(given):
        held = expected[process]
        held.append((number, size))
        displaced = 0
        while len(held) > count or (process and len(held) > 1 and sum(s for _, s in held) > text):
            held.pop(0)
            displaced += 1
        assert backlog.append(number, process, size) == displaced
        if pops:
            oldest = min((each for each in expected.values() if each), key=lambda each: each[0])
            assert backlog.pop() == oldest.pop(0)[0]
        left = sorted(number for each in expected.values() for number, _ in each)
        assert list(backlog) == left
        assert bool(backlog) == bool(left)

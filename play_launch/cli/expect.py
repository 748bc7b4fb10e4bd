"""``play-launch expect``: what topics are expected to be, and what they are."""

from __future__ import annotations

import contextlib
import json
import math
import os
import socket
import subprocess
import time
from typing import TYPE_CHECKING, Annotated, Any, Final

import yaml

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.connection import connected, enter_environment_of
from play_launch.cli.output import duration, fail, note, printable, say, table

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from play_launch.supervisor.expectations import Measured

_TITLES: Final = ("TOPIC", "STATE", "RATE", "LONGEST GAP", "PUBLISHERS", "BROKEN", "DETAILS")
_STATES: Final = {None: "not known yet", True: "as expected", False: "broken"}
_OF_ROS: Final = ("/rosout", "/parameter_events")
_RATE_MARGIN: Final = 0.2
"""Part of its rate by which a learned topic may be slower."""
_GAP_MARGIN: Final = 3.0
"""How many times longer than the longest gap that was seen the next one may be."""
_LEAST: Final = 3
"""Messages without which no rate is learned."""
_END: Final = 5.0
"""Seconds in which the measuring program ends."""


def expect(
    learn: Annotated[
        float | None,
        options.time("Measure all topics for so long, and print an expect: section.", "--learn"),
    ] = None,
    session: options.Session = None,
    as_json: options.Json = False,
) -> int:
    """Compare topics with what is expected of them (expect: in the configuration).

    Exits with 1 when one of them is not as expected.
    """
    if learn is not None:
        return _learn(learn, session, as_json=as_json)
    with connected(session) as client:
        rows = client.ask("expectations")
    if as_json:
        say(json.dumps(rows))
    elif not rows:
        say("nothing is expected of topics; give expect: in the configuration")
    else:
        machines = any("machine" in row for row in rows)
        laid = [(*((row["machine"],) if machines else ()), *cells(row)) for row in rows]
        titles = ("MACHINE", *_TITLES) if machines else _TITLES
        say("\n".join(table(titles, laid, words=3 if machines else 2)))
    return ExitCode.OK if all(row["is_met"] for row in rows) else ExitCode.NODE_FAILED


def cells(row: dict[str, Any]) -> tuple[str, ...]:
    """Give a row for people: topic, state, rate, gap, publishers, breaks, what differs."""
    rate, gap = row["rate"], row["max_gap"]
    return (
        printable(row["topic"]),
        _STATES[row["is_met"]],
        "-" if rate is None else f"{rate:.3g} Hz",
        "-" if gap is None else duration(round(gap * 1e9)),
        str(row["publishers"]),
        str(row["breaks"]),
        printable(row["reason"]),
    )


def _learn(seconds: float, session: str | None, *, as_json: bool) -> int:
    with connected(session) as client:
        enter_environment_of(client)
    note(f"measuring all topics for {seconds:g} s")
    by_topic: dict[str, list[Measured]] = {}
    for each in _measure(seconds):
        if each.topic not in _OF_ROS:
            by_topic.setdefault(each.topic, []).append(each)
    # The first one of a topic is about a time of which it was not measured.
    found = {
        topic: learned(every[1:])
        for topic, every in sorted(by_topic.items())
        if every[-1].publishers and len(every) > 1
    }
    if not found:
        fail("no topic with a publisher was found", ExitCode.NODE_FAILED)
    values = {"expect": found}
    say(json.dumps(values) if as_json else yaml.safe_dump(values, sort_keys=False).rstrip())
    return ExitCode.OK


def learned(every: Sequence[Measured]) -> dict[str, Any]:
    """Give what may be expected of a topic by what was measured, with margins."""
    last = every[-1]
    values: dict[str, Any] = {"type": last.types}
    messages, seconds = sum(each.messages for each in every), sum(e.span_ns for e in every) / 1e9
    if messages >= _LEAST:
        rate = messages / seconds
        values["min_rate"] = float(f"{rate * (1 - _RATE_MARGIN):.2g}")
        gap_ns = max(each.gap_ns for each in every)
        values["max_gap"] = f"{math.ceil(_GAP_MARGIN * gap_ns / 1e6)} ms"
    values["publishers"] = last.publishers
    for key, full, empty, having in (
        ("reliability", "reliable", "best_effort", last.reliable),
        ("durability", "transient_local", "volatile", last.latched),
    ):
        if having in {0, last.publishers}:
            values[key] = full if having else empty
    return values


def _measure(seconds: float) -> Iterator[Measured]:
    """Run `topic_recorder`, which records nothing, and give what it measures of each topic."""
    from play_launch.container.environment import child_environment  # noqa: PLC0415 - slow
    from play_launch.container.ros import ros_installation, topic_recorder  # noqa: PLC0415
    from play_launch.recording.topic_recorder import link  # noqa: PLC0415
    from play_launch.supervisor.expectations import Measured  # noqa: PLC0415

    environment = child_environment(os.environ, ros_installation())
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        options = ("--socket", str(theirs.fileno()), "--exclude", "*", "--measure", "*")
        program = subprocess.Popen(
            [topic_recorder(), *options], env=environment, pass_fds=[theirs.fileno()]
        )
        theirs.close()
        end = time.monotonic() + seconds
        try:
            while (left := end - time.monotonic()) > 0:
                ours.settimeout(left)
                with contextlib.suppress(TimeoutError):
                    data = ours.recv(link.LARGEST_PACKET)
                    if not data:
                        fail("the program that measures has ended", ExitCode.NODE_FAILED)
                    packet = link.decode(data)
                    if isinstance(packet, Measured):
                        yield packet
        finally:
            ours.close()  # it ends with that
            try:
                program.wait(_END)
            except subprocess.TimeoutExpired:
                program.kill()
                program.wait()

"""What a configuration says about its recording."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.config.description import describe
from play_launch.config.load import parse_config
from play_launch.config.model import (
    DEFAULT_TOPICS,
    BeforeCrashConfig,
    KeepConfig,
    RecordConfig,
    RotateConfig,
    SamplingConfig,
)
from play_launch.config.problems import ConfigError
from play_launch.config.values import LARGEST_SIZE, parse_size

UNITS = {"B": 1, "kB": 10**3, "MB": 10**6, "GB": 10**9, "KiB": 2**10, "MiB": 2**20, "GiB": 2**30}


def recorded(section: str) -> RecordConfig:
    text = f"version: 1\nnodes: [{{command: [x]}}]\n{section}"
    return parse_config(text.encode(), Path("demo.yaml")).record


def test_without_the_section_the_defaults_hold() -> None:
    assert (
        recorded("") == recorded("record: {rotate: {}, keep: {}, sampling: {}}\n") == RecordConfig()
    )
    assert RecordConfig().keep == KeepConfig(None, None), "nothing is removed unasked"


def test_every_key() -> None:
    assert recorded(
        "record: {sync: 10 s, rotate: {size: 500 MB, duration: 24 h}, "
        "keep: {sessions: 20, size: 10 GB}, sampling: {period: 5 s}}\n"
    ) == RecordConfig(
        sync=10.0,
        rotate=RotateConfig(500_000_000, 86_400.0),
        keep=KeepConfig(20, 10_000_000_000),
        sampling=SamplingConfig(5.0),
    )


def test_never_is_a_time_and_a_size() -> None:
    record = recorded("record: {sync: never, rotate: {size: never, duration: never}}\n")
    assert (record.sync, record.rotate) == (math.inf, RotateConfig(math.inf, math.inf))
    assert recorded("record: {sampling: {period: never}}\n").sampling.period == math.inf


@pytest.mark.parametrize("section", ["", "record: {sync: never, rotate: {size: never}}\n"])
def test_it_is_described_in_json(section: str) -> None:
    text = f"version: 1\nnodes: [{{command: [x]}}]\n{section}"
    described = describe(parse_config(text.encode(), Path("demo.yaml")))
    record = json.loads(json.dumps(described, allow_nan=False))["record"]
    assert record["keep"] == {"sessions": None, "size": None}
    assert record["sync"] == ("never" if section else 1.0)


def test_topics_come_beside_the_default_ones() -> None:
    record = recorded("record: {topics: [chatter, /tf, /rosout, '*/image?'], exclude: [/tf]}\n")
    assert record.topics == (*DEFAULT_TOPICS, "/chatter", "/tf", "*/image?")
    assert record.exclude == ("/tf",)
    assert record.ros


def test_budgets_of_topics() -> None:
    record = recorded("record: {budget: 5 MB}\n")
    assert (record.budget, record.topic_budgets) == (5_000_000, ())
    section = "record: {budget: {camera/*: 80 MB, /tf: never, '*': 1 kB}}\n"
    record = recorded(section)
    budgets = (("/camera/*", 80_000_000), ("/tf", math.inf), ("*", 1000))
    assert (record.budget, record.topic_budgets) == (None, budgets)
    text = f"version: 1\nnodes: [{{command: [x]}}]\n{section}"
    described = describe(parse_config(text.encode(), Path("demo.yaml")))
    assert json.loads(json.dumps(described, allow_nan=False))["record"]["budget"] == {
        "/camera/*": 80_000_000,
        "/tf": "never",
        "*": 1000,
    }


def test_two_budgets_of_one_topic_are_refused() -> None:
    with pytest.raises(ConfigError, match="two of its topics are the same"):
        recorded("record: {budget: {tf: 1 MB, /tf: 2 MB}}\n")


def test_before_a_crash() -> None:
    record = recorded("record: {before_crash: {topics: [/a], seconds: 2 s, megabytes: 1}}\n")
    assert record.before_crash == BeforeCrashConfig(("/a",), 2.0, 1)
    assert recorded("record: {before_crash: {topics: [/a]}}\n").before_crash == (
        BeforeCrashConfig(("/a",), 10.0, 256)
    )


@pytest.mark.parametrize(
    ("written", "size"),
    [("1 GB", 10**9), ("1.5 GiB", 3 * 2**29), ("500kB", 500_000), (" 7 ", 7), (7, 7), (7.9, 7)],
)
def test_sizes(written: object, size: int) -> None:
    assert parse_size(written) == size


@pytest.mark.parametrize(
    ("written", "fragment"),
    [
        ("", "expected a size"),
        ("much", "expected a size"),
        (True, "expected a size"),
        ("1 gb", '"gb" is not a unit of size; units: B, kB, MB'),
        ("0.1 B", "larger than 0 B"),
        (-1, "larger than 0 B"),
        (math.nan, "expected a size"),
        (10**400, "the largest size"),
        ("9999999 TB", "the largest size"),
    ],
    ids=lambda value: str(value)[:20],
)
def test_refused_sizes(written: object, fragment: str) -> None:
    with pytest.raises(ValueError, match=r"size|unit|larger") as caught:
        parse_size(written)
    assert fragment in str(caught.value)


@given(st.integers(1, 1000), st.sampled_from(sorted(UNITS)), st.sampled_from(["", " "]))
def test_number_and_unit(number: int, unit: str, space: str) -> None:
    assert parse_size(f"{number}{space}{unit}") == number * UNITS[unit]


@given(st.text() | st.integers() | st.floats() | st.none() | st.booleans())
def test_anything_else_is_refused_politely(value: object) -> None:
    try:
        size = parse_size(value)
    except ValueError:
        return
    assert 0 < size <= LARGEST_SIZE

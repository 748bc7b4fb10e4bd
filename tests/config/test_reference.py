"""`docs/config.md`: every example works, every key is listed, every default is true."""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import pytest

from play_launch.config import schema, sections
from play_launch.config.load import load_config
from play_launch.config.model import (
    DEFAULT_TOPICS,
    BeforeCrashConfig,
    ContainerConfig,
    ContainerType,
    OnCrash,
    OnExit,
    ParameterType,
    RecordConfig,
    RestartLimits,
    StopLimits,
)
from play_launch.config.problems import ConfigError
from play_launch.config.section import ConfigSection
from play_launch.config.sections import DependencySection, ExpectationSection
from play_launch.config.values import (
    parse_duration,
    parse_size,
)

REFERENCE = Path(__file__).parents[2] / "docs" / "config.md"
TEXT = REFERENCE.read_text(encoding="utf-8")

# What stands around an example that is a part of a file.
SURROUNDINGS = {
    "composable node": (
        (
            "version: 1\ncontainers:\n- name: main\n  composable_nodes:\n"
            "  - package: demo\n    plugin: demo::Talker\n    name: talker\n"
        ),
        "    ",
    ),
    "isolated container": (
        "version: 1\ncontainers:\n- name: main\n  container_type: isolated\n",
        "  ",
    ),
    "process": ("version: 1\nnodes:\n- command: [x]\n", "  "),
    "nodes": ("version: 1\nnodes:\n", ""),
}
SECTIONS: dict[str, type[ConfigSection]] = {
    "Top level": schema.DocumentSection,
    "stop": sections.StopSection,
    "composable_node_loading": schema.LoadingSection,
    "cgroups": sections.CgroupsSection,
    "containers": schema.ContainerSection,
    "composable_nodes": schema.ComposableNodeSection,
    "nodes": schema.ProcessSection,
    "depends_on": DependencySection,
    "expect": ExpectationSection,
}


@dataclass(frozen=True)
class Example:
    line: int
    kind: str
    argument: str
    text: str


def examples() -> list[Example]:
    pattern = re.compile(r"(?:<!-- (\w+): ([^\n]*) -->\n)?```yaml\n(.*?)```\n", re.DOTALL)
    return [
        Example(
            TEXT.count("\n", 0, found.start()) + 1, found[1] or "whole", found[2] or "", found[3]
        )
        for found in pattern.finditer(TEXT)
    ]


def section(title: str) -> str:
    """Return the text below the heading `title`, up to the next one."""
    found = re.search(rf"^#+ {re.escape(title)}\n(.*?)(?=^#|\Z)", TEXT, re.MULTILINE | re.DOTALL)
    assert found is not None, title
    return found[1]


@pytest.mark.parametrize("example", examples(), ids=lambda example: f"line {example.line}")
def test_examples(example: Example, tmp_path: Path) -> None:
    (tmp_path / "params").mkdir()
    for file in examples():
        if file.kind == "file":
            (tmp_path / file.argument).write_text(file.text)
    config = tmp_path / "demo.yaml"
    if example.kind == "file":
        before, indentation = SURROUNDINGS["composable node"]
        config.write_text(f"{before}{indentation}parameters: [{example.argument}]\n")
    elif example.kind == "in":
        before, indentation = SURROUNDINGS[example.argument]
        config.write_text(before + textwrap.indent(example.text, indentation))
    else:
        config.write_text(example.text)
    if example.kind == "refused":
        with pytest.raises(ConfigError) as caught:
            load_config(config)
        assert example.argument in str(caught.value)
    else:
        load_config(config)


def test_no_example_is_overlooked() -> None:
    assert len(examples()) == TEXT.count("```yaml")


@pytest.mark.parametrize("title", SECTIONS)
def test_every_key_is_listed_in_its_place(title: str) -> None:
    listed = re.findall(r"^\| `(\w+)` \|", section(title), re.MULTILINE)
    assert sorted(listed) == sorted(SECTIONS[title].keys)


@pytest.mark.parametrize(
    ("title", "key", "choices"),
    [
        ("Crashes", "on_crash", OnCrash),
        ("Container types", "container_type", ContainerType),
        ("on_exit", "on_exit", OnExit),
    ],
)
def test_every_choice_is_explained(title: str, key: str, choices: type[StrEnum]) -> None:
    table = section(title).partition(f"| `{key}` |")[2].partition("\n\n")[0]
    assert re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE) == list(choices)


@pytest.mark.parametrize(
    ("title", "head", "owner"),
    [
        ("restart", "key", sections.RestartSection),
        ("restart", "key of `backoff`", sections.BackoffSection),
        ("resources", "key", sections.ResourcesSection),
        ("resources", "key of `scheduler`", sections.SchedulerSection),
        ("resources", "key of `rlimits`", sections.RlimitsSection),
        ("record", "key", sections.RecordSection),
        ("record", "key of `rotate`", sections.RotateSection),
        ("record", "key of `keep`", sections.KeepSection),
        ("record", "key of `sampling`", sections.SamplingSection),
        ("record", "key of `before_crash`", sections.BeforeCrashSection),
    ],
)
def test_every_key_of_a_table_is_listed(title: str, head: str, owner: type[ConfigSection]) -> None:
    table = section(title).partition(f"| {head} |")[2].partition("\n\n")[0]
    listed = re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)
    assert sorted(listed) == sorted(owner.keys)


def test_defaults_of_record() -> None:
    rows = re.findall(r"^\| `(\w+)` \|.*\| ([^|]+) \|$", section("record"), re.MULTILINE)
    sync, *_ = [written for key, written in rows if key == "sync"]
    size, *_ = [written for key, written in rows if key == "size"]
    duration, *_ = [written for key, written in rows if key == "duration"]
    period, *_ = [written for key, written in rows if key == "period"]
    defaults = RecordConfig()
    assert parse_duration(sync) == defaults.sync
    assert parse_size(size) == defaults.rotate.size
    assert parse_duration(duration) == defaults.rotate.duration
    assert parse_duration(period) == defaults.sampling.period
    written = dict(rows)
    before_crash = BeforeCrashConfig(())
    assert parse_duration(written["seconds"]) == before_crash.seconds
    assert int(written["megabytes"]) == before_crash.megabytes
    assert written["ros"] == "`true`"
    assert defaults.ros
    assert all(f"`{topic}`" in section("record") for topic in DEFAULT_TOPICS)


NOT_WRITTEN = {"first_at_once"}
"""Fields that no key sets: whose limits they are says it."""


@pytest.mark.parametrize(
    ("title", "defaults"), [("stop", StopLimits()), ("restart", RestartLimits())]
)
def test_defaults(title: str, defaults: StopLimits | RestartLimits) -> None:
    listed = re.findall(r"^\| `(\w+)` \|.*\| ([\d.]+ ?\w*) \|$", section(title), re.MULTILINE)
    assert {key: parse_duration(written) for key, written in listed} == {
        key: getattr(defaults, key) for key in defaults.__struct_fields__ if key not in NOT_WRITTEN
    }


@pytest.mark.parametrize("key", ["loading_timeout", "probe_timeout"])
def test_default_timeouts(key: str) -> None:
    listed = section("composable_node_loading")
    row = re.search(rf"^\| `{key}` \|.*\| ([^|]+) \|$", listed, re.MULTILINE)
    assert row is not None
    declared = ContainerConfig(name="a", namespace="/", full_name="/a")
    assert parse_duration(row[1]) == getattr(declared, key)


def test_every_type_of_parameter_is_shown(tmp_path: Path) -> None:
    (example,) = (one for one in examples() if "string_that_looks_otherwise" in one.text)
    before, indentation = SURROUNDINGS[example.argument]
    config = tmp_path / "demo.yaml"
    config.write_text(before + textwrap.indent(example.text, indentation))
    parameters = load_config(config).containers[0].composable_nodes[0].parameters
    assert {one.value.type for one in parameters} == set(ParameterType)
    by_name = {one.name: one.value.type.name.lower() for one in parameters}
    for kind in ParameterType:
        assert by_name[kind.name.lower()] == kind.name.lower()


def test_the_report_that_is_shown_is_real(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("demo.yaml").write_text(
        "version: 1\ncontainers:\n  - name: main\n    namespace: /\n    composable_nodes:\n"
        "      - package: demo\n        plugin: demo:Talker\n        name: talker\n"
        "        remaping: {}\n"
    )
    with pytest.raises(ConfigError) as caught:
        load_config(Path("demo.yaml"))
    assert f"```\n{caught.value}\n```" in section("When something is wrong")

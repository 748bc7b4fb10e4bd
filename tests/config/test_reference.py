"""`docs/config.md`: every example works; the descriptions of its keys give true defaults."""

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
    ("section", "defaults"),
    [
        (sections.StopSection, StopLimits()),
        (sections.RestartSection, RestartLimits()),
        (sections.BackoffSection, RestartLimits()),
        (sections.RotateSection, RecordConfig().rotate),
        (sections.SamplingSection, RecordConfig().sampling),
        (sections.BeforeCrashSection, BeforeCrashConfig(())),
        (schema.ContainersSection, ContainerConfig(name="a", namespace="/", full_name="/a")),
    ],
)
def test_the_defaults_that_are_described_are_those(
    section: type[ConfigSection], defaults: object
) -> None:
    described = {
        name: found[1]
        for name, key in section.keys.items()
        if (found := re.search(r"By default ([0-9.]+ ?\w*)\.$", key.description))
    }
    assert described
    for name, written in described.items():
        parse = parse_size if name == "size" else parse_duration
        assert parse(written) == getattr(defaults, name), name


def test_the_topics_that_are_always_recorded_are_named() -> None:
    assert all(
        topic in sections.RecordSection.keys["topics"].description for topic in DEFAULT_TOPICS
    )


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

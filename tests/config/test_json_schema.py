"""The JSON Schema says of every key what the program does, and no more."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from jsonschema import Draft7Validator

from play_launch.cli.init import SCHEMA_FILE, schema_text
from play_launch.config import schema, sections
from play_launch.config.load import parse_config
from play_launch.config.problems import ConfigError
from play_launch.config.schema_export import json_schema
from play_launch.config.section import ConfigSection

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = sorted((ROOT / "configs").glob("*.yaml"))
SECTIONS = {
    name: found
    for name, found in {**vars(schema), **vars(sections)}.items()
    if isinstance(found, type)
    and issubclass(found, ConfigSection)
    and found is not ConfigSection
    and not found.__subclasses__()
}
"""Those that stand somewhere, not what they are made of."""


def problems(value: Any, schema: Any) -> list[str]:
    return [error.message for error in Draft7Validator(schema).iter_errors(value)]


def test_it_is_a_json_schema_without_unknown_words() -> None:
    closed = {**Draft7Validator.META_SCHEMA, "additionalProperties": False}
    del closed["$id"]  # else its references to itself would be to the open one
    assert not problems(json_schema(), closed)


def test_the_installed_schema_is_that_of_the_program() -> None:
    assert SCHEMA_FILE.read_text(encoding="utf-8") == schema_text(), (
        "run: play-launch schema > play_launch/config/config.schema.json"
    )


@pytest.mark.parametrize(
    ("section", "key"), [(name, key) for name, section in SECTIONS.items() for key in section.keys]
)
def test_texts_are_sentences_with_examples_that_fit(section: str, key: str) -> None:
    about = SECTIONS[section].keys[key]
    assert re.fullmatch(r"[a-zA-Z].*\.", about.description), about.description
    assert about.examples
    found = json_schema()
    definition = found["definitions"].get(section.removesuffix("Section").lower(), found)
    schema = definition["properties"][key] | {"definitions": found["definitions"]}
    for example in about.examples:
        assert not problems(example, schema), example


@pytest.mark.parametrize("file", SAMPLES, ids=lambda file: file.stem)
def test_samples_name_the_schema_and_fit_it(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    first = re.match(r"# yaml-language-server: \$schema=(\S+)\n", text)
    assert first is not None
    # Not resolved, as an editor does not: one sample is a symbolic link into the package.
    assert (file.parent / first[1]).read_bytes() == SCHEMA_FILE.read_bytes()
    assert not problems(yaml.safe_load(text), json_schema())


def test_there_are_samples() -> None:
    assert len(SAMPLES) >= 6


def good(values: Any) -> bool:
    try:
        parse_config(json.dumps(values).encode(), Path("demo.yaml"))
    except ConfigError:
        return False
    return True


def container(**keys: Any) -> dict[str, Any]:
    return {"version": 1, "containers": [{"name": "c", **keys}]}


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"version": 1, "nodes": [{"command": "x"}]},
        {"version": "1", "nodes": [{"command": ["x"]}]},
        {"version": 2, "nodes": [{"command": ["x"]}]},
        {"version": 1, "nodes": [{"command": []}]},
        {"version": 1, "nodes": [{"comand": ["x"]}]},
        {"version": 1, "duration": "5 parsecs", "nodes": [{"command": ["x"]}]},
        {"version": 1, "duration": "-5 s", "nodes": [{"command": ["x"]}]},
        {
            "version": 1,
            "composable_node_loading": {"loading_timeout": 0},
            "containers": [{"name": "c"}],
        },
        {"version": 1, "record": {"budget": "5 MBit"}, "nodes": [{"command": ["x"]}]},
        {"version": 1, "record": {"sync": "rarely"}, "nodes": [{"command": ["x"]}]},
        {"version": 1, "nodes": [{"command": ["x"], "on_exit": "explode"}]},
        {"version": 1, "nodes": [{"command": ["x"], "environment": {"A": 1}}]},
        {"version": 1, "nodes": [{"command": ["x"], "remappings": [["a"]]}]},
        {"version": 1, "containers": [{}]},
        container(container_type="multi"),
        container(container_type="mt", thread_num=0),
        container(container_type="mt", thread_num="4"),
        container(attach="yes"),
        container(restart={"max_restarts": -1}),
        container(restart={"backof": {}}),
        container(composable_nodes=[{"package": "a", "plugin": "a::B", "parameters": 5}]),
    ],
)
def test_what_the_schema_refuses_the_program_refuses(values: Any) -> None:
    assert problems(values, json_schema())
    assert not good(values)


def test_what_the_program_accepts_the_schema_accepts() -> None:
    text = (Path(__file__).parent / "good" / "full.yaml").read_text("utf-8")
    # PyYAML knows none of our tags, and reads `on` as a truth value.
    full = yaml.safe_load(re.sub(r"!\w+_array ", "", text).replace(": on}", ": 'on'}"))
    assert not problems(full, json_schema())
    substituted = container(container_type="${arg:kind}", thread_num="${arg:n:-4}")
    substituted |= {"duration": "${arg:d}", "graph_daemon": "${arg:g}"}
    assert not problems(substituted, json_schema())

"""Files made to hurt: each is refused by counting, before the work is done."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from play_launch.config import compose
from play_launch.config.load import parse_config
from play_launch.config.problems import ConfigError

NODE = "version: 1\nnodes:\n- command: [x]\n  parameters: "


def refusal(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        parse_config(text.encode(), Path("demo.yaml"))
    return str(caught.value)


def aliases(depth: int, width: int) -> str:
    """Anchors that each hold the one before `width` times, `depth` lists deep."""
    text = "a0: &a0 1\n"
    for level in range(1, 60):
        inside = ", ".join([f"*a{level - 1}"] * width)
        text += f"a{level}: &a{level} {'[' * depth}{inside}{']' * depth}\n"
    return text


@pytest.mark.parametrize(
    ("text", "fragment"),
    [
        (aliases(1, 10), "aliases grow this file to more than 200000 values"),
        (aliases(60, 1), "nested deeper than 100 levels"),
        ("a: " + "[" * 500, "demo.yaml:1:103: (yaml): nested deeper than 100 levels"),
        ("a: " + "[" * 1_000_000, "nested deeper than 100 levels"),
        ("{" * 1_000_000, "nested deeper than 100 levels"),
        ("- " * 300_000, "nested deeper than 100 levels"),
        ("\n".join(" " * level + "a:" for level in range(1000)), "nested deeper than 100 levels"),
        ("- 1\n" * 1_000_000, "demo.yaml:200000:3: (yaml): more than 200000 keys and values"),
        (NODE + "{a: " + "9" * 1_000_000 + "}", "a number of 1000000 characters"),
        ("version: 1\nname: " + "a" * 1_000_000, "at most 150 bytes"),
        ("version: 1\nduration: '" + "5" * 1_000_000 + " s x'", "expected a duration"),
        (NODE + "{" + "a: {" * 90 + "b: []" + "}" * 91, "an empty list has no type"),
        ("a: &a {b: 1}\n" + "c: {<<: [" + "*a, " * 150_000 + "]}", "aliases grow this file"),
    ],
    ids=lambda value: value[:24] if isinstance(value, str) else None,
)
def test_refused(text: str, fragment: str) -> None:
    assert fragment in refusal(text)


def test_the_deepest_that_is_allowed() -> None:
    depth = compose.DEEPEST - 3  # the parameters are in a node in a list in a mapping
    text = NODE + "{a: " * depth + "1" + "}" * depth
    (parameter,) = parse_config(text.encode(), Path("demo.yaml")).nodes[0].parameters
    assert parameter.name == ".".join("a" * depth)


def test_every_line_of_a_report_is_short() -> None:
    text = "version: 1\n" + "k" * 10_000 + ": 1\nname: 'a/" + "b\\n" * 10_000 + "'\n"
    assert all(len(line) < 400 for line in refusal(text).splitlines())


def test_the_parser_in_python_gives_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compose, "_Loader", yaml.SafeLoader)
    text = NODE + '{a: [1, 2], b: "\\u00e9", c: {d: .inf}}\n'
    by_python = parse_config(text.encode(), Path("demo.yaml"))
    monkeypatch.setattr(compose, "_Loader", yaml.CSafeLoader)
    assert by_python == parse_config(text.encode(), Path("demo.yaml"))
    monkeypatch.setattr(compose, "_Loader", yaml.SafeLoader)
    assert "nested deeper than 100 levels" in refusal("a: " + "[" * 10_000)
    assert "half of a surrogate pair" in refusal('version: 1\nname: "\\ud800"\n')


def test_what_pyyaml_composes_differently() -> None:
    text = "version: 1\nnodes:\n- command: [&a x]\n- command: [&a y, *a]\n"
    assert parse_config(text.encode(), Path("demo.yaml")).nodes[1].command == ("y", "y")
    both = refusal("version: 1\nversion: 1\nname: [\n").splitlines()
    assert [line.split(": ")[0] for line in both] == ["demo.yaml:2:1", "demo.yaml:4:1"]

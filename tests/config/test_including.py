"""Files that include others: the result, and where mistakes are reported."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.config.compose import MOST_VALUES
from play_launch.config.description import describe
from play_launch.config.includes import DEEPEST_INCLUSION
from play_launch.config.load import load_config, parse_config
from play_launch.config.problems import ConfigError, Location
from play_launch.config.source import Refused
from play_launch.config.substitutions import Inputs

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.config.model import ReplayConfig

BASE = """version: 1
name: base
duration: 10 s
environment: {A: a, B: b}
stop: {ask: 5 s, sigint: 4 s}
containers:
  - name: main
    container_type: mt
    thread_num: 3
    restart: {max_restarts: 2, within: 9 s}
    composable_nodes:
      - {package: demo, plugin: "demo::A", name: a, parameters: {x: 1, y: {z: 2}}}
      - {package: demo, plugin: "demo::B", name: b, remappings: {p: q}}
      - {package: demo, plugin: "demo::C"}
  - {name: main, namespace: /other}
nodes:
  - {name: job, command: [job, fast], arguments_: 0}
""".replace(", arguments_: 0", "")


def read(files: Mapping[str, str], **arguments: str) -> ReplayConfig:
    """Read `main.yaml`; the files are in a folder `f`."""

    def read_file(path: Path) -> bytes | Refused:
        text = files.get(os.path.relpath(path, "f"))
        return Refused(Location(str(path), 1, 1), "no such file") if text is None else text.encode()

    inputs = Inputs(arguments=arguments, environ={})
    main = Path("f/main.yaml")
    return parse_config(files["main.yaml"].encode(), main, read_file, inputs)


def over(text: str, base: str = BASE, **arguments: str) -> ReplayConfig:
    return read(
        {"main.yaml": f"version: 1\ninclude: base.yaml\n{text}", "base.yaml": base}, **arguments
    )


def refused(files: Mapping[str, str], **arguments: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        read(files, **arguments)
    return [str(problem) for problem in caught.value.problems]


def refused_over(text: str, base: str = BASE) -> list[str]:
    return refused({"main.yaml": f"version: 1\ninclude: base.yaml\n{text}", "base.yaml": base})


def resolved(config: ReplayConfig) -> object:
    """Return what the configuration means, without places and sources."""
    text = json.dumps(describe(config))
    values = json.loads(re.sub(r'"(line|file)": ("[^"]*"|\d+)', r'"\1": 0', text))
    for key in ("source", "included_files", "taken"):
        del values[key]
    return values


def test_including_alone_changes_nothing() -> None:
    alone = read({"main.yaml": BASE})
    config = over("")
    assert resolved(config) == resolved(alone)
    assert [str(file.path) for file in config.included_files] == ["f/base.yaml"]
    assert config.included_files[0].text == BASE.encode()
    assert (config.containers[0].file, config.containers[0].line) == ("f/base.yaml", 7)


def test_what_the_including_file_says_goes_over_it() -> None:
    config = over(
        "duration: 20 s\nenvironment: {B: other, C: c}\nstop: {sigint: 1 s}\n"
        "nodes:\n- {name: job, command: [job, slow]}\n- {command: [more]}\n"
    )
    assert (config.name, config.duration) == ("base", 20.0)
    assert config.environment == {"A": "a", "B": "other", "C": "c"}
    assert (config.stop.ask, config.stop.sigint, config.stop.sigterm) == (5.0, 1.0, 2.0)
    assert [node.command for node in config.nodes] == [("job", "slow"), ("more",)]


def test_entries_are_merged_by_name() -> None:
    config = over(
        "containers:\n- name: main\n  namespace: /\n  thread_num: 5\n"
        "  restart: {within: 1 s}\n  composable_nodes:\n"
        "  - {name: b, package: other, remappings: {p: r, s: t}}\n"
        '  - {package: demo, plugin: "demo::C"}\n'
        '  - {package: demo, plugin: "demo::D", name: d}\n- name: new\n'
    )
    main, other, new = config.containers
    assert (main.full_name, other.full_name, new.full_name) == ("/main", "/other/main", "/new")
    assert (main.thread_num, main.restart.max_restarts, main.restart.within) == (5, 2, 1.0)
    assert [(node.name, node.package) for node in main.composable_nodes] == [
        ("a", "demo"),
        ("b", "other"),
        ("", "demo"),
        ("", "demo"),
        ("d", "demo"),
    ]
    assert main.composable_nodes[1].remappings == (("p", "r"), ("s", "t"))
    assert main.composable_nodes[1].plugin == "demo::B"


def test_parameters_become_further_sources() -> None:
    config = over(
        "containers:\n- name: main\n  namespace: /\n  composable_nodes:\n"
        "  - {name: a, parameters: {x: 5, y.z: 6, new: 7}}\n"
        "  - {name: b, parameters: [{x: 1}]}\n"
    )
    a, b, _ = config.containers[0].composable_nodes
    assert {each.name: each.value.value for each in a.parameters} == {"x": 5, "y.z": 6, "new": 7}
    assert {each.name: each.value.value for each in b.parameters} == {"x": 1}


def test_later_files_go_over_earlier_ones() -> None:
    files = {
        "main.yaml": "version: 1\ninclude: [a.yaml, {file: sub/b.yaml}]\n",
        "a.yaml": "version: 1\nname: a\nduration: 1 s\nnodes: [{name: n, command: [a]}]\n",
        "sub/b.yaml": "version: 1\nname: b\ninclude: ../c.yaml\nnodes: [{name: n, command: [b]}]\n",
        "c.yaml": "version: 1\nname: c\nlog_dir: logs\nstop: {ask: 9 s}\n",
    }
    config = read(files)
    assert (config.name, config.duration, config.stop.ask) == ("b", 1.0, 9.0)
    assert [node.command for node in config.nodes] == [("b",)]
    assert os.path.normpath(str(config.log_dir)) == "f/logs"


def test_paths_start_at_the_file_in_which_they_stand() -> None:
    parameters = "/**: {ros__parameters: {%s: 1}}\n"
    files = {
        "main.yaml": "version: 1\ninclude: sub/b.yaml\nnodes: [{name: n, parameters: [p.yaml]}]\n",
        "sub/b.yaml": "version: 1\nlog_dir: logs\nnodes: [{name: n, command: [b], "
        "parameters: [p.yaml]}]\n",
        "p.yaml": parameters % "outer",
        "sub/p.yaml": parameters % "inner",
    }
    config = read(files)
    assert [each.name for each in config.nodes[0].parameters] == ["inner", "outer"]
    assert [str(file.path) for file in config.parameter_files] == ["f/sub/p.yaml", "f/p.yaml"]
    assert str(config.log_dir) == "f/sub/logs"


def test_one_file_twice_with_arguments() -> None:
    files = {
        "main.yaml": "version: 1\ninclude:\n- {file: c.yaml, arguments: {side: left}}\n"
        "- {file: c.yaml, arguments: {side: right, rate: 2}}\n",
        "c.yaml": "version: 1\ninclude: d.yaml\nnodes:\n- name: ${arg:side}\n"
        "  command: [x, '${arg:rate:-1}', '${arg:name}']\n",
        "d.yaml": "version: 1\nnodes: [{name: 'd_${arg:side}', command: [d]}]\n",
    }
    config = read(files, name="me")
    assert [(node.name, node.command) for node in config.nodes] == [
        ("d_left", ("d",)),
        ("left", ("x", "1", "me")),
        ("d_right", ("d",)),
        ("right", ("x", "2", "me")),
    ]
    assert len(config.included_files) == 2


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (
            "containers: [{name: main, thread_num: 1}]",
            'containers[0]: 2 included containers are called "main"; give the namespace',
        ),
        ("nodes: [{name: job}, {name: job}]", "nodes[1]: nothing to run"),
    ],
)
def test_what_cannot_be_merged(text: str, problem: str) -> None:
    found = refused_over(f"{text}\n")
    assert any(f": {problem}" in each for each in found), found


def test_two_entries_that_mean_the_same_are_two() -> None:
    found = refused_over("nodes: [{name: job}, {name: job, command: [x]}]\n")
    assert any("the name /job is given twice" in each for each in found)


def test_mistakes_are_reported_where_they_stand_with_the_chain() -> None:
    files = {
        "main.yaml": "version: 1\ninclude: [sub/b.yaml]\n",
        "sub/b.yaml": "version: 1\ninclude:\n- file: c.yaml\n",
        "sub/c.yaml": "version: 1\ncontainers:\n- name: box\n  container_type: mt\n"
        "  composable_nodes:\n"
        '  - {package: demo, plugin: "demo:T", name: t}\n  thread_num: ${arg:n}\n',
    }
    chain = "(included from f/sub/b.yaml:3:9, from f/main.yaml:2:11)"
    plugin, argument = refused(files)
    assert plugin == (
        "f/sub/c.yaml:6:29: containers[0].composable_nodes[0].plugin: "
        f'"demo:T" is not a C++ class such as demo::Talker {chain}'
    )
    assert argument == (
        "f/sub/c.yaml:7:15: containers[0].thread_num: the argument n is not given; append "
        f"n:=value to the command, or write a default: ${{arg:n:-default}} {chain}"
    )
    with pytest.raises(ConfigError) as caught:
        read(files)
    assert caught.value.problems[0].included_from == ("f/sub/b.yaml:3:9", "f/main.yaml:2:11")


@pytest.mark.parametrize(
    ("included", "problem"),
    [
        (None, "f/main.yaml:2:10: include: the included file f/base.yaml: no such file"),
        ("", "f/base.yaml:1:1: (file): holds no configuration"),
        ("# nothing\n", "f/base.yaml:1:1: (file): holds no configuration"),
        ("nodes: [\n", "f/base.yaml:2:1: (yaml): "),
        ("[1]\n", "f/base.yaml:1:1: (top level): expected a configuration"),
        ("name: x\n", 'f/base.yaml:1:1: (top level): the key "version" is missing'),
        ("version: 2\n", "f/base.yaml:1:10: version: expected version 1"),
        (
            "version: 1\ninclude: base.yaml\n",
            "f/base.yaml:2:10: include: f/base.yaml includes itself",
        ),
        (
            "version: 1\ninclude: main.yaml\n",
            "f/base.yaml:2:10: include: f/main.yaml includes itself",
        ),
        (
            "version: 1\ninclude: ./x/../main.yaml\n",
            "f/base.yaml:2:10: include: f/x/../main.yaml includes",
        ),
        ("version: 1\nversion: 1\n", "f/base.yaml:2:1: version: the key"),
        ("%YAML 1.2\n%A\n---\nversion: 1\n", "f/base.yaml:2:3: (yaml): found unknown directive"),
        ("\x00", "f/base.yaml:1:1: (file): a NUL byte"),
    ],
)
def test_what_cannot_be_included(included: str | None, problem: str) -> None:
    files = {"main.yaml": "version: 1\ninclude: base.yaml\nnodes: [{command: [x]}]\n"}
    if included is not None:
        files["base.yaml"] = included
    found = refused(files)
    assert any(each.startswith(problem) for each in found), found
    assert included is None or any("(included from f/main.yaml:2:10" in each for each in found)


@pytest.mark.parametrize(
    ("include", "problem"),
    [
        ("5", "include: expected the path of a file"),
        ("[5]", "include[0]: expected the path of a file"),
        ("{arguments: {}}", "include: expected the path of a file"),
        ("[{file: base.yaml, args: {}}]", 'include[0].args: unknown key "args"; known here: file'),
        ("{file: base.yaml, arguments: [x]}", "include.arguments: expected a mapping of arguments"),
        ("{file: base.yaml, arguments: {x: [1]}}", "include.arguments.x: expected a value"),
        (
            "{file: base.yaml, arguments: {x: 1}}",
            "include.arguments.x: nothing reads the argument x",
        ),
        ("robot.launch.py", "include: f/robot.launch.py is a launch file"),
    ],
)
def test_what_an_inclusion_is(include: str, problem: str) -> None:
    files = {"main.yaml": f"version: 1\ninclude: {include}\n", "base.yaml": BASE}
    found = refused(files)
    assert any(f": {problem}" in each for each in found), found


def test_depth_is_bounded() -> None:
    def name(number: int) -> str:
        return f"{number}.yaml" if number else "main.yaml"

    once = "version: 1\ninclude: %s\nnodes: [{command: [x]}]\n"
    found = refused({name(each): once % name(each + 1) for each in range(60)})
    assert f"deeper than {DEEPEST_INCLUSION} levels" in found[0]


def test_values_of_all_files_are_counted_together() -> None:
    half = "[" + "1, " * (MOST_VALUES // 2) + "1]"
    base = f"version: 1\nnodes: [{{command: [x], parameters: {{a: {half}}}}}]\n"
    files = {"main.yaml": "version: 1\ninclude: [a.yaml, b.yaml]\n", "a.yaml": base, "b.yaml": base}
    (problem,) = refused(files)
    assert problem.startswith("f/b.yaml:2:")
    assert f"more than {MOST_VALUES} keys and values" in problem


KEYS = st.sampled_from(["A", "B", "C"])
SETTINGS = st.dictionaries(KEYS, st.sampled_from("xyz"), max_size=3)
NAMES = st.sampled_from(["a", "b", "c"])
CONTAINERS = st.dictionaries(NAMES, SETTINGS, max_size=3).map(
    lambda found: [{"name": name, "environment": each} for name, each in found.items()]
)
SYSTEMS: st.SearchStrategy[dict[str, Any]] = st.fixed_dictionaries(
    {"environment": SETTINGS, "containers": CONTAINERS}
) | st.fixed_dictionaries({"environment": SETTINGS, "duration": st.integers(1, 9)})


def file(system: dict[str, Any]) -> str:
    return json.dumps({"version": 1, "nodes": [{"name": "n", "command": ["x"]}], **system})


def including(name: str, system: dict[str, Any]) -> str:
    return json.dumps({"version": 1, "include": name, **system})


@given(SYSTEMS, SYSTEMS)
def test_merging_is_an_update(base: dict[str, Any], over: dict[str, Any]) -> None:
    config = read({"main.yaml": including("b", over), "b": file(base)})
    assert config.environment == {**base["environment"], **over["environment"]}
    names = [each["name"] for system in (base, over) for each in system.get("containers", ())]
    assert [each.name for each in config.containers] == list(dict.fromkeys(names))


@given(SYSTEMS, SYSTEMS, SYSTEMS)
def test_merging_is_associative(
    one: dict[str, Any], two: dict[str, Any], three: dict[str, Any]
) -> None:
    chain = {"main.yaml": including("b", three), "b": including("c", two), "c": file(one)}
    flat = {
        "main.yaml": json.dumps({"version": 1, "include": ["c", "b"], **three}),
        "b": json.dumps({"version": 1, **two}),
        "c": file(one),
    }
    assert resolved(read(chain)) == resolved(read(flat))


@given(SYSTEMS)
def test_a_file_over_itself_is_itself(system: dict[str, Any]) -> None:
    twice = {"main.yaml": including("b", system), "b": file(system)}
    assert resolved(read(twice)) == resolved(read({"main.yaml": file(system)}))


PAGE = (
    (Path(__file__).parents[2] / "docs" / "files.md")
    .read_text("utf-8")
    .partition("## In editors")[0]
)
EXAMPLES = dict(re.findall(r"<!-- file: (\S+) -->\n```yaml\n(.*?)```\n", PAGE, re.DOTALL))


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_of_the_page(name: str, tmp_path: Path) -> None:
    assert len(EXAMPLES) == PAGE.count("```yaml")
    for each, text in EXAMPLES.items():
        (tmp_path / each).write_text(text, encoding="utf-8")
    config = load_config(tmp_path / name)
    match name:
        case "simulation.yaml":
            sensing, simulator = config.containers
            talker, _ = sensing.composable_nodes
            assert {each.name: each.value.value for each in talker.parameters} == {
                "rate": 1.0,
                "use_sim_time": True,
            }
            assert simulator.name == "simulator"
        case "both.yaml":
            assert [each.name for each in config.containers] == ["camera_left", "camera_right"]


def test_numbers_of_the_page() -> None:
    assert f"{DEEPEST_INCLUSION} levels of inclusion" in PAGE

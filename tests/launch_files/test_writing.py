"""What is written is read back by our own reader as what the records say."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from play_launch.config.dependency import Condition, OnTimeout
from play_launch.config.model import (
    Autostart,
    OnExit,
    ParameterConfig,
    ParameterType,
    ParameterValue,
)
from play_launch.launch_files.configuration.request import Containers, Options
from play_launch.launch_files.configuration.write import Written, written
from play_launch.launch_files.records import (
    Composable,
    Description,
    Event,
    LaunchedProcess,
    ParameterFile,
    Place,
    ProgramKind,
    Source,
    StartCondition,
    TemporaryFile,
    Unit,
    Values,
)
from tests.launch_files.values import TEXTS, VALUES, shown
from tests.launch_files.writing import evaluated, load, lost, node, params, write

NAMES = st.from_regex(r"[a-z][a-z0-9]{0,6}", fullmatch=True)
TOPICS = st.from_regex(r"[/~]?[a-z]{1,5}(/[a-z]{1,4})?", fullmatch=True).map(
    lambda text: text.replace("~", "~/")
)
NAMESPACES = st.sampled_from(["", "/", "/a", "/a/b"])
# No value of an environment holds a NUL, no argument is empty of meaning.
COMMON = {
    "name": NAMES,
    "namespace": NAMESPACES,
    "parameters": st.dictionaries(NAMES, VALUES, max_size=4).map(
        lambda found: [ParameterConfig(*pair) for pair in found.items()]
    ),
    "remappings": st.lists(st.tuples(TOPICS, TOPICS), max_size=3),
    "origin": st.builds(Place, st.just("/a b/x.launch.xml"), st.integers(0, 99)),
}
PROCESSES = st.builds(
    LaunchedProcess,
    package=st.just("p"),
    executable=NAMES,
    arguments=st.lists(TEXTS, max_size=3),
    environment=st.dictionaries(
        st.from_regex(r"[A-Z]{1,3}", fullmatch=True), TEXTS, max_size=3
    ).map(lambda found: list(found.items())),
    prefix=st.lists(NAMES, max_size=2),
    respawn=st.booleans(),
    respawn_delay=st.none() | st.integers(1, 50).map(float),
    respawn_max_retries=st.integers(-1, 3),
    ends_all=st.booleans(),
    emulate_tty=st.booleans(),
    **COMMON,
)
COMPOSABLES = st.builds(
    Composable, package=st.just("p"), plugin=st.just("p::C"), container=st.just("/c"), **COMMON
)


def firsts(pairs: list[tuple[str, str]]) -> dict[str, str]:
    found: dict[str, str] = {}
    for source, target in pairs:
        found.setdefault(source, target)
    return found


@settings(max_examples=50, deadline=None)
@given(st.lists(PROCESSES | COMPOSABLES, max_size=6))
def test_what_is_written_is_read_back(
    tmp_path_factory: pytest.TempPathFactory, units: list[Unit]
) -> None:
    unique = list({unit.full_name: unit for unit in units}.values())
    host = LaunchedProcess(kind=ProgramKind.CONTAINER, package="rclcpp_components", name="c0")
    host.executable, host.name = "component_container", "c"
    unique = [unit for unit in unique if unit.full_name != "/c"]
    made = write(host, *unique)
    assert not made.problems
    assert lost(made) == []
    config = load(made, tmp_path_factory.getbasetemp())
    (container,) = config.containers
    read: dict[str, Any] = {each.full_name: each for each in config.nodes}
    read |= {each.key.name: each for each in container.composable_nodes}
    assert read.keys() == {unit.full_name or "" for unit in unique}
    for unit in unique:
        found = read[unit.full_name]
        assert {each.name: shown(each.value) for each in found.parameters} == {
            each.name: shown(each.value) for each in unit.parameters
        }
        assert dict(found.remappings) == firsts(unit.remappings)
        if isinstance(unit, Composable):
            assert (found.package, found.plugin) == ("p", "p::C")
            continue
        assert (found.package, found.executable) == ("p", unit.executable)
        assert found.arguments == tuple(unit.arguments)
        assert dict(found.environment) == dict(unit.environment)
        assert found.prefix == tuple(unit.prefix)
        assert found.emulate_tty == unit.emulate_tty
        if unit.ends_all:
            assert found.on_exit is OnExit.SHUTDOWN
            continue
        assert found.on_exit is (OnExit.RESTART if unit.respawn else OnExit.IGNORE)
        if unit.respawn and unit.respawn_delay:
            assert found.restart.initial == unit.respawn_delay
        if unit.respawn and unit.respawn_max_retries >= 0:
            assert found.restart.max_restarts == unit.respawn_max_retries


def test_a_file_is_referenced_and_what_differs_is_written(tmp_path: Path) -> None:
    file = params(tmp_path / "p.yaml", "/**: {ros__parameters: {rate: 1, b: 2.0, c: x}}")
    values = Values(rate(5), "/a/n")
    unit = evaluated(node(sources=[file, values]))
    made = write(unit, folder=tmp_path)
    assert "p.yaml, {rate: 5}" in made.text.replace("\n      - ", ", ")
    config = load(made, tmp_path)
    assert {each.name: each.value.value for each in config.nodes[0].parameters} == {
        "rate": 5,
        "b": 2.0,
        "c": "x",
    }
    assert "p.yaml" not in write(unit, folder=tmp_path, inline=True).text


def rate(value: int, name: str = "rate") -> tuple[ParameterConfig]:
    return (ParameterConfig(name, ParameterValue(ParameterType.INTEGER, value)),)


@pytest.mark.parametrize(
    "text",
    [
        # Our reader refuses it, or reads something else than rcl.
        "/**: {ros__parameters: {rate: yes}}",
        "/**: {ros__parameters: {rate: 010}}",
        "/**: {ros__parameters: {rate: 0o17}}",
        "/**: {ros__parameters: {rate: 0x10, b: [y, n]}}",
    ],
)
def test_a_file_that_we_would_read_otherwise_is_copied(text: str, tmp_path: Path) -> None:
    unit = evaluated(node(sources=[params(tmp_path / "p.yaml", text)]))
    made = write(unit, folder=tmp_path)
    (config,) = load(made, tmp_path).nodes
    assert {each.name: shown(each.value) for each in config.parameters} == {
        each.name: shown(each.value) for each in unit.parameters
    }


def test_a_value_that_loses_to_an_earlier_file_stays_lost(tmp_path: Path) -> None:
    # rcl keeps sections in the order of their first mention: the file's section for all came
    # second, and holds against the first and the third source.
    file = params(tmp_path / "p.yaml", "/**: {ros__parameters: {a: 2}}")
    one, three = (Values(rate(each, "a"), "/a/n") for each in (1, 3))
    unit = evaluated(node(sources=[one, file, three]))
    (config,) = load(write(unit, folder=tmp_path), tmp_path).nodes
    assert [each.value.value for each in config.parameters] == [2]


def test_what_starts_later(tmp_path: Path) -> None:
    units: list[Unit] = [
        LaunchedProcess(id="1", package="p", executable="spawner"),
        LaunchedProcess(id="2", package="p", executable="spawner"),
        node(
            id="3",
            name="later",
            start=[
                StartCondition(event=Event.EXITED, unit="2"),
                StartCondition(event=Event.DELAY, seconds=1.5),
                StartCondition(event=Event.DELAY, seconds=1.0),
            ],
        ),
        node(id="4", name="managed", is_lifecycle=True, autostart=Autostart.ACTIVATE),
        node(
            id="5", name="n5", start=[StartCondition(event=Event.STATE, unit="4", state="active")]
        ),
        node(id="6", name="n6", start=[StartCondition(event=Event.STATE, unit="4", state="x")]),
    ]
    made = write(*units)
    assert [each.rpartition(": ")[2] for each in lost(made)] == [
        "state x of /a/managed cannot be said"
    ]
    rules = load(made, tmp_path).start_rules
    (exited,) = rules["/a/later"].dependencies
    assert (exited.condition, exited.unit) == (Condition.EXITED, "/[spawner:2]")
    assert exited.on_timeout is OnTimeout.START
    assert rules["/a/later"].delay == 2.5
    assert rules["/a/n5"].dependencies[0].condition is Condition.ACTIVE


def test_containers_can_be_switched(tmp_path: Path) -> None:
    def container(number: int, program: tuple[str, str]) -> LaunchedProcess:
        return LaunchedProcess(
            kind=ProgramKind.CONTAINER,
            package=program[0],
            executable=program[1],
            name=f"c{number}",
            remappings=[("a", "b")],
            parameters=[
                ParameterConfig("use_sim_time", ParameterValue(ParameterType.BOOL, value=True))
            ],
        )

    programs = (
        ("rclcpp_components", "component_container"),
        ("play_launch_container", "component_container"),
        ("rclcpp_components", "component_container_mt"),
    )
    units = [container(*pair) for pair in enumerate(programs)]
    found = {}
    for choice in Containers:
        config = load(write(*units, containers=choice), tmp_path)
        found[choice] = [each.container_type.value for each in config.containers]
        for each in config.containers:
            assert each.ros_arguments == ("-r", "a:=b")
            (section,) = each.process_parameters
            assert section.pattern == each.full_name
            assert [one.name for one in section.parameters] == ["use_sim_time"]
    assert found == {
        Containers.SAME: ["standard", "standard", "mt"],
        Containers.ISOLATED: ["isolated", "isolated", "isolated_mt"],
        Containers.STOCK: ["stock"] * 3,
    }


def test_arguments_of_a_container_for_ros(tmp_path: Path) -> None:
    unit = node(
        package="rclcpp_components",
        executable="component_container_isolated",
        kind=ProgramKind.CONTAINER,
        arguments=["--ros-args", "--log-level", "info", "-r", "__ns:=/x", "--", "--fast"],
        remappings=[("a", "b")],
    )
    made = write(unit)
    (container,) = load(made, tmp_path).containers
    assert container.ros_arguments == ("--log-level", "info", "-r", "a:=b")
    name, arguments = lost(made)
    assert "['--fast']" in name + arguments
    assert "__ns:=/x: a name that its arguments give" in name + arguments


def test_what_all_have_in_common_is_written_once(tmp_path: Path) -> None:
    both = [("A", "1"), ("B", "$(x)")]
    made = write(
        node(name="one", environment=both), node(name="two", environment=[*both, ("C", "")])
    )
    assert len(re.findall("A:", made.text)) == 1
    config = load(made, tmp_path)
    assert [dict(each.environment) for each in config.nodes] == [
        {"A": "1", "B": "$(x)"},
        {"A": "1", "B": "$(x)", "C": ""},
    ]


def test_a_plain_node_that_hosts_components_is_a_container(tmp_path: Path) -> None:
    host = node(
        name="nav2_container", package="rclcpp_components", executable="component_container_mt"
    )
    made = write(host, Composable(package="p", plugin="p::C", container="/a/nav2_container"))
    (container,) = load(made, tmp_path).containers
    assert len(container.composable_nodes) == 1


def test_parameters_for_others_are_named_by_their_file(tmp_path: Path) -> None:
    text = """
/a/n: {ros__parameters: {a: 1}}
/costmap/costmap: {ros__parameters: {width: 3, height: 2}}
"""
    file = params(tmp_path / "p.yaml", text)
    unit = evaluated(node(sources=[file, Values(rate(5), "/a/n")]))
    made = write(unit, folder=tmp_path)
    assert made.text.count("p.yaml") == 2
    assert not lost(made)
    (config,) = load(made, tmp_path).nodes
    assert {each.name: each.value.value for each in config.parameters} == {"a": 1, "rate": 5}
    assert [each.pattern for each in config.process_parameters] == ["/a/n", "/costmap/costmap"]
    everywhere = Values(rate(5), "/**")
    unit = evaluated(node(sources=[everywhere, file]))
    made = write(unit, folder=tmp_path)
    assert made.text.count("p.yaml") == 2
    (config,) = load(made, tmp_path).nodes
    assert [each.pattern for each in config.process_parameters] == [
        "/**",
        "/a/n",
        "/costmap/costmap",
    ]
    unit = evaluated(node(sources=[file]))
    inline = load(write(unit, folder=tmp_path, inline=True), tmp_path).nodes[0]
    assert [each.pattern for each in inline.process_parameters] == ["/costmap/costmap"]


def place(made: Written) -> None:
    for path, content in made.files.items():
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)


def test_temporary_files_and_long_texts_stand_beside(tmp_path: Path) -> None:
    text = "/**: {ros__parameters: {rate: 1, b: 2.0}}"
    robot = ParameterConfig(
        "robot_description", ParameterValue(ParameterType.STRING, "<robot>\n" * 500)
    )
    model = TemporaryFile("/tmp/x/urdf_a1b2c3d4.urdf", b"\xff<robot/>")
    sources: list[Source] = [ParameterFile("/tmp/x/tmpq1w2e3r4", text), Values((robot,))]
    units = [
        evaluated(node(name="one", sources=list(sources))),
        evaluated(node(name="two", sources=list(sources), arguments=[f"-file={model.path}", "x"])),
    ]
    description = Description(units=list(units), temporary=[model])
    options = Options(folder=tmp_path, files=tmp_path / "robot.files")
    made = written(description, options, "From x.")
    assert not lost(made)
    assert not made.problems
    # Both nodes get the same.
    assert sorted(each.name for each in made.files) == ["one.yaml", "one_2.yaml", "urdf.urdf"]
    place(made)
    first, second = load(made, tmp_path).nodes
    assert len(made.text) < 1000
    for each in (first, second):
        assert {one.name: one.value.value for one in each.parameters} == {
            "rate": 1,
            "b": 2.0,
            "robot_description": "<robot>\n" * 500,
        }
    copy = Path(second.arguments[0].removeprefix("-file="))
    assert copy.read_bytes() == model.content
    # Where no files are to be, values are written, and the rest is reported.
    inline = written(description, Options(folder=tmp_path), "From x.")
    assert not inline.files
    assert "it names a temporary file" in lost(inline)[0]
    assert load(inline, tmp_path).nodes[0].parameters


def test_the_end_and_the_folder_of_a_container(tmp_path: Path) -> None:
    unit = node(
        package="rclcpp_components",
        executable="component_container",
        kind=ProgramKind.CONTAINER,
        ends_all=True,
        cwd="/tmp",
        arguments=[""],
    )
    made = write(unit)
    assert not lost(made)
    (container,) = load(made, tmp_path).containers
    assert (container.on_exit, container.cwd) == (OnExit.SHUTDOWN, Path("/tmp"))


def test_origins_are_comments(tmp_path: Path) -> None:
    share = tmp_path / "x" / "y.launch.xml"
    unit = node(name="x", origin=Place(str(share), 7))
    text = write(unit, folder=tmp_path).text
    assert "  # from x/y.launch.xml:7\n  - name: x\n" in text


def test_shell_lines_unset_variables_and_labels(tmp_path: Path) -> None:
    made = write(
        LaunchedProcess(
            kind=ProgramKind.PROCESS, command=["echo $HOME | cat"], shell=True, label="my cat-1"
        ),
        LaunchedProcess(kind=ProgramKind.PROCESS, command=["env"], unset=["A"], prefix=["nice"]),
    )
    first, second = load(made, tmp_path).nodes
    assert first.command == ("/bin/sh", "-c", "echo $HOME | cat")
    assert first.name == "my_cat_1"
    assert second.prefix == ("env", "-u", "A", "nice")


def test_a_debugger_before_a_node_stays_where_a_shell_starts_it(tmp_path: Path) -> None:
    box = {"package": "rclcpp_components", "executable": "component_container", "name": "box"}
    prefix = ["gdb", "-ex", "run", "--args"]
    for arguments, reported in (([], False), (["$HOME"], True)):
        made = write(
            node(shell=True, prefix=[*prefix, *arguments]),
            node(shell=True, prefix=prefix, arguments=arguments, name="o"),
            node(kind=ProgramKind.CONTAINER, shell=True, prefix=[*prefix, *arguments], **box),
        )
        config = load(made, tmp_path)
        prefixes = [each.prefix for each in config.nodes]
        prefixes += [each.prefix for each in config.containers]
        assert [each[:4] for each in prefixes] == [tuple(prefix)] * 3
        assert sorted(lost(made)) == [
            f"{name}: shell: its words are given to the program as they are: $HOME"
            for name in ("/a/box", "/a/n", "/a/o")[: 3 * reported]
        ]


def test_how_often_a_container_comes_back(tmp_path: Path) -> None:
    box = {"package": "rclcpp_components", "executable": "component_container"}
    made = write(
        *(
            node(kind=ProgramKind.CONTAINER, name=name, respawn_max_retries=3, **more, **box)
            for name, more in (("a", {"respawn": True, "respawn_delay": 2.0}), ("b", {}))
        )
    )
    often, always = (each.restart for each in load(made, tmp_path).containers)
    assert (often.max_restarts, often.initial, often.within) == (3, 2.0, 8760 * 3600.0)
    assert always.max_restarts != 3


def test_time_outs_for_stopping_hold_for_all(tmp_path: Path) -> None:
    made = write(
        node(name="one", sigterm_timeout=7.0, sigkill_timeout=3.5),
        node(name="two", sigterm_timeout=9.0),
        node(name="three"),
    )
    stop = load(made, tmp_path).stop
    # launch gives the others 5 s.
    assert (stop.sigint, stop.sigterm) == (9.0, 5.0)
    notes = [each for each in made.losses if each.is_note]
    assert all("/a/one" in note.where for note in notes)
    assert [note.what.partition(";")[0] for note in notes] == [
        "its sigterm_timeout of 7 s",
        "its sigkill_timeout of 3.5 s",
    ]
    made = write(node(name="one", sigterm_timeout=7.0, sigkill_timeout=3.5))
    stop = load(made, tmp_path).stop
    assert (stop.sigint, stop.sigterm) == (7.0, 3.5)

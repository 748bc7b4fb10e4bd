"""The own evaluator gives what ROS gives, and says where a launch file is wrong."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from play_launch.config.model import ParameterType
from play_launch.launch_files.markup.evaluate import evaluate
from play_launch.launch_files.records import (
    AtExit,
    Composable,
    Description,
    Event,
    LaunchFileError,
    Process,
)
from play_launch.launch_files.ros_launch import evaluate as ros_launch
from tests.launch_files.markup.traps import MISTAKES, TRAPS
from tests.launch_files.ros_launch.prefix import LIMIT, Prefix, needs_launch, prefix

__all__ = ["prefix"]


def write(folder: Path, name: str) -> Path:
    for file, text in TRAPS[name].items():
        path = folder / file
        path.parent.mkdir(exist_ok=True)
        path.write_text(text.lstrip("\n"), encoding="utf-8")
    return folder / next(iter(TRAPS[name]))


@pytest.fixture
def evaluated(prefix: Prefix) -> Any:
    def evaluated(name: str, file: str = "") -> dict[str, Any]:
        path = write(prefix.folder, name)
        return by_name(evaluate(path.with_name(file) if file else path, {}))

    return evaluated


def by_name(description: Description) -> dict[str, Any]:
    assert not [each for each in description.losses if not each.is_note]
    return {
        unit.full_name
        or " ".join(getattr(unit, "command", ()))
        or getattr(unit, "executable", ""): unit
        for unit in description.units
    }


def values(unit: Process | Composable) -> dict[str, Any]:
    return {each.name: each.value for each in unit.parameters}


def types(unit: Process | Composable) -> dict[str, ParameterType]:
    return {each.name: each.type for each in unit.parameters}


def test_scopes(evaluated: Any) -> None:
    found = evaluated("scopes")
    assert {name: unit.arguments for name, unit in found.items()} == {
        "/pushed/one": ["outer", "given", "outer-given"],
        "/pushed/two": ["inner"],
        "/pushed/three": ["outer"],
        "/pushed/four": ["leaks"],
        "/pushed/five": ["leaks"],
    }


def test_folders(evaluated: Any, prefix: Prefix) -> None:
    found = evaluated("folders")
    here, below = str(prefix.folder), str(prefix.folder / "below")
    assert found["/one"].arguments == [here, f"{here}/a.launch.xml"]
    assert found["/b"].arguments == [below]
    assert found["/two"].arguments == [below, below]
    assert str(found["/b"].origin) == f"{below}/b.launch.yaml:3"
    assert [str(each) for each in found["/b"].origin.included_from] == [f"{here}/a.launch.xml:3"]


def test_let(evaluated: Any) -> None:
    (unit,) = evaluated("let").values()
    assert unit.arguments == ["1", "2", "default", os.environ["HOME"]]


def test_global_parameters(evaluated: Any) -> None:
    found = evaluated("global parameters")
    assert values(found["/one"]) == {"first": 1}
    assert values(found["/two"]) == {}
    # A list of Python is no list to rcl.
    common = {"use_sim_time": True, "leaks": "[1, 2]", "text": 5}
    assert values(found["/c"]) == {**common, "leaks": "(1, 2)"}
    assert values(found["/in_c"]) == {"use_sim_time": True, "leaks": (1, 2), "text": "5"}
    assert values(found["/three"]) == {**common, "leaks": 9}
    assert found["/c"].remappings == found["/in_c"].remappings == [("a", "b")]
    assert found["/three"].remappings == []


def test_composables(evaluated: Any) -> None:
    found = evaluated("composables")
    assert list(found) == ["/far/c", "/robot/one", "/robot/below/two", "/x/three"]
    assert found["/robot/one"].remappings == [("chatter", "first"), ("chatter", "second")]
    assert {unit.container for name, unit in found.items() if name != "/far/c"} == {"/far/c"}
    (extra,) = found["/robot/one"].extra_arguments
    assert (extra.name, extra.value) == ("use_intra_process_comms", True)


def test_types(evaluated: Any) -> None:
    found = evaluated("types")
    assert values(found["/ns/n"]) == {
        "octal": 8,
        "clock": 630,
        "word": True,
        # A text to YAML 1.1, which is written without quotes, and a double to rcl.
        "power": 1000.0,
        "real_power": 1000.0,
        "quoted": "5",
        "double_quoted": '"5"',
        "text": "5",
        "double": 5.0,
        "of_variable": 5,
        "text_of_variable": "5",
        "list": (5, 6),
        "separated": ("a", "b"),
        "texts": ("1", "2"),
        "empty": "",
        "nested.a": 1.5,
        "nested.b.c": False,
        "escaped": "$(var five)",
        # launch_ros writes them without quotes.
        "ys": (True, True),
    }
    assert types(found["/ns/n"])["double"] is ParameterType.DOUBLE
    assert values(found["/d"]) == {"power": "1e3", "octal": 8, "y": "y"}
    (unit,) = evaluated("types", "b.launch.yaml").values()
    assert values(unit) == {
        "number": 5,
        "text": "5",
        "list": (1.5, 2.5),
        "word": True,
        "typed": 2,
        "nested.deep": "x",
    }


def test_order_of_sources(evaluated: Any) -> None:
    found = evaluated("order of sources")
    of_file = {"word": True, "n": 16, "b.c": 1.0}
    assert values(found["/n"]) == {"a": 2, "own": 1, **of_file}
    assert values(found["/m"]) == {"a": 1, **of_file}
    assert values(found["talker"]) == {"a": 1, **of_file}
    assert values(found["/s"])["home"] == os.environ["HOME"]
    # `/*/one` is for others here: launch_ros takes the exact name only.
    assert values(found["/ns/one"]) == {"a": 2, "own": 2, **of_file}
    assert [each.pattern for each in found["/m"].for_others] == [
        "/**",
        "/n",
        "/ns/one",
        "/*/one",
        "/other",
    ]


def test_timers(evaluated: Any) -> None:
    found = evaluated("timers")
    assert found["/inner/now"].arguments == ["2"]
    assert found["/later"].arguments == ["1"]
    delays = {
        name: [(each.event, each.seconds) for each in unit.start] for name, unit in found.items()
    }
    assert delays == {
        "/inner/now": [],
        "/later": [(Event.DELAY, 2.5)],
        "echo 1": [(Event.DELAY, 2.5), (Event.DELAY, 1.0)],
    }


def test_timers_fire_in_the_order_of_their_times(evaluated: Any) -> None:
    assert list(evaluated("order of timers")) == ["a not", "b set"]


def test_what_is_not_done_is_reported(prefix: Prefix) -> None:
    text = """<launch>
<log message="all is $(eval '1 + 1')"/>
<timer period="1" cancel_on_shutdown="$(eval '1 > 2')"><log message="x"/></timer>
<ros_timer period="1"><log message="y"/></ros_timer>
</launch>"""
    losses = evaluate(prefix.file("a.launch.xml", text), {}).losses
    found = [(Path(each.where).name, each.what, each.is_note) for each in losses]
    assert found[0] == ("a.launch.xml:2", "log: all is 2", True)
    assert found[1][1].startswith("cancel_on_shutdown: ")
    assert found[2][1].startswith("ros_timer: ")
    assert not found[2][2]


def test_environment(evaluated: Any) -> None:
    found = evaluated("environment")
    one = [("A", "2:3"), ("B", "5-4"), ("C", "5-4")]
    assert found["/one"].environment == one
    assert found["echo none 2:3 gone"].environment == []
    assert found["echo not set"].environment == []
    assert found["echo not set"].unset == ["PATH"]


def test_command_lines(evaluated: Any, prefix: Prefix) -> None:
    first, second, third = evaluated("command lines").values()
    two = "one two"
    assert first.command == ["echo", two, f"a b{two}", f"{two}{two}", f"--x={two}", "end"]
    assert (second.command, second.shell) == (["echo", "$HOME", "|", "cat"], True)
    assert (second.cwd, second.output, second.emulate_tty) == ("/tmp", "screen", True)
    assert third.arguments == ["-d", f"{prefix.folder}/x.rviz", "-y"]
    assert third.ros_arguments == ["--log-level", "debug"]
    assert third.prefix == ["nice", "-n", "5"]
    assert (third.respawn, third.respawn_delay, third.respawn_max_retries) == (True, 2.0, 3)
    assert (third.sigterm_timeout, third.sigkill_timeout) == (7.0, 8.5)
    assert (third.on_exit, third.label) == (AtExit.SHUTDOWN, "label")


def test_substitutions(evaluated: Any, prefix: Prefix) -> None:
    (unit,) = evaluated("substitutions").values()
    folder = prefix.folder
    assert values(unit)["x"].split("|") == [
        "10.5",
        "True",
        "yestruefalse",
        "truefalse",
        "two words\ntext",
        f"{folder}/share/pkg {folder} {folder}/lib/pkg/talker",
        "3",
        "x ab $5 (x) 5",
    ]


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_have_a_place(name: str, prefix: Prefix) -> None:
    text, expected = MISTAKES[name]
    path = prefix.file("a.launch.xml", text)
    with pytest.raises(LaunchFileError) as error:
        evaluate(path, {})
    found = str(error.value)
    assert found.startswith(f"{path}")
    assert expected in found


def test_the_chain_of_includes_is_named(prefix: Prefix) -> None:
    prefix.file("c.launch.yaml", "launch:\n- let: {name: x}\n")
    prefix.file("b.launch.xml", '<launch>\n\n<include file="$(dirname)/c.launch.yaml"/></launch>')
    path = prefix.file(
        "a.launch.xml", '<launch>\n<include file="$(dirname)/b.launch.xml"/></launch>'
    )
    with pytest.raises(LaunchFileError) as error:
        evaluate(path, {})
    assert str(error.value).replace(f"{prefix.folder}/", "").splitlines() == [
        "c.launch.yaml:2: let needs the attribute value",
        "  included from b.launch.xml:3",
        "  included from a.launch.xml:2",
    ]


def test_arguments(prefix: Prefix) -> None:
    prefix.file(
        "b.launch.xml", '<launch><arg name="given"/><arg name="inner" default="1"/></launch>'
    )
    text = """<launch>
<arg name="needed" description="what for"/>
<arg name="which" default="a"><choice value="a"/><choice value="b"/></arg>
<include file="$(dirname)/b.launch.xml"><arg name="given" value="x"/></include>
<node pkg="pkg" exec="talker" args="$(var needed) $(var which)"/>
</launch>"""
    path = prefix.file("a.launch.xml", text)
    found = evaluate(path, {}, only_arguments=True).arguments
    assert [(each.name, each.default, each.choices) for each in found] == [
        ("needed", None, ()),
        ("which", "a", ("a", "b")),
        ("inner", "1", ()),
    ]
    (unit,) = evaluate(path, {"needed": "x", "which": "b"}).units
    assert isinstance(unit, Process)
    assert unit.arguments == ["x", "b"]


HOSTILE = {
    "doubling.xml": (
        "<launch><let name='x' value='0123456789'/>"
        + "<let name='x' value='$(var x)$(var x)'/>" * 60
        + "</launch>"
    ),
    "aliases.yaml": "launch:\n- group: &a0 [log: {message: x}]\n"
    + "".join(f"- group: &a{n} [" + f"group: *a{n - 1}, " * 9 + "]\n" for n in range(1, 12)),
    "itself.yaml": "launch: &a\n- group: *a\n",
    "entities.xml": """<!DOCTYPE launch [<!ENTITY a "aaaaaaaaaaaaaaaaaaaaaaaaa">"""
    + "".join(f'<!ENTITY a{n} "{f"&a{n - 1 or str()};" * 20}">' for n in range(1, 12))
    + "]><launch><log message='&a11;'/></launch>",
    "deep.xml": "<launch>" + "<group>" * 5000 + "</group>" * 5000 + "</launch>",
    "deep_eval.xml": f"<launch><log message=\"$(eval '{'(' * 500 + ')' * 500}')\"/></launch>",
    "power.xml": "<launch><log message=\"$(eval '9**9**9**9')\"/></launch>",
    "long.xml": "<launch><log message=\"$(eval '[0] * 10**9')\"/></launch>",
    "nul.xml": "<launch>\0</launch>",
    "nothing.yaml": "",
    "list.yaml": "[1, 2]",
    "substitutions.xml": f"<launch><log message='{'$(var ' * 200}'/></launch>",
    "output.xml": "<launch><log message=\"$(command 'yes')\"/></launch>",
    "errors.xml": "<launch><log message=\"$(command 'sh -c 'yes >&2'')\"/></launch>",
    "command_line.xml": f"<launch><executable cmd='echo {'x' * 3_000_000}'/></launch>",
    "prefix.xml": ('<launch><node pkg="pkg" exec="talker" launch-prefix="\'not closed"/></launch>'),
    "zero.xml": "<launch><include file='/dev/zero'/></launch>",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_refused_at_once(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(HOSTILE[name], encoding="utf-8")
    with pytest.raises(LaunchFileError):
        evaluate(path, {})


def doubling(folder: Path, levels: int) -> Path:
    """Write launch files that include one another twice each, down to one with a program."""
    text = "<launch><executable cmd='true'/></launch>"
    for level in range(levels):
        (folder / f"{level}.xml").write_text(text, encoding="utf-8")
        text = "<launch>" + f"<include file='$(dirname)/{level}.xml'/>" * 2 + "</launch>"
    path = folder / "a.launch.xml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("only_arguments", [False, True])
def test_includes_that_double_end(
    tmp_path: Path, only_arguments: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = doubling(tmp_path, 60)
    with pytest.raises(LaunchFileError, match=r"it is not evaluated after 0\.1 s"):
        evaluate(path, {}, limit=0.1, only_arguments=only_arguments)
    monkeypatch.setattr("play_launch.launch_files.markup.context.MOST_ACTIONS", 100)
    with pytest.raises(LaunchFileError, match="more than 100 actions"):
        # As for completion, which has no limit of time.
        evaluate(path, {}, limit=0, only_arguments=only_arguments)


def test_a_cycle_of_includes_is_named_once(tmp_path: Path) -> None:
    for name, other in ("ab", "ba"):
        text = f"<launch>\n<include file='$(dirname)/{other}.xml'/></launch>"
        (tmp_path / f"{name}.xml").write_text(text, encoding="utf-8")
    with pytest.raises(LaunchFileError) as caught:
        evaluate(tmp_path / "a.xml", {})
    assert str(caught.value).count("included from") <= 2


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.launch.xml")
    with pytest.raises(LaunchFileError, match="pipe"):
        evaluate(tmp_path / "pipe.launch.xml", {})


def meaning(description: Description) -> list[Any]:
    """Return what two evaluations must agree on."""
    found: list[Any] = []
    for unit in description.units:
        common = (
            unit.package,
            unit.name,
            unit.namespace,
            sorted((each.name, each.type, each.value) for each in unit.parameters),
            [each.pattern for each in getattr(unit, "for_others", ())],
            unit.remappings,
            [(each.event, each.seconds) for each in unit.start],
            str(unit.origin),
            [str(each) for each in unit.origin.included_from],
        )
        if isinstance(unit, Composable):
            extra = [(each.name, each.value) for each in unit.extra_arguments]
            found.append((unit.plugin, unit.container, extra, common))
        else:
            settings = (
                unit.respawn or False,
                unit.respawn_delay,
                unit.respawn_max_retries,
                unit.on_exit,
                unit.cwd,
                unit.emulate_tty,
                unit.shell,
                unit.prefix,
                unit.output,
                unit.label,
                unit.sigterm_timeout,
                unit.sigkill_timeout,
            )
            program = (unit.executable, unit.arguments, unit.ros_arguments)
            words = " ".join(unit.command) if unit.shell else unit.command
            found.append(
                (unit.kind, program, words, sorted(unit.environment), unit.unset, settings, common)
            )
    return found


@needs_launch
@pytest.mark.parametrize("name", TRAPS)
def test_ros_launch_gives_the_same(name: str, prefix: Prefix) -> None:
    write(prefix.folder, name)
    for file in TRAPS[name]:
        if not file.endswith((".launch.xml", "b.launch.yaml")) or "/" in file:
            continue
        if name == "scopes" and file == "b.launch.xml":
            continue
        path = prefix.folder / file
        assert meaning(evaluate(path, {})) == meaning(ros_launch.evaluate(path, {}, limit=LIMIT))


@needs_launch
@pytest.mark.parametrize("name", sorted(MISTAKES.keys() - {"code", "itself", "python"}))
def test_ros_launch_refuses_the_same(name: str, prefix: Prefix) -> None:
    path = prefix.file("a.launch.xml", MISTAKES[name][0])
    with pytest.raises(LaunchFileError):
        ros_launch.evaluate(path, {}, limit=LIMIT)

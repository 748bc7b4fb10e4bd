"""Launch files that fail, each in its way: what is wrong, where, and nothing left behind."""

from __future__ import annotations

from pathlib import Path

import pytest

from play_launch.launch_files.records import LaunchFileError
from play_launch.launch_files.ros_launch.evaluate import evaluate
from tests.launch_files.ros_launch.prefix import LIMIT, Prefix, needs_launch, prefix, processes

__all__ = ["prefix"]

HEAD = """
from launch import LaunchDescription
from launch.actions import *
from launch.substitutions import *
"""


def python(body: str) -> str:
    return HEAD + body


def test_python_that_raises(prefix: Prefix) -> None:
    text = python("""
def helper():
    return {}["key"]

def generate_launch_description():
    return helper()
""")
    assert prefix.error("a.launch.py", text) == "a.launch.py:6: KeyError: key"


def test_python_that_is_none(prefix: Prefix) -> None:
    error = prefix.error("a.launch.py", "\ndef generate_launch_description(:\n")
    assert error.startswith("a.launch.py:1: SyntaxError: ")


def test_a_function_that_raises_while_it_is_visited(prefix: Prefix) -> None:
    text = python("""
def opaque(context):
    raise ValueError("no such robot")

def generate_launch_description():
    return LaunchDescription([OpaqueFunction(function=opaque)])
""")
    assert prefix.error("a.launch.py", text) == "a.launch.py:6: ValueError: no such robot"


@pytest.mark.parametrize("call", ["sys.exit(3)", "exit(3)", "raise SystemExit(3)"])
def test_python_that_exits(prefix: Prefix, call: str) -> None:
    text = python(f"""
import sys
def generate_launch_description():
    {call}
""")
    assert (
        prefix.error("a.launch.py", text) == "a.launch.py:7: it calls exit(3) while it is evaluated"
    )


@needs_launch
def test_what_launch_logs_stands_behind_the_error(
    prefix: Prefix, capfd: pytest.CaptureFixture[str]
) -> None:
    text = '<launch>\n  <arg name="robot" description="its name"/>\n</launch>\n'
    assert prefix.error("a.launch.xml", text).splitlines() == [
        'a.launch.xml:2: Required launch argument "robot" was not provided; give it as name:=value',
        '  launch: Required launch argument "robot" (description: "its name") was not provided',
    ]
    assert "robot" not in capfd.readouterr().err
    # What launch only complains of is not lost where there is no error.
    text = python("""
import launch.logging
launch.logging.get_logger("launch.x").error("strange")
def generate_launch_description():
    return LaunchDescription([])
""")
    prefix.evaluate("b.launch.py", text)
    assert "[ERROR] [launch.x]: strange" in capfd.readouterr().err


def include(prefix: Prefix, name: str) -> str:
    return f"""
from launch.launch_description_sources import AnyLaunchDescriptionSource
def generate_launch_description():
    return LaunchDescription([
        IncludeLaunchDescription(AnyLaunchDescriptionSource("{prefix.folder}/{name}")),
    ])
"""


def test_the_chain_of_includes_in_python(prefix: Prefix) -> None:
    missing = """
def generate_launch_description():
    return LaunchDescription([DeclareLaunchArgument("robot")])
"""
    prefix.file("c.launch.py", python(missing))
    prefix.file("b.launch.py", python(include(prefix, "c.launch.py")))
    text = python(include(prefix, "b.launch.py"))
    assert prefix.error("a.launch.py", text).splitlines() == [
        'c.launch.py:6: Required launch argument "robot" was not provided; give it as name:=value',
        "  included from b.launch.py:8",
        "  included from a.launch.py:8",
    ]
    found = prefix.evaluate("a.launch.py", text, {"robot": "r2"})
    assert [Path(file).name for file in found.files] == [
        "a.launch.py",
        "b.launch.py",
        "c.launch.py",
    ]
    assert [each.name for each in found.arguments] == ["robot"]


@needs_launch
def test_a_package_that_is_missing(prefix: Prefix) -> None:
    text = '<launch>\n  <node pkg="nowhere" exec="x"/>\n</launch>\n'
    error = prefix.error("a.launch.xml", text)
    assert error.startswith("a.launch.xml:2: ")
    assert "'nowhere' not found" in error
    text = '<launch>\n  <node pkg="pkg" exec="nothing"/>\n</launch>\n'
    assert prefix.error("a.launch.xml", text).startswith("a.launch.xml:2: executable 'nothing'")
    error = prefix.error(
        "a.launch.py",
        python("""
from ament_index_python import get_package_share_directory
def generate_launch_description():
    return LaunchDescription([
        SetEnvironmentVariable("X", get_package_share_directory("nowhere"))])
"""),
    )
    assert error.startswith("a.launch.py:8: package 'nowhere' not found")


@needs_launch
def test_the_chain_of_includes(prefix: Prefix) -> None:
    prefix.file("c.launch.yaml", "launch:\n- let: {name: a, value: b}\n- node: {pkg: pkg}\n")
    prefix.file("b.launch.py", python(include(prefix, "c.launch.yaml")))
    element = f'<include file="{prefix.folder}/b.launch.py"/>'
    text = f"<launch>\n  <group>\n    {element}\n  </group>\n</launch>\n"
    lines = prefix.error("a.launch.xml", text).splitlines()
    assert lines[0].startswith("c.launch.yaml:3: ")
    assert "exec" in lines[0]
    assert lines[1:] == ["  included from b.launch.py:8", "  included from a.launch.xml:3"]


@needs_launch
def test_a_file_that_is_not_there(prefix: Prefix) -> None:
    text = '<launch>\n  <include file="/nowhere/b.launch.xml"/>\n</launch>\n'
    error = prefix.error("a.launch.xml", text)
    assert error == "a.launch.xml:2: No such file or directory: /nowhere/b.launch.xml"
    with pytest.raises(LaunchFileError, match=r"^/nowhere/a.launch.py: No such file or directory"):
        evaluate(Path("/nowhere/a.launch.py"), {}, limit=LIMIT)


@needs_launch
@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.launch.xml", "<launch>\n  <node\n</launch>\n", "a.launch.xml:3: is not XML: "),
        ("a.launch.yaml", "launch:\n- node: {a\n", "a.launch.yaml:3: is not YAML: "),
        ("a.launch.yaml", "", "a.launch.yaml: a launch file is one key `launch` above a list"),
        ("a.launch.xml", "<launch>\n <nodes/>\n</launch>\n", "a.launch.xml:2: Unrecognized entity"),
        (
            "a.launch.xml",
            '<launch>\n\n <node pkg="pkg" exec="talker" colour="x"/>\n</launch>\n',
            "a.launch.xml:3: ValueError: Unexpected attribute(s)",
        ),
        (
            "a.launch.xml",
            '<launch>\n <executable cmd="$(var nothing)"/>\n</launch>\n',
            "a.launch.xml:2: launch configuration 'nothing' does not exist; declare it, or give",
        ),
    ],
)
def test_files_that_are_wrong(prefix: Prefix, name: str, text: str, words: str) -> None:
    assert prefix.error(name, text).startswith(words)


@needs_launch
@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("b.launch.xml", b"<launch>\n<node></launch>", "b.launch.xml:2: is not XML: mismatched"),
        ("b.launch.xml", b"<launch>\n\xe9</launch>", "b.launch.xml: is not UTF-8 at byte 9"),
        ("b.launch.yaml", b"", "b.launch.yaml: a launch file is one key `launch` above a list"),
    ],
)
def test_included_files_that_are_wrong(
    prefix: Prefix, name: str, content: bytes, words: str
) -> None:
    (prefix.folder / name).write_bytes(content)
    text = f'<launch>\n\n<include file="$(dirname)/{name}"/></launch>'
    first, second = prefix.error("a.launch.xml", text).splitlines()
    assert first.startswith(words)
    assert second == "  included from a.launch.xml:3"


def test_the_working_directory(prefix: Prefix) -> None:
    """As in ROS: what is relative starts there from then on, also for the processes."""
    text = python(f"""
import os
os.chdir({str(prefix.folder / "share")!r})
def generate_launch_description():
    return LaunchDescription([
        ExecuteProcess(cmd=["true"]), ExecuteProcess(cmd=["true"], cwd="/")])
""")
    before = Path.cwd()
    first, second = processes(prefix.evaluate("a.launch.py", text))
    assert Path.cwd() == before
    assert first.cwd == str(prefix.folder / "share")
    assert second.cwd == "/"


def test_a_folder_called_launch_is_not_imported(
    prefix: Prefix, monkeypatch: pytest.MonkeyPatch
) -> None:
    (prefix.folder / "launch").mkdir()
    (prefix.folder / "launch" / "__init__.py").write_text("raise RuntimeError('not this one')\n")
    monkeypatch.chdir(prefix.folder)
    function = "\ndef generate_launch_description(): return LaunchDescription([])\n"
    assert prefix.evaluate("a.launch.py", python(function)).units == []


def test_a_file_that_includes_itself(prefix: Prefix) -> None:
    text = python(include(prefix, "a.launch.py"))
    assert prefix.error("a.launch.py", text).splitlines() == [
        "a.launch.py:8: includes are nested deeper than 50",
    ]


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("None", "returns None and no LaunchDescription"),
        ("LaunchDescription(['x'])", "'x', where a part of a description is expected"),
    ],
)
def test_what_is_no_description(prefix: Prefix, value: str, words: str) -> None:
    error = prefix.error(
        "a.launch.py", python(f"def generate_launch_description(): return {value}\n")
    )
    assert error.startswith("a.launch.py: ")
    assert words in error


def test_a_file_without_the_function(prefix: Prefix) -> None:
    assert "generate_launch_description" in prefix.error("a.launch.py", "x = 1\n")


def test_what_is_not_utf8(prefix: Prefix) -> None:
    text = python("""
def generate_launch_description():
    return LaunchDescription([ExecuteProcess(cmd=["true", "\\udcff"])])
""")
    assert prefix.error("a.launch.py", text).startswith("a.launch.py: it holds what is not UTF-8")
    with pytest.raises(LaunchFileError, match="not UTF-8"):
        evaluate(Path("/tmp/\udcff.launch.py"), {}, limit=LIMIT)

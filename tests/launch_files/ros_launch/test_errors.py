"""Launch files that fail, each in its way: what is wrong, where, and nothing left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import psutil
import pytest

from play_launch.launch_files.records import LaunchFileError
from play_launch.launch_files.ros_launch.evaluate import evaluate
from play_launch.launch_files.ros_launch.temporary import temporary_folder
from tests.launch_files.ros_launch.prefix import LIMIT, Prefix, needs_launch, prefix, processes
from tests.support.waiting import until

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


def test_python_that_ends_its_process(prefix: Prefix) -> None:
    error = prefix.error("a.launch.py", "import os\nos._exit(7)\n")
    assert error.startswith("a.launch.py: it ends its own evaluation: ")
    assert "7" in error
    error = prefix.error("b.launch.py", "import os\nos.kill(os.getpid(), 11)\n")
    assert error.startswith("b.launch.py: it ends its own evaluation: ")
    assert "SIGSEGV" in error


def test_python_that_prints(prefix: Prefix, capfd: pytest.CaptureFixture[str]) -> None:
    text = python("""
import os, sys
print("printed while it is loaded")
os.write(1, b"written to the descriptor\\n")
os.system("echo of a program")
sys.stdout.write("without an end")

def generate_launch_description():
    return LaunchDescription([LogInfo(msg="said"), ExecuteProcess(cmd=["true"])])
""")
    assert len(processes(prefix.evaluate("a.launch.py", text))) == 1
    out, err = capfd.readouterr()
    assert not out
    for words in ("printed while", "written to", "of a program", "without an end", "said"):
        assert words in err


@pytest.mark.parametrize(
    ("name", "text", "where"),
    [
        ("a.launch.py", "import time\nwhile True:\n    time.sleep(0.1)\n", "a.launch.py:3"),
        ("a.launch.py", "def f():\n  while 1: pass\nf()\n", "a.launch.py:2"),
        (
            "a.launch.py",
            (
                "while True:\n    try:\n        import time; time.sleep(9)\n"
                "    except BaseException:\n        pass\n"
            ),
            "a.launch.py:3",
        ),
        pytest.param(
            "a.launch.xml",
            '<launch>\n  <let name="x" value="$(command \'sleep 1000\')"/>\n</launch>\n',
            "a.launch.xml",
            marks=needs_launch,
        ),
    ],
)
def test_a_file_that_hangs(prefix: Prefix, name: str, text: str, where: str) -> None:
    error = prefix.error(name, text, limit=3)
    assert error.startswith(f"{where}")
    assert error.endswith(": it is not evaluated after 3 s")


def test_a_file_that_hangs_and_hears_nothing(
    prefix: Prefix, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("play_launch.launch_files.ros_launch.evaluate._GRACE", 0.5)
    text = """
import signal, time
signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})
time.sleep(1000)
"""
    error = prefix.error("a.launch.py", text, limit=3)
    assert error == "a.launch.py: it is not evaluated after 3 s, and does not say why"


@needs_launch
def test_an_argument_that_is_missing(prefix: Prefix) -> None:
    prefix.file("b.launch.xml", '<launch>\n  <arg name="robot"/>\n</launch>\n')
    text = f"""
<launch>

  <include file="{prefix.folder}/b.launch.xml"/>
</launch>
"""
    assert prefix.error("a.launch.xml", text).splitlines() == [
        'b.launch.xml:2: Required launch argument "robot" was not provided; give it as name:=value',
        "  included from a.launch.xml:3",
    ]
    assert prefix.evaluate("a.launch.xml", text, {"robot": "r2"}).arguments[0].name == "robot"


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


def test_launch_is_not_installed(prefix: Prefix, monkeypatch: pytest.MonkeyPatch) -> None:
    """Something else that is called `launch` is there, as from PyPI."""
    (prefix.folder / "other" / "launch").mkdir(parents=True)
    (prefix.folder / "other" / "launch" / "__init__.py").touch()
    monkeypatch.setenv("PYTHONPATH", str(prefix.folder / "other"))
    error = prefix.error("a.launch.py", "")
    assert "ROS's launch is not installed here; source a ROS installation" in error


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
        ("a.launch.xml", "<launch>\n  <node\n</launch>\n", "a.launch.xml:3: no XML: "),
        ("a.launch.yaml", "launch:\n- node: {a\n", "a.launch.yaml:3: no YAML: "),
        ("a.launch.xml", "<launch>\n <nodes/>\n</launch>\n", "a.launch.xml:2: Unrecognized entity"),
        (
            "a.launch.xml",
            '<launch>\n\n <node pkg="pkg" exec="talker" colour="x"/>\n</launch>\n',
            "a.launch.xml:3: ValueError: Unexpected attribute(s)",
        ),
        (
            "a.launch.xml",
            '<launch>\n <executable cmd="$(var nothing)"/>\n</launch>\n',
            "a.launch.xml:2: launch configuration 'nothing' does not exist",
        ),
    ],
)
def test_files_that_are_wrong(prefix: Prefix, name: str, text: str, words: str) -> None:
    assert prefix.error(name, text).startswith(words)


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


def test_nothing_is_left_behind(prefix: Prefix, tmp_path: Path) -> None:
    """Neither what a launch file has started, nor its temporary files, nor its threads."""
    pids = tmp_path / "pids"
    text = python(f"""
import os, subprocess, tempfile, threading
for line in ("sleep 1000 & echo $! >> {pids}", "setsid sleep 1000 & echo $! >> {pids}"):
    subprocess.run(["sh", "-c", line + "; exec 2>&-"], stdout=subprocess.DEVNULL)
if os.fork() == 0:
    os.setsid()
    if os.fork() == 0:
        open("{pids}", "a").write(f"{{os.getpid()}}\\n")
        import time
        time.sleep(1000)
    os._exit(0)
threading.Thread(target=threading.Event().wait).start()
made = tempfile.NamedTemporaryFile(delete=False)
open("{tmp_path}/made", "w").write(made.name)
def generate_launch_description():
    while len(open("{pids}").read().split()) < 3: pass
    return LaunchDescription([])
""")
    prefix.evaluate("a.launch.py", text)
    found = [int(pid) for pid in pids.read_text().split()]
    assert len(found) == 3
    for pid in found:
        is_gone = partial(lambda pid: not psutil.pid_exists(pid), pid)
        until(is_gone, "the end of what it started")
    made = Path((tmp_path / "made").read_text())
    assert not made.exists()
    assert not made.parent.exists()


def test_the_evaluation_ends_with_who_asked(prefix: Prefix, tmp_path: Path) -> None:
    pid_file = tmp_path / "pid"
    path = prefix.file(
        "a.launch.py",
        "import os, time\n"
        f"open({str(pid_file)!r}, 'w').write(f'{{os.getpid()}}.')\n"
        "time.sleep(1000)\n",
    )
    program = (
        "from pathlib import Path\n"
        "from play_launch.launch_files.ros_launch.evaluate import evaluate\n"
        f"evaluate(Path({str(path)!r}), {{}}, limit=1000)\n"
    )
    asking = subprocess.Popen([sys.executable, "-c", program], env=os.environ)
    until(lambda: pid_file.exists() and pid_file.read_text().endswith("."), "the evaluation")
    evaluating = int(pid_file.read_text().rstrip("."))
    asking.send_signal(signal.SIGKILL)
    asking.wait()
    until(lambda: not psutil.pid_exists(evaluating), "its end")
    # The next evaluation removes what nobody could.
    (left,) = (tmp_path / "temporary").iterdir()
    os.utime(left, (0, 0))
    with pytest.raises(LaunchFileError):
        evaluate(Path("/nowhere.launch.py"), {}, limit=LIMIT)
    assert list((tmp_path / "temporary").iterdir()) == []


def test_a_folder_that_is_in_use_stays(prefix: Prefix, tmp_path: Path) -> None:
    with temporary_folder() as used:
        os.utime(used, (0, 0))
        with temporary_folder() as other:
            assert Path(used).exists()
            assert used != other
    assert list((tmp_path / "temporary").iterdir()) == []


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


def test_a_file_that_closes_its_output(prefix: Prefix) -> None:
    text = python("""
import sys
sys.stdout.close()
sys.stderr.close()
def generate_launch_description():
    return LaunchDescription([])
""")
    assert prefix.evaluate("a.launch.py", text).units == []


def test_much_is_answered(prefix: Prefix) -> None:
    """More than a pipe holds."""
    text = python("""
def generate_launch_description():
    return LaunchDescription([ExecuteProcess(cmd=["echo", "x" * 1000]) for _ in range(1000)])
""")
    assert len(prefix.evaluate("a.launch.py", text).units) == 1000

"""Launch files that end, hang, fork, or close what is not theirs: nothing is left of them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import psutil
import pytest

from tests.launch_files.ros_launch.prefix import Prefix, needs_launch, prefix
from tests.launch_files.ros_launch.test_errors import python
from tests.support.waiting import until

__all__ = ["prefix"]


def test_python_that_ends_its_process(prefix: Prefix) -> None:
    error = prefix.error("a.launch.py", "import os\nos._exit(7)\n")
    assert error.startswith("a.launch.py: it ends its own evaluation: ")
    assert "7" in error
    error = prefix.error("b.launch.py", "import os\nos.kill(os.getpid(), 11)\n")
    assert error.startswith("b.launch.py: it ends its own evaluation: ")
    assert "SIGSEGV" in error


@needs_launch
def test_a_parameter_file_that_is_not_there(prefix: Prefix) -> None:
    """launch_ros leaves it out, with a warning that names no place."""
    text = '<launch>\n<node pkg="pkg" exec="talker"><param from="/no/such.yaml"/></node></launch>'
    found = prefix.evaluate("a.launch.xml", text)
    (note,) = found.losses
    assert note.is_note
    assert note.where.endswith("a.launch.xml:2")
    assert "/no/such.yaml" in note.what


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
            "a.launch.xml:2",
            marks=needs_launch,
        ),
    ],
)
def test_a_file_that_hangs(
    prefix: Prefix, name: str, text: str, where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # As long as a busy machine takes to start it.
    monkeypatch.setattr("play_launch.launch_files.ros_launch.evaluate._GRACE", 120.0)
    error = prefix.error(name, text, limit=3)
    assert error.startswith(f"{where}")
    assert error.endswith(": it is not evaluated after 3 s")


def test_a_file_that_hangs_and_hears_nothing(
    prefix: Prefix, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("play_launch.launch_files.ros_launch.evaluate._GRACE", 0.1)
    text = """
import signal, time
signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})
time.sleep(1000)
"""
    error = prefix.error("a.launch.py", text, limit=3)
    assert error == "a.launch.py: its evaluation gave no result within 3 s"


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


def test_the_evaluation_ends_with_its_parent(prefix: Prefix, tmp_path: Path) -> None:
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


def test_a_file_that_closes_its_output(prefix: Prefix) -> None:
    text = python("""
import sys
sys.stdout.close()
sys.stderr.close()
def generate_launch_description():
    return LaunchDescription([])
""")
    assert prefix.evaluate("a.launch.py", text).units == []


def test_what_calls_itself(prefix: Prefix) -> None:
    error = prefix.error("a.launch.py", "def f():\n    f()\nf()\n")
    assert error == "a.launch.py:2: it is nested too deeply, or calls itself without end"


@needs_launch
def test_a_substitution_that_is_not_closed(prefix: Prefix) -> None:
    text = "<launch>\n  <log message='$(var x'/>\n</launch>\n"
    error = prefix.error("a.launch.xml", text)
    assert error.startswith("a.launch.xml:2: a substitution is not written as launch wants it: ")
    assert "\n" not in error


@needs_launch
@pytest.mark.parametrize(
    ("element", "reason"),
    [
        ("<log message='$(nothing x)'/>", "Unknown substitution: nothing"),
        (
            "<log message='$(find demo)/x'/>",
            "Unknown substitution: find; it is of ROS 1, in ROS 2 it is $(find-pkg-share PACKAGE)",
        ),
        (
            "<node pkg='demo' type='talker' name='t'/>",
            "node has no attribute exec; it was type in ROS 1",
        ),
        ("<executable name='t'/>", "executable has no attribute cmd"),
    ],
)
def test_what_is_of_ros_1_or_not_written_right(prefix: Prefix, element: str, reason: str) -> None:
    error = prefix.error("a.launch.xml", f"<launch>\n  {element}\n</launch>\n")
    assert error == f"a.launch.xml:2: {reason}"


def test_many_processes_are_all_followed(prefix: Prefix) -> None:
    text = python("""
def generate_launch_description():
    return LaunchDescription([ExecuteProcess(cmd=["true", str(n)]) for n in range(6000)])
""")
    found = prefix.evaluate("a.launch.py", text)
    assert len(found.units) == 6000
    assert found.losses == []

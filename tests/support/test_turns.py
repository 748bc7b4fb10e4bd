"""Tests with the marker `alone` run alone, however many processes there are."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
from pathlib import Path

import pytest

from play_launch.ros.fastdds.sweep_command import sweep_command
from tests.support.turns import _is_sweep
from tests.support.waiting import until

ROOT = Path(__file__).resolve().parents[2]

# Every test writes down when it began and when it ended, by a clock that all processes share.
SUITE = """
import os, time
from pathlib import Path
import pytest

@pytest.fixture(autouse=True)
def _written_down(request):
    begin = time.monotonic()
    yield
    time.sleep(0.01)  # long enough that two can overlap
    line = f"{request.node.name} {os.getpid()} {begin} {time.monotonic()}"
    Path(request.config.rootpath, "journal", request.node.name).write_text(line)

@pytest.mark.parametrize("number", range(20))
def test_together(number):
    pass

@pytest.mark.alone
@pytest.mark.parametrize("number", range(5))
def test_alone(number):
    pass

@pytest.mark.parametrize("number", range(20))
def test_more(number):
    pass
"""


def journal(folder: Path, *arguments: str) -> list[tuple[str, str, float, float]]:
    """Run the suite; name, process, begin and end of each test, in order."""
    (folder / "journal").mkdir()
    (folder / "pytest.ini").touch()
    (folder / "test_suite.py").write_text(SUITE)
    environment = {key: value for key, value in os.environ.items() if "PYTEST" not in key}
    command = [sys.executable, "-m", "pytest", "-p", "tests.support.turns", "--strict-markers"]
    command += ["-p", "no:hypothesispytest", "-p", "no:anyio"]
    done = subprocess.run(
        [*command, "-q", *arguments, "test_suite.py"],
        cwd=folder,
        env={**environment, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    lines = [path.read_text().split() for path in (folder / "journal").iterdir()]
    found = [(name, pid, float(begin), float(end)) for name, pid, begin, end in lines]
    assert len(found) == 45
    return sorted(found, key=lambda each: each[2])


def test_what_runs_alone_overlaps_nothing_else(tmp_path: Path) -> None:
    found = journal(tmp_path, "-n", "2", "--dist", "worksteal")
    assert len({pid for _, pid, _, _ in found}) == 2
    for name, _, begin, end in found:
        if name.startswith("test_alone"):
            others = [each for each in found if each[0] != name and each[2] < end]
            assert not [each for each in others if each[3] > begin]
    together = [each for each in found if not each[0].startswith("test_alone")]
    pairs = itertools.pairwise(together)
    assert any(first[3] > second[2] for first, second in pairs), "the others run side by side"


def test_without_workers_the_order_stays(tmp_path: Path) -> None:
    found = journal(tmp_path)
    assert [name for name, *_ in found][20:25] == [f"test_alone[{number}]" for number in range(5)]


@pytest.mark.parametrize("is_sweep", [True, False], ids=["sweep", "guard"])
def test_a_sweep_is_awaited_but_not_a_guard_that_is_to_start_one(
    tmp_path: Path, is_sweep: bool
) -> None:
    (tmp_path / "play_launch.ros.fastdds").write_text("read line")
    # To a shell, the options of a sweep are those for a script of that name.
    command = [*sweep_command()] if is_sweep else ["guard", "-s", "--", *sweep_command()]
    with subprocess.Popen(
        command,
        executable="/bin/bash",
        cwd=tmp_path,
        stdin=subprocess.PIPE,
    ) as process:
        entry = Path("/proc") / str(process.pid)
        # It is empty for a moment while a program takes the place of another.
        until(lambda: (entry / "cmdline").read_bytes() != b"", "its command line")
        assert _is_sweep(entry) is is_sweep
        process.communicate(b"\n")

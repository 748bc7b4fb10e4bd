"""What the README shows is true."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path

from tests.support.replay import replaying, run
from tests.support.waiting import until

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def example() -> str:
    (found,) = re.findall(r"```yaml\n(.*?)```", README, flags=re.DOTALL)
    return str(found)


def check(folder: Path, text: str) -> subprocess.CompletedProcess[str]:
    (folder / "robot.yaml").write_text(text, encoding="utf-8")
    return run("check", "robot.yaml", cwd=folder)


def test_the_configuration_is_valid(tmp_path: Path) -> None:
    result = check(tmp_path, example())
    assert result.returncode == 0, result.stdout + result.stderr


def test_the_mistake_is_told_as_shown(tmp_path: Path) -> None:
    (shown,) = re.findall(r"```\n(robot\.yaml:.*?)\n```", README, flags=re.DOTALL)
    result = check(tmp_path, example().replace("{rate: 10.0}", "{rate: [10.0, 5]}"))
    assert result.returncode == 2
    assert shown in result.stdout + result.stderr


def test_the_files_it_names_are_there() -> None:
    for name in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (ROOT / name).is_file(), name


def without_numbers(text: str) -> str:
    """What is the same each time: words, and how wide the columns of words are."""
    lines = text.splitlines()
    kept = [re.sub(r"\s*[\d.,]+( (s|min|h|%|k?MB|GB))?|\s+", " ", line[25:]) for line in lines]
    return "\n".join(line[:25] + rest for line, rest in zip(lines, kept, strict=True))


def test_commands_for_a_running_session_print_what_is_shown(tmp_path: Path) -> None:
    (shown,) = re.findall(r"```\n(\$ play-launch ps .*?)\n```", README, flags=re.DOTALL)
    examples = re.findall(r"^\$ play-launch (.*)\n((?:[^$\n].*\n?)+)", shown, flags=re.MULTILINE)
    assert len(examples) == 2
    demo = ROOT / "configs" / "demo.yaml"
    with replaying(demo, tmp_path / "logs", "-q", "--duration", "600s") as replay:

        def printed_by(line: str) -> str:
            return replay.ask(*shlex.split(line)).stdout

        until(lambda: printed_by("wait") != "", "the demo")
        # What its processes take is measured a moment later.
        until(lambda: "%" in printed_by("ps /chat"), "a sample")
        for line, printed in examples:
            assert without_numbers(printed_by(line)) == without_numbers(printed)

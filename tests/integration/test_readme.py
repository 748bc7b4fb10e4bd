"""What the README shows is true."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

from tests.support.replay import COMMAND

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def example() -> str:
    (found,) = re.findall(r"```yaml\n(.*?)```", README, flags=re.DOTALL)
    return str(found)


def check(folder: Path, text: str) -> subprocess.CompletedProcess[str]:
    (folder / "robot.yaml").write_text(text, encoding="utf-8")
    return subprocess.run(
        [COMMAND, "check", "robot.yaml"], cwd=folder, check=False, capture_output=True, text=True
    )


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


def test_the_demo_command_is_what_the_demo_is_called_with() -> None:
    (demo,) = re.findall(r"<!-- demo command -->\n```sh\n(.*?)```", README, flags=re.DOTALL)
    assert demo.splitlines()[-1] == ".venv/bin/play-launch replay configs/demo.yaml"
    assert (ROOT / "configs" / "demo.yaml").is_file()

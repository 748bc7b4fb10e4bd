"""The checks of style and types, as tests, so that one command runs them all."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LINES_PER_FILE = 450


def tracked(*patterns: str) -> list[str]:
    listing = subprocess.run(
        ["git", "ls-files", "-z", "--", *patterns],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    )
    return [name for name in listing.stdout.split("\0") if name and (ROOT / name).is_file()]


def run(*command: str) -> None:
    result = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True)
    assert result.returncode == 0, f"{' '.join(command[:4])} …\n{result.stdout}{result.stderr}"


def test_ruff_finds_nothing() -> None:
    run(sys.executable, "-m", "ruff", "check", ".")


def test_python_is_formatted() -> None:
    run(sys.executable, "-m", "ruff", "format", "--check", ".")


@pytest.mark.skipif(
    int(metadata.version("rclpy").partition(".")[0]) > 7,
    reason="types are checked against Jazzy's rclpy; those of a later one differ",
)
def test_types_hold_under_mypy_strict() -> None:
    run(sys.executable, "-m", "mypy")


def test_imports_point_downwards() -> None:
    run(str(Path(sys.executable).parent / "lint-imports"), "--no-cache")


def test_cpp_is_formatted() -> None:
    sources = tracked("*.cpp", "*.hpp", "*.c")
    assert sources
    program = Path(sys.executable).parent / "clang-format"
    run(str(program), "--dry-run", "--Werror", *sources)


def test_the_site_is_built_without_warnings_and_its_links_lead_somewhere(tmp_path: Path) -> None:
    run(sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path))
    assert "create_subscription" in (tmp_path / "sdk" / "index.html").read_text("utf-8")
    for page in tracked("*.md"):
        if not page.startswith("docs/"):
            text = (ROOT / page).read_text("utf-8")
            links = re.findall(r"\]\(([^)#:]+)(?:#([^)]*))?\)", text)
            here = (ROOT / page).parent
            assert not [link for link, _ in links if not (here / link).exists()], page
            for link, place in links:
                site = tmp_path / link.removeprefix("docs/").removesuffix(".md") / "index.html"
                if place and site.is_file():
                    assert f'id="{place}"' in site.read_text("utf-8"), f"{page}: {link}#{place}"


def test_a_file_holds_one_subject() -> None:
    names = tracked("*.py", "*.cpp", "*.hpp", "*.cmake", "CMakeLists.txt")
    lines = {name: len((ROOT / name).read_bytes().splitlines()) for name in names}
    assert not {name: count for name, count in lines.items() if count > LINES_PER_FILE}


# Written so that the pattern does not match itself.
MACHINE_PATHS = re.compile(r"(?<![\w.])/(?:work|root|home/[a-z]+)/[\w.]")


def test_no_path_of_a_machine_is_in_the_tree() -> None:
    listing = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True
    )
    found = []
    for name in listing.stdout.split("\0"):
        path = ROOT / name
        if not name or not path.is_file():
            continue
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
        found += [
            f"{name}:{number}: {line.strip()[:100]}"
            for number, line in enumerate(text.splitlines(), 1)
            if MACHINE_PATHS.search(line)
        ]
    assert not found, "\n".join(found)

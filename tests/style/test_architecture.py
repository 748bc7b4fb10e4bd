"""docs/architecture.md names files that exist, functions that are in them, and right numbers."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "architecture.md"
ROOTS = (ROOT, ROOT / "play_launch", ROOT / "container_native" / "src")

_PATH = re.compile(r"`([\w./]+/[\w.]*)`(?:: ((?:`\w+`(?:, )?)+))?")


def places() -> list[tuple[str, tuple[str, ...]]]:
    """Return each file or folder that the page names, and the functions it names with it."""
    text = PAGE.read_text(encoding="utf-8")
    found = _PATH.findall(text)
    return sorted({(path, tuple(re.findall(r"\w+", names))) for path, names in found})


def located(path: str) -> list[Path]:
    return [root / path for root in ROOTS if (root / path).exists()]


def test_the_page_names_something() -> None:
    assert len(places()) > 50


@pytest.mark.parametrize(("path", "names"), places(), ids=str)
def test_what_it_names_is_there(path: str, names: tuple[str, ...]) -> None:
    files = located(path)
    assert files, f"{path} does not exist: mend {PAGE.name}"
    text = files[0].read_text(encoding="utf-8") if files[0].is_file() else ""
    for name in names:
        assert re.search(rf"\b{name}\b", text), f"{path} has no {name}: mend {PAGE.name}"


def walks() -> dict[str, list[str]]:
    """Return the rows of each table of steps, by the heading and the line above it."""
    tables: dict[str, list[str]] = {}
    heading = part = ""
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            heading, part = line[3:], ""
        elif line.startswith("**"):
            part = line.split("**")[1].rstrip(".")
        elif re.match(r"\| \d+ \|", line):
            tables.setdefault(f"{heading}: {part}", []).append(line)
    return tables


def test_steps_are_numbered_in_order() -> None:
    for name, rows in walks().items():
        numbers = [int(row.split("|")[1]) for row in rows]
        assert numbers == list(range(1, len(rows) + 1)), name


def test_the_numbers_of_steps_and_files_are_right() -> None:
    told = re.findall(
        r"(A load|A crash), C\+\+: (\d+) steps in (\d+)\s+files", PAGE.read_text(encoding="utf-8")
    )
    tables = walks()
    assert len(told) == 2
    for heading, steps, files in told:
        rows = tables[f"{heading}: C++"]
        names = {path for row in rows for path, _ in _PATH.findall(row)}
        assert (len(rows), len(names)) == (int(steps), int(files)), heading

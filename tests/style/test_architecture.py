"""What docs/architecture.md and CONTRIBUTING.md name exists; the former names every room."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "architecture.md"
BOTH_SIDES = {"Applying", "Exit", "Hello", "Load", "Query", "Unload"}
"""What the supervisor decides, and what a process, a container or other machines get or tell."""
PAGES = (PAGE, ROOT / "CONTRIBUTING.md")
PYTHON, NATIVE = ROOT / "play_launch", ROOT / "container_native" / "src"
ROOTS = (ROOT, PYTHON, NATIVE)

_CLASS = re.compile(r"^class (\w+)", re.MULTILINE)
_PATH = re.compile(r"`([\w./]+/[\w.]*)`(?:: ((?:`\w+`(?:, )?)+))?")


def places(page: Path) -> list[tuple[str, tuple[str, ...]]]:
    """Return each file or folder that a page names, and the functions it names with it."""
    text = " ".join(page.read_text(encoding="utf-8").split())
    found = _PATH.findall(text)
    return sorted({(path, tuple(re.findall(r"\w+", names))) for path, names in found})


def located(path: str) -> list[Path]:
    return [root / path for root in ROOTS if (root / path).exists()]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_what_a_page_names_is_there(page: Path) -> None:
    assert len(places(page)) > 20
    for path, names in places(page):
        files = located(path)
        assert files, f"{path} does not exist: mend {page.name}"
        text = files[0].read_text(encoding="utf-8") if files[0].is_file() else ""
        for name in names:
            assert re.search(rf"\b{name}\b", text), f"{path} has no {name}: mend {page.name}"


def test_every_room_is_in_the_table() -> None:
    rows = [
        line.split("|")[1] for line in PAGE.read_text(encoding="utf-8").splitlines() if "|" in line
    ]
    named = {
        name
        for row in rows
        for name in re.findall(r"`((?:play_launch|container_native)/[\w/]+)`", row)
    }
    rooms = {path.parent for path in PYTHON.glob("*/__init__.py")}
    rooms |= {path for path in NATIVE.iterdir() if path.is_dir()}
    assert {str(room.relative_to(ROOT)) for room in rooms} == named


def test_a_class_name_stands_once_but_for_both_sides_of_one_thing() -> None:
    texts = (each.read_text() for each in (ROOT / "play_launch").rglob("*.py"))
    names = Counter(name for text in texts for name in _CLASS.findall(text))
    assert {name for name, times in names.items() if times > 1} == BOTH_SIDES

"""What the container defines of other libraries is in one folder, and on a page with the reason."""

from __future__ import annotations

import re
import shutil
import subprocess
from functools import cache
from pathlib import Path

import pytest

from play_launch.container.ros import component_container

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ROOT / "container_native" / "src"
FOLDER = SOURCES / "overrides"
PAGE = ROOT / "docs" / "overrides.md"
EXPORTS = ROOT / "container_native" / "cmake" / "exports.list"
PRIVATE_MEMORY = "play_launch_private_memory"
"""Of the SDK, not of another library."""

ROW = re.compile(
    r"^\| `(\w+\.c(?:pp)?)` \| ([^|]+) \| ((?:`[\w:]+`(?:, )?)+) \| [^|]+ \|$", re.MULTILINE
)
# Sources there that define nothing of others.
HELPERS = {"handle_ledger.cpp"}
NOT_ALWAYS = ("with the ROS wheels", "with rclcpp")


@cache
def listed() -> dict[str, tuple[str, str]]:
    """Each name on the page, with its file and the library that has it, too."""
    return {
        name: (file, library)
        for file, library, names in ROW.findall(PAGE.read_text(encoding="utf-8"))
        for name in re.findall(r"[\w:]+", names)
    }


def run(*command: str, given: str = "") -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True, input=given).stdout


def dynamic_symbols(file: str) -> dict[str, str]:
    """Kinds of a file's dynamic symbols, see nm(1), by their mangled names with their versions."""
    assert shutil.which("nm"), "nm of the binutils, which the compiler needs as well"
    found = re.findall(r"^[ 0-9a-f]* (\w) (\S+)$", run("nm", "--dynamic", file), re.MULTILINE)
    return {name: kind for kind, name in found}


def libraries(program: str) -> list[str]:
    """What the dynamic loader starts the program with."""
    return re.findall(r"(/\S+) \(0x", run("ldd", program))


@cache
def overridden() -> frozenset[str]:
    """Names of strong symbols that the program defines and libraries look for, or would have."""
    program = str(component_container())
    own = dynamic_symbols(program)
    functions = {name for name, kind in own.items() if kind == "T"}
    # One that a library has is a copy of its own, made by the linker.
    data = {name for name, kind in own.items() if kind in "BD" and "@" not in name}
    found: set[str] = set()
    elsewhere: set[str] = set()
    for library in libraries(program):
        symbols = dynamic_symbols(library).items()
        wanted = {name.split("@")[0] for name, kind in symbols if kind in "Uw"}
        defined = {name.split("@")[0] for name, kind in symbols if kind not in "Uw"}
        found |= (functions & defined) | (data & wanted)
        elsewhere |= data & defined
    names = run("c++filt", given="\n".join(found - elsewhere))
    return frozenset(name.split("(")[0] for name in names.splitlines())


def test_every_symbol_of_another_library_is_on_the_page() -> None:
    assert overridden() <= listed().keys(), f"not in {PAGE.name}"


def test_what_is_on_the_page_is_in_the_program() -> None:
    always = {name for name, (_, library) in listed().items() if not library.endswith(NOT_ALWAYS)}
    assert len(always) > 20
    assert always <= overridden()


def test_what_is_on_the_page_is_exported_and_nothing_else() -> None:
    names = re.findall(r"^ +([\w:]+)\*?;$", EXPORTS.read_text(encoding="utf-8"), re.MULTILINE)
    assert set(names) == listed().keys() | {PRIVATE_MEMORY}
    symbols = dynamic_symbols(str(component_container())).items()
    functions = run("c++filt", given="\n".join(name for name, kind in symbols if kind == "T"))
    assert {name.split("(")[0] for name in functions.splitlines()} <= set(names)


@pytest.mark.parametrize("name", listed())
def test_it_is_defined_in_that_file(name: str) -> None:
    file, _ = listed()[name]
    definition = re.compile(
        rf"^[^\s/#}}].*\b{name.rpartition('::')[2]}\b(\[\d+\])?[;(]|^{name}\(", re.MULTILINE
    )
    assert definition.search((FOLDER / file).read_text(encoding="utf-8"))


def test_every_file_of_the_folder_is_on_the_page() -> None:
    files = {path.name for path in FOLDER.iterdir() if path.suffix != ".hpp"}
    assert files - HELPERS == {file for file, _ in listed().values()}


def test_no_other_file_passes_calls_on() -> None:
    outside = [path for path in SOURCES.rglob("*.[ch]*") if FOLDER not in path.parents]
    passing = [
        path.relative_to(SOURCES).as_posix()
        for path in outside
        if path.parent.name != "fastdds"
        and re.search(r'"base/next_function.hpp"|visibility\("default"\)', path.read_text("utf-8"))
    ]
    assert passing == []

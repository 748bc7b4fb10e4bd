"""Which ros2cli is known: by number, and by what its code does."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from play_launch.graph_daemon.patch import PatchError, install
from play_launch.graph_daemon.patch.known import KNOWN, definition_digest
from tests.graph_daemon.patch.conftest import STAND_IN, known_of

SOURCE = '''
def other(): pass
def wanted(a, *, b=1) -> int:
    """What it does."""
    # why
    return f"{a!r} {b:>3}", [x for x in a if x]
'''


def test_layout_comments_and_docstrings_are_not_code() -> None:
    again = """
def wanted(
    a, *, b = 1,
) -> int:
    return (f'{a!r} {b:>3}',
            [x for x in a if x])  # done
def other(): return 1
"""
    assert definition_digest(again, "wanted") == definition_digest(SOURCE, "wanted") != ""


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("b=1", "b=2"),
        ("b=1", "c=1"),
        ("if x", "if not x"),
        ("{a!r}", "{a!s}"),
        (":>3", ":>4"),
        ("return f", "yield f"),
        ("def wanted", "async def wanted"),
        ("def wanted", "def unwanted"),
    ],
)
def test_what_is_done_is_code(old: str, new: str) -> None:
    changed = SOURCE.replace(old, new)
    assert changed != SOURCE
    assert definition_digest(changed, "wanted") != definition_digest(SOURCE, "wanted")


def test_a_digest_does_not_depend_on_the_python() -> None:
    # The value was found with Python 3.11, 3.12 and 3.13.
    assert definition_digest(SOURCE, "wanted") == "a4e07957e2a565ec"


@pytest.mark.parametrize("version", ["0.18.0", "0.18.11", "0.32.0", "0.32.2", "0.32.99"])
def test_known_series(version: str) -> None:
    known = known_of(STAND_IN / "ros2cli")
    name = known.check(STAND_IN / "ros2cli", version)
    assert name == ("humble" if ".18." in version else "jazzy")


@pytest.mark.parametrize("version", ["0.31.9", "0.33.0", "1.18.0", "0.3.2", "", "0", "x.18.1"])
def test_unknown_releases_are_refused_with_the_fix(version: str) -> None:
    known = known_of(STAND_IN / "ros2cli")
    with pytest.raises(PatchError, match=r"fit 0\.18 \(humble\), 0\.32 \(jazzy\).*daemon start"):
        known.check(STAND_IN / "ros2cli", version)


def test_known_number_with_unknown_code_is_refused_by_name() -> None:
    with pytest.raises(PatchError, match=r"daemon/__init__\.py: serve, .*LocalXMLRPCServer"):
        KNOWN.check(STAND_IN / "ros2cli", "0.32.2")


def test_a_folder_without_the_files_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PatchError, match="not the code"):
        KNOWN.check(tmp_path, "0.32.2")


def test_the_overlay_runs_with_python_of_humble() -> None:
    sources = sorted(Path(install.__file__).with_name("overlay").glob("*.py"))
    assert len(sources) >= 6
    for path in sources:
        ast.parse(path.read_text(encoding="utf-8"), feature_version=(3, 10))

"""A configuration that was sent as the bytes of its files is the same configuration."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from play_launch.config.bundle import bundled, unbundled
from play_launch.config.description import describe
from play_launch.config.load import load_config
from play_launch.config.problems import ConfigError
from play_launch.config.sources.surroundings import Surroundings

if TYPE_CHECKING:
    from collections.abc import Mapping

ROOT = Path(__file__).resolve().parents[2]
FILES = [*sorted((ROOT / "configs").glob("*.yaml")), ROOT / "tests/config/good/full.yaml"]

MAIN = """
version: 1
include:
  - {file: more/part.yaml}
environment: {SAID: "${env:WORD}"}
nodes:
  - {name: one, command: [run, "${arg:mode:-slow}"], parameters: [values.yaml]}
"""
PART = """
version: 1
nodes:
  - {name: two, command: [walk, "${env:NOT_SET_ANYWHERE:-none}"]}
"""
VALUES = "one: {ros__parameters: {rate: 2.5}}\n"


def sent(values: Mapping[str, Any]) -> Any:
    return json.loads(json.dumps(values))


def same(one: Any, other: Any) -> bool:
    """Whether two descriptions are alike but for the folder from which a path begins."""
    return json.dumps(one).replace(f"{Path.cwd()}/", "") == json.dumps(other).replace(
        f"{Path.cwd()}/", ""
    )


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_what_comes_out_is_what_went_in(path: Path) -> None:
    config = load_config(path)
    assert describe(unbundled(sent(bundled(config)))) == describe(config)


def test_files_and_environment_of_here_do_not_matter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "more").mkdir()
    (tmp_path / "main.yaml").write_text(MAIN, encoding="utf-8")
    (tmp_path / "more/part.yaml").write_text(PART, encoding="utf-8")
    (tmp_path / "values.yaml").write_text(VALUES, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("WORD", "hello")
    config = load_config(Path("main.yaml"), Surroundings(arguments={"mode": "fast"}))
    values = sent(bundled(config))
    expected = describe(config)
    monkeypatch.setenv("WORD", "something else")
    monkeypatch.setenv("NOT_SET_ANYWHERE", "set")
    for name in ("main.yaml", "more/part.yaml", "values.yaml"):
        (tmp_path / name).unlink()
    found = unbundled(values)
    assert same(describe(found), expected)
    one = next(node for node in found.nodes if node.name == "one")
    assert one.command == ("run", "fast")
    assert one.environment["SAID"] == "hello"
    monkeypatch.chdir("/")
    assert describe(unbundled(values))["nodes"] == describe(found)["nodes"]


@pytest.mark.parametrize("values", [None, [], {}, {"source": {"path": 1, "text": ""}}, "text"])
def test_anything_else_is_refused(values: object) -> None:
    with pytest.raises(ValueError, match=r".+"):
        unbundled(values)


def test_a_file_that_was_not_sent_is_not_read_here(tmp_path: Path) -> None:
    (tmp_path / "values.yaml").write_text(VALUES, encoding="utf-8")
    main = tmp_path / "main.yaml"
    main.write_text(
        "version: 1\nnodes: [{name: one, command: [run], parameters: [values.yaml]}]\n",
        encoding="utf-8",
    )
    values = sent(bundled(load_config(main)))
    values["files"] = []
    with pytest.raises(ConfigError, match="not among the files"):
        unbundled(values)

"""Every file of the corpus is refused, each problem at its place, with nothing missing."""

from __future__ import annotations

from pathlib import Path

import pytest

from play_launch.config.load import load_config, parse_config
from play_launch.config.problems import ConfigError

CORPUS = Path(__file__).parent / "corpus"


def expected_problems() -> dict[str, list[str]]:
    expected: dict[str, list[str]] = {}
    for line in (CORPUS / "expected.txt").read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            name, _, problem = line.partition(" | ")
            expected.setdefault(name, []).append(problem)
    return expected


EXPECTED = expected_problems()


def test_every_file_has_an_expectation() -> None:
    assert sorted(EXPECTED) == sorted(file.name for file in CORPUS.glob("*.yaml"))
    assert len(EXPECTED) >= 45


@pytest.mark.parametrize("name", sorted(EXPECTED))
def test_refused_with_every_problem_in_its_place(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(CORPUS)
    with pytest.raises(ConfigError) as caught:
        load_config(Path(name))
    found = str(caught.value).splitlines()
    assert len(found) == len(caught.value.problems) == len(EXPECTED[name])
    for line, beginning in zip(found, EXPECTED[name], strict=True):
        assert line.startswith(beginning), line


def test_all_problems_of_one_file_at_once() -> None:
    text = """\
version: 1
nmae: demo
containers:
  - name: 2main
    composable_nodes:
      - package: demo
        plugin: demo:Talker
        parameters: {a: [], b: [1, 2.0], c: yes}
        remappings: [chatter]
nodes:
  - command: [x]
    environment: {DEBUG: 1}
    emulate_tty: on
"""
    with pytest.raises(ConfigError) as caught:
        parse_config(text.encode(), Path("demo.yaml"))
    assert [(one.line, one.column) for one in caught.value.problems] == [
        (2, 1),
        (4, 11),
        (7, 17),
        (8, 25),
        (8, 32),
        (8, 45),
        (9, 22),
        (12, 26),
        (13, 18),
    ]


def test_problems_of_the_configuration_stand_before_those_of_parameter_files(
    tmp_path: Path,
) -> None:
    (tmp_path / "a.yaml").write_text("/**: {ros__parameters: {x: [[]]}}\n")
    config = tmp_path / "z.yaml"
    config.write_text(
        "version: 1\nnodes:\n  - {command: [x], parameters: [a.yaml], log_level: x}\n"
    )
    with pytest.raises(ConfigError) as caught:
        load_config(config)
    assert [Path(one.file).name for one in caught.value.problems] == ["z.yaml", "a.yaml"]


def test_a_problem_in_a_shared_parameter_file_is_told_once(tmp_path: Path) -> None:
    (tmp_path / "shared.yaml").write_text("/**: {ros__parameters: {x: [[]]}}\n")
    config = tmp_path / "demo.yaml"
    node = "  - {command: [x], parameters: [shared.yaml]}\n"
    config.write_text("version: 1\nnodes:\n" + 3 * node)
    with pytest.raises(ConfigError) as caught:
        load_config(config)
    assert len(caught.value.problems) == 1


def test_a_line_of_the_report_stays_one_line(tmp_path: Path) -> None:
    config = tmp_path / "two\nlines.yaml"
    config.write_text('version: 1\nnodes:\n  - {command: [x], parameters: ["a\\nb.yaml"]}\n')
    with pytest.raises(ConfigError) as caught:
        load_config(config)
    assert r"two\nlines.yaml:3:33: nodes[0].parameters[0]" in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1

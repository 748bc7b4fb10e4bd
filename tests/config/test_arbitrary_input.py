"""Whatever is in the file: a configuration, or a ConfigError with places that exist."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from play_launch.config import schema as keys
from play_launch.config import sections
from play_launch.config.description import describe
from play_launch.config.load import parse_config
from play_launch.config.model import ReplayConfig
from play_launch.config.problems import ConfigError

SOURCE = Path("demo.yaml")
FULL = (Path(__file__).parent / "good" / "full.yaml").read_text(encoding="utf-8")
BAD = sorted((Path(__file__).parent / "corpus").glob("*.yaml"))

WORDS = sorted(
    {
        key
        for section in (
            keys.DocumentSection,
            keys.LoadingSection,
            sections.RestartSection,
            sections.BackoffSection,
            sections.StopSection,
            keys.ContainerSection,
            keys.ComposableNodeSection,
            keys.ProcessSection,
        )
        for key in section.keys
    }
)
SCALARS = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=6)
    | st.binary(max_size=4)
    | st.dates()
    | st.sampled_from(["1 s", "mt", "demo::Talker", "/a", "~/b", "a:=b", "info", "a.yaml", *WORDS])
)
TREES = st.recursive(
    SCALARS,
    lambda below: (
        st.lists(below, max_size=4)
        | st.dictionaries(st.sampled_from(WORDS) | st.text(max_size=4), below, max_size=6)
    ),
    max_leaves=20,
)
FRAGMENTS = st.sampled_from(
    [
        *WORDS,
        *("version: 1", ": ", "\n", "\n  ", "\n    ", "- ", "? ", "[", "]", "{", "}", ", ", "\t"),
        *("&a ", "*a", "<<: *a", "!!int ", "!!binary ", "!string_array ", "!x!y ", "!<%ff> "),
        *("|\n", ">-\n", "'", '"', "\\", "#", "---\n", "...\n", "%TAG ! x\n", "%YAML 1.2\n"),
        *(
            "1",
            "1.0",
            ".nan",
            "010",
            "yes",
            "~",
            "\0",
            "\ufeff",
            "\x85",
            "\u2028",
            "é",
            "\U0001f600",
        ),
    ]
)


def check(content: bytes) -> ReplayConfig | None:
    """Parse `content`; whatever is reported must be at a place in it and on one line."""
    report: ConfigError
    try:
        config = parse_config(content, SOURCE)
    except ConfigError as error:
        report = error
    else:
        describe(config)
        return config
    assert report.problems
    assert len(str(report).splitlines()) == len(report.problems)
    lines = content.decode("utf-8", "replace").splitlines()
    for problem in report.problems:
        assert str(problem).isprintable()
        assert problem.path
        assert problem.message
        assert problem.column >= 1
        if problem.file == str(SOURCE):
            assert 1 <= problem.line <= len(lines) + 1
    return None


@given(st.binary(max_size=200))
@example(b"\xef\xbb\xbf")
@example(b"\xff\xfe")
def test_bytes(content: bytes) -> None:
    check(content)


@given(st.text(max_size=200))
def test_text(text: str) -> None:
    check(text.encode("utf-8", "surrogatepass"))


@given(st.lists(FRAGMENTS, max_size=30).map("".join))
def test_pieces_of_yaml(text: str) -> None:
    check(text.encode())


@given(TREES)
def test_trees(tree: object) -> None:
    check(yaml.safe_dump(tree, allow_unicode=True).encode("utf-8", "surrogatepass"))


@given(
    st.fixed_dictionaries(
        {"version": st.just(1)},
        optional={
            "composable_node_loading": st.dictionaries(st.sampled_from(WORDS), TREES, max_size=4),
            "containers": st.lists(
                st.dictionaries(st.sampled_from(WORDS), TREES, max_size=6), max_size=3
            ),
            "nodes": st.lists(
                st.dictionaries(st.sampled_from(WORDS), TREES, max_size=6), max_size=3
            ),
        },
    )
)
def test_trees_of_the_right_shape(tree: object) -> None:
    check(yaml.safe_dump(tree).encode())


@given(st.integers(0, len(FULL)), st.integers(0, 5), FRAGMENTS | st.text(max_size=3))
def test_a_good_file_with_a_slip(at: int, dropped: int, inserted: str) -> None:
    check((FULL[:at] + inserted + FULL[at + dropped :]).encode("utf-8", "surrogatepass"))


@given(st.integers(0, len(FULL.encode())))
def test_a_good_file_cut_short(length: int) -> None:
    check(FULL.encode()[:length])


@pytest.mark.parametrize("file", BAD, ids=lambda file: file.stem)
def test_bad_files_under_another_name(file: Path) -> None:
    assert check(file.read_bytes()) is None

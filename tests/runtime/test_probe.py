from __future__ import annotations

import json

import pytest

from play_launch.runtime.probes import read_probe

LOADS = '{"library": "/x/libgood.so", "error": "", "signal": 0, "backtrace": []}'
DIED = json.dumps(
    {
        "library": "/x/libbad.so",
        "error": "cannot load library /x/libbad.so",
        "signal": 11,
        "backtrace": ["init() in libbad.so", "main"],
    }
)


def test_a_library_that_loads() -> None:
    found = read_probe(["hello from an initialiser", LOADS])
    assert found is not None
    assert (found.loads, found.library, found.error) == (True, "/x/libgood.so", "")


def test_one_that_crashes() -> None:
    found = read_probe([DIED], exit_code=1)
    assert found is not None
    assert (found.loads, found.signal, found.error) == (
        False,
        11,
        "cannot load library /x/libbad.so",
    )
    assert found.backtrace == ("init() in libbad.so", "main")


def test_one_that_cannot_be_loaded_says_nothing_about_the_other_components_of_its_library() -> None:
    told = '{"library": "/x/libgood.so", "error": "it has no a::B", "signal": 0, "backtrace": []}'
    found = read_probe([told], exit_code=1)
    assert found is not None
    assert (found.loads, found.signal) == (False, 0)


@pytest.mark.parametrize("lines", [[], ["{"], ["[1]"], ["{}"], ['{"signal": 11}'], ["17", "null"]])
def test_without_a_word_it_counts_as_dead(lines: list[str]) -> None:
    killed = read_probe(lines, signal=9)
    assert killed is not None
    assert (killed.loads, killed.signal) == (False, 9)
    assert "signal 9 (SIGKILL)" in killed.error
    left = read_probe(lines, exit_code=0)
    assert left is not None
    assert not left.loads
    assert "exited with status 0" in left.error


@pytest.mark.parametrize("cut", [4, 5, 7, 8, 10])
def test_a_line_that_was_cut_keeps_its_beginning(cut: int) -> None:
    found = read_probe([DIED[:-cut]], exit_code=1)
    assert found is not None
    assert (found.signal, found.backtrace) == (11, ("init() in libbad.so",))


def test_values_of_another_kind_are_passed_over() -> None:
    told = '{"library": 1, "error": null, "signal": "x", "backtrace": {"a": 1}}'
    found = read_probe([told], exit_code=1)
    assert found is not None
    assert (found.loads, found.library, found.signal, found.backtrace) == (False, "", 0, ())


@pytest.mark.parametrize("code", [64, 125, 126, 127])
def test_a_program_that_was_never_run_finds_nothing(code: int) -> None:
    assert read_probe([], exit_code=code) is None

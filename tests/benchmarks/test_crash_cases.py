"""The choice of trials."""

from __future__ import annotations

import pytest

from benchmarks.crash.cases import KINDS, MODES, QUIET, choose, plan


def test_kinds_are_chosen_by_pattern() -> None:
    assert choose(["*"]) == list(KINDS)
    assert len(KINDS) == len({kind.name for kind in KINDS}) == 21
    assert [kind.name for kind in choose(["kill/outside", "segv/c*"])] == [
        "segv/callback",
        "segv/constructor",
        "kill/outside",
    ]
    with pytest.raises(ValueError, match="'segv' matches none of"):
        choose(["segv/*", "segv"])


def test_the_plan_has_every_kind_in_every_mode() -> None:
    cases = list(plan(MODES, KINDS, choose(["*/outside"]), count=10))
    assert len({case.name for case in cases}) == len(cases)
    for mode in MODES:
        of_mode = [case for case in cases if case.mode == mode]
        assert of_mode[0].kind == QUIET
        assert {case.kind for case in of_mode if case.quiesced} == {QUIET, *KINDS}
        (unquiesced,) = (case for case in of_mode if not case.quiesced)
        assert (unquiesced.kind.name, unquiesced.count) == ("segv/outside", 2)

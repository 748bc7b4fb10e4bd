from __future__ import annotations

import resource

from hypothesis import given
from hypothesis import strategies as st

from play_launch.process.open_files import ENOUGH, higher

UNLIMITED = resource.RLIM_INFINITY
limits = st.integers(0, 4 * ENOUGH) | st.just(UNLIMITED)


@given(limits, limits)
def test_the_soft_limit_never_falls_and_keeps_to_the_hard_one(soft: int, hard: int) -> None:
    wanted = higher(soft, hard)
    if wanted is None:
        assert soft == UNLIMITED or soft >= ENOUGH or (hard != UNLIMITED and soft >= hard)
    else:
        assert soft < wanted <= ENOUGH
        assert hard == UNLIMITED or wanted <= hard

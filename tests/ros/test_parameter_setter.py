from __future__ import annotations

from typing import Any

import pytest

from play_launch.config.model import ParameterConfig, ParameterType, ParameterValue
from play_launch.ros import parameter_setter
from play_launch.ros.parameter_setter import ParameterSetter

pytestmark = pytest.mark.anyio

RATE = ParameterConfig("rate", ParameterValue(ParameterType.DOUBLE, 1.0))


async def test_a_domain_that_could_not_be_joined_is_joined_the_next_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As after a time in which /dev/shm was full."""
    failures = iter([OSError("no space"), LookupError("joined")])

    def start(_domain: int | None) -> Any:
        raise next(failures)

    monkeypatch.setattr(parameter_setter, "_start", start)
    setter = ParameterSetter()
    assert "no space" in await setter.set("/n", [RATE], {})
    assert "joined" in await setter.set("/n", [RATE], {})
    await setter.close()

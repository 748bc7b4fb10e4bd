from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.control_groups import control_group


@pytest.fixture
def base() -> Iterator[Path]:
    with control_group() as path:
        yield path

"""Hosts that the tests of one file share."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.support.hosts import Hosts

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture(scope="module")
def net(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hosts]:
    with Hosts(tmp_path_factory.mktemp("hosts"), 3) as made:
        yield made

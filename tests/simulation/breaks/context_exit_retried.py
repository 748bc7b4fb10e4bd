"""A container is started again whose context a node shut down."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.supervisor import process_rules
from tests.simulation.rewriting import rewrite

if TYPE_CHECKING:
    import pytest

FOUND_BY: Final = "what cannot succeed is not tried again"


def apply(patch: pytest.MonkeyPatch) -> None:
    rewrite(patch, process_rules._container_exited, "exit_.code == CONTEXT_EXIT_CODE", "False")

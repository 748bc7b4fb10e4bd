"""Containers in each of the four modes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.support.isolated import MODES as ISOLATED_MODES
from tests.support.isolated import allocator_environment

if TYPE_CHECKING:
    from collections.abc import Mapping

    from tests.support.control_peer import Container, StartContainer

MODES = {"standard": (), "mt": ("--use_multi_threaded_executor",), **ISOLATED_MODES}


def start(
    spawn: StartContainer,
    mode: str,
    *arguments: str,
    environment: Mapping[str, str] | None = None,
) -> Container:
    """A container in that mode, with the allocator that isolated modes should have."""
    allocator = allocator_environment() if mode in ISOLATED_MODES else {}
    return spawn(*MODES[mode], *arguments, environment={**allocator, **(environment or {})})

"""Containers in each of the four modes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.support.isolated import MODES as ISOLATED_MODES
from tests.support.isolated import allocator_environment

if TYPE_CHECKING:
    from tests.support.control_peer import Container, StartContainer

MODES = {"standard": (), "mt": ("--use_multi_threaded_executor",), **ISOLATED_MODES}


def start(spawn: StartContainer, mode: str, *arguments: str) -> Container:
    """A container in that mode, with the allocator that isolated modes should have."""
    environment = allocator_environment() if mode in ISOLATED_MODES else {}
    return spawn(*MODES[mode], *arguments, environment=environment)

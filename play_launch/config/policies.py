"""Policies of the configuration: what follows from exits and crashes, and how often."""

from __future__ import annotations

from enum import StrEnum

from msgspec import Struct


class OnExit(StrEnum):
    """Consequence of the exit of an ordinary process: ``on_exit``."""

    IGNORE = "ignore"
    RESTART = "restart"
    SHUTDOWN = "shutdown"


class RestartLimits(Struct, frozen=True):
    """How often something is started again: at most `max_restarts` times `within` seconds."""

    max_restarts: int = 5
    within: float = 60.0
    """Length of the window in seconds; also how long a life is healthy."""
    initial: float = 0.1
    """First pause in seconds."""
    maximum: float = 30.0
    """Longest pause in seconds."""
    first_at_once: bool = False
    """Whether the first restart after a healthy life comes without a pause."""


class OnCrash(StrEnum):
    """What follows when a node of an isolated container crashes: ``on_crash``."""

    RELOAD = "reload"
    IGNORE = "ignore"
    STOP_CONTAINER = "stop_container"
    SHUTDOWN = "shutdown"


class Autostart(StrEnum):
    """State that a managed node is brought to: ``autostart``."""

    CONFIGURE = "configure"
    ACTIVATE = "activate"

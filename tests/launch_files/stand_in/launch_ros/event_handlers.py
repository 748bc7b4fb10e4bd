"""Handlers of states."""

from __future__ import annotations


class OnStateTransition:
    pass

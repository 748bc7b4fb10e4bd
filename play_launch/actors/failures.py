"""How an unexpected exception in the supervisor's own code is reported."""

from __future__ import annotations


def failure_reason(error: Exception) -> str:
    """Name an unexpected exception in one line; of a group, the first one."""
    while isinstance(error, ExceptionGroup):
        error = error.exceptions[0]
    text = " ".join(f"{type(error).__name__}: {error}".split())
    return f"internal error (its call stack is in the recording): {text}"

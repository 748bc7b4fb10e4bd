"""How a call is printed before it is made."""

from collections.abc import Callable
from typing import Any


def pretty_print_call(function: Any, *arguments: Any) -> None:
    """Print a call."""
    print("called:", function.__name__, *arguments)


def before_invocation(function: Any, hook: Callable[..., None]) -> Any:
    """Call ``hook`` first."""

    def wrapper(*arguments: Any) -> Any:
        hook(function, *arguments)
        return function(*arguments)

    wrapper.__name__ = function.__name__
    return wrapper

"""Types of attributes and parameters: the rules of launch's `type_utils`, on top of YAML 1.1."""

from __future__ import annotations

from typing import Any, Final

import yaml

from play_launch.launch_files.markup.trouble import Trouble

SCALARS: Final = (bool, int, float, str)
TYPES: Final[dict[str, tuple[type, bool] | None]] = {
    "str": (str, False),
    "bool": (bool, False),
    "float": (float, False),
    "int": (int, False),
    "list_of_str": (str, True),
    "list_of_bool": (bool, True),
    "list_of_float": (float, True),
    "list_of_int": (int, True),
    "yaml": None,
}
"""What the attribute `type` of a parameter can be: the type, and whether it is a list of it."""


def is_allowed(value: Any, *, can_be_text: bool = False) -> bool:
    """Whether a value is a scalar or a list of scalars of one type (texts among them if so)."""
    if not isinstance(value, list):
        return isinstance(value, SCALARS)
    if not value:
        return True
    kind = next((type(each) for each in value if type(each) is not str), str)
    if kind not in SCALARS:
        return False
    kinds = (kind, str) if can_be_text else (kind,)
    return all(isinstance(each, kinds) for each in value)


def by_yaml(text: str, *, can_be_text: bool = False) -> Any:
    """Return what YAML 1.1 makes of a text; it must be a scalar or a list of scalars."""
    if not text:
        return text
    try:
        value = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        if can_be_text:
            return text
        raise Trouble(f"{text!r} is not YAML") from error
    if not is_allowed(value, can_be_text=can_be_text):
        raise Trouble(f"{text!r} is neither a value nor a list of values of one type")
    return value


def coerced(text: str, kind: tuple[type, bool] | None, *, can_be_text: bool = False) -> Any:
    """Return a text as a value of a type; with `can_be_text` it may stay one."""
    if kind is None:
        return by_yaml(text, can_be_text=can_be_text)
    wanted, is_list = kind
    allowed = (str, wanted) if can_be_text else (wanted,)
    if is_list:
        value = by_yaml(text, can_be_text=can_be_text)
        if not isinstance(value, list) or not all(isinstance(each, allowed) for each in value):
            raise Trouble(f"{text!r} is no list of {wanted.__name__}")
        return value
    if wanted is str:
        return text
    if wanted in (int, float):
        try:
            return wanted(text)
        except ValueError as error:
            if can_be_text:
                return text
            raise Trouble(f"{text!r} is no {wanted.__name__}") from error
    value = by_yaml({"1": "true", "0": "false"}.get(text, text), can_be_text=can_be_text)
    if not isinstance(value, allowed):
        raise Trouble(f"{text!r} is neither true nor false")
    return value


def truth(text: str) -> bool:
    """Return a text as a truth value, by the rules for typed substitutions."""
    return bool(coerced(text, (bool, False)))


def condition(text: str) -> bool:
    """Return a text as a condition, by the rules of `if` and `unless`."""
    value = text.strip().lower()
    if value in ("true", "1"):
        return True
    if value in ("false", "0"):
        return False
    raise Trouble(f"{text!r} is no condition; it must be true, false, 1 or 0")


def uniform(values: list[Any], name: str) -> tuple[Any, ...]:
    """Return a list of values of one type, as launch_ros wants those of global parameters."""
    kind = type(values[0]) if values else None
    if kind not in SCALARS or not all(isinstance(each, kind) for each in values):
        raise Trouble(f"the parameter {name} is no list of values of one type")
    return tuple(values)

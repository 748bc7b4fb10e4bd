"""`$(eval ...)`: expressions of Python, evaluated without running any code of theirs.

What launch files use is understood: literals, arithmetic, comparisons, `and`, `or`, `not`, `if`,
indexing, functions and methods of numbers and texts, and the module math.
"""

from __future__ import annotations

import ast
import math
import operator
from typing import TYPE_CHECKING, Any, Final

from play_launch.launch_files.markup.trouble import Trouble

if TYPE_CHECKING:
    from collections.abc import Callable

LONGEST: Final = 20_000
"""Characters of an expression."""
_LARGEST: Final = 1_000_000
"""Elements or characters of a result, digits of a number."""
_BINARY: Final[dict[type[ast.operator], Callable[[Any, Any], Any]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
    ast.BitXor: operator.xor,
    ast.Pow: operator.pow,
}
_UNARY: Final[dict[type[ast.unaryop], Callable[[Any], Any]]] = {
    ast.Not: operator.not_,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Invert: operator.invert,
}
_COMPARE: Final[dict[type[ast.cmpop], Callable[[Any, Any], Any]]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda one, other: one in other,
    ast.NotIn: lambda one, other: one not in other,
}
_MATH: Final = {name: each for name, each in vars(math).items() if not name.startswith("_")}
_SLOW: Final = frozenset({"factorial", "comb", "perm", "prod"})
_FUNCTIONS: Final[dict[str, Any]] = (
    {name: each for name, each in _MATH.items() if name not in _SLOW}
    | {
        each.__name__: each
        for each in (abs, all, any, bool, float, int, len, list, max, min, round, set, sorted, str)
    }
    | {"sum": sum, "tuple": tuple}
)
_METHODS: Final = frozenset(
    "lower upper strip lstrip rstrip split rsplit startswith endswith replace join count find "  # noqa: SIM905
    "title capitalize isdigit isalpha removeprefix removesuffix index get keys values".split()
)


def evaluate(text: str) -> str:
    """Return the result as text.

    Raises:
        Trouble: When it is no expression, fails, or needs more than what is understood here.
    """
    if len(text) > LONGEST:
        raise Trouble(f"an expression of {len(text)} characters; at most {LONGEST}")
    try:
        tree = ast.parse(text.strip(), mode="eval")
        return str(_bounded(_value(tree.body)))
    except Trouble as error:
        raise Trouble(f"$(eval {text!r}): {error}") from error
    except (SyntaxError, RecursionError, MemoryError) as error:
        raise Trouble(f"$(eval {text!r}): {getattr(error, 'msg', 'too deeply nested')}") from error
    except Exception as error:
        raise Trouble(f"$(eval {text!r}): {type(error).__name__}: {error}") from error


def _value(node: ast.expr) -> Any:
    match node:
        case ast.Constant():
            return node.value
        case ast.Name():
            return _named(node.id)
        case ast.Attribute(value=ast.Name(id="math")):
            return _named(node.attr) if node.attr in _MATH else _refuse(node)
        case ast.UnaryOp():
            return _UNARY[type(node.op)](_value(node.operand))
        case ast.BinOp():
            return _binary(node)
        case ast.BoolOp():
            return _bool(node)
        case ast.Compare():
            return _compare(node)
        case ast.IfExp():
            return _value(node.body) if _value(node.test) else _value(node.orelse)
        case ast.List() | ast.Tuple() | ast.Set():
            items = [_value(each) for each in node.elts]
            kind = {ast.List: list, ast.Tuple: tuple, ast.Set: set}[type(node)]
            return kind(items)
        case ast.Dict():
            keys = [_refuse(node) if each is None else _value(each) for each in node.keys]
            return dict(zip(keys, map(_value, node.values), strict=True))
        case ast.Subscript(slice=ast.Slice() as part):
            ends = (part.lower, part.upper, part.step)
            return _value(node.value)[slice(*(None if e is None else _value(e) for e in ends))]
        case ast.Subscript():
            return _value(node.value)[_value(node.slice)]
        case ast.Call():
            return _call(node)
    return _refuse(node)


def _named(name: str) -> Any:
    if name not in _FUNCTIONS:
        raise Trouble(f"{name} is not defined here")
    return _FUNCTIONS[name]


def _binary(node: ast.BinOp) -> Any:
    function = _BINARY.get(type(node.op))
    if function is None:
        _refuse(node)
        return None
    one, other = _value(node.left), _value(node.right)
    if isinstance(node.op, ast.Pow) and isinstance(one, int) and isinstance(other, int):
        if other > 0 and abs(one).bit_length() * other > _LARGEST:
            raise Trouble("the number is too large")
    elif isinstance(node.op, ast.Mult):
        for sequence, count in ((one, other), (other, one)):
            is_repeated = isinstance(sequence, str | list | tuple) and isinstance(count, int)
            if is_repeated and len(sequence) * count > _LARGEST:
                raise Trouble("the text is too long")
    elif isinstance(node.op, ast.Mod) and isinstance(one, str):
        raise Trouble("% for texts is not understood here")
    return _bounded(function(one, other))


def _bool(node: ast.BoolOp) -> Any:
    is_and = isinstance(node.op, ast.And)
    value: Any = is_and
    for each in node.values:
        value = _value(each)
        if bool(value) is not is_and:
            break
    return value


def _compare(node: ast.Compare) -> bool:
    left = _value(node.left)
    for op, right_node in zip(node.ops, node.comparators, strict=True):
        right = _value(right_node)
        if not _COMPARE[type(op)](left, right):
            return False
        left = right
    return True


def _call(node: ast.Call) -> Any:
    if node.keywords or any(isinstance(each, ast.Starred) for each in node.args):
        _refuse(node)
    arguments = [_value(each) for each in node.args]
    function = node.func
    if isinstance(function, ast.Attribute) and not (
        isinstance(function.value, ast.Name) and function.value.id == "math"
    ):
        receiver = _value(function.value)
        if function.attr not in _METHODS or not isinstance(receiver, str | list | tuple | dict):
            _refuse(node)
        if function.attr in ("replace", "join") and _size([receiver, *arguments]) > _LARGEST // 100:
            raise Trouble("the text is too long")
        return _bounded(getattr(receiver, function.attr)(*arguments))
    return _bounded(_value(function)(*arguments))


def _size(values: list[Any]) -> int:
    return sum(len(each) if hasattr(each, "__len__") else 1 for each in values)


def _bounded(value: Any) -> Any:
    if isinstance(value, int) and value.bit_length() > 10_000:
        raise Trouble("the number is too large")
    if isinstance(value, str | list | tuple | set | dict) and len(value) > _LARGEST:
        raise Trouble("the result is too long")
    return value


def _refuse(node: ast.AST) -> Any:
    raise Trouble(f"{ast.unparse(node)} is not understood without ROS's launch")

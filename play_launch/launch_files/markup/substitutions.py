"""What substitutions such as `$(var name)` stand for."""

from __future__ import annotations

import math
import re
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Final

from play_launch.config.substitutions import ament_prefixes
from play_launch.launch_files.log_folder import log_folder
from play_launch.launch_files.markup import expression
from play_launch.launch_files.markup.run_command import run_command
from play_launch.launch_files.markup.trouble import Trouble
from play_launch.launch_files.markup.typing_rules import truth
from play_launch.launch_files.reading import UnreadableError, text_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.launch_files.markup.context import Context
    from play_launch.launch_files.markup.template import Call

    Function = Callable[[Context, list[str]], str]

_NO_NAME: Final = re.compile(r"[^A-Za-z0-9_]")


def carry_out(call: Call, context: Context) -> str:
    """Return what a substitution stands for.

    Raises:
        Trouble: When it fails, or is unknown.
    """
    if call.name == "if":
        return _if(call, context)
    if call.name == "var" and len(call.arguments) == 2:
        name = context.carried_out(call.arguments[0])
        # The default is evaluated only where it is needed.
        if name in context.configurations:
            return str(context.configurations[name])
        return context.carried_out(call.arguments[1])
    if call.name not in _FUNCTIONS:
        raise Trouble(f"launch has no substitution $({call.name})")
    function, fewest, most = _FUNCTIONS[call.name]
    if not fewest <= len(call.arguments) <= most:
        wanted = str(fewest) if fewest == most else f"{fewest} to {most}"
        given = len(call.arguments)
        raise Trouble(f"$({call.name}) takes {wanted} arguments, given {given}")
    return function(context, [context.carried_out(each) for each in call.arguments])


def _if(call: Call, context: Context) -> str:
    if len(call.arguments) not in (2, 3):
        raise Trouble(f"$(if) takes 2 to 3 arguments, given {len(call.arguments)}")
    if truth(context.carried_out(call.arguments[0])):
        return context.carried_out(call.arguments[1])
    return context.carried_out(call.arguments[2]) if len(call.arguments) == 3 else ""


def _var(context: Context, arguments: list[str]) -> str:
    if arguments[0] not in context.configurations:
        raise Trouble(f"there is no launch argument or variable {arguments[0]}")
    return str(context.configurations[arguments[0]])


def _env(context: Context, arguments: list[str]) -> str:
    if arguments[0] in context.environment:
        return context.environment[arguments[0]]
    if len(arguments) == 2:
        return arguments[1]
    raise Trouble(f"the environment variable {arguments[0]} is not set")


def _share(context: Context, arguments: list[str]) -> str:
    folder = context.find_share(arguments[0])
    if folder is None:
        prefixes = ", ".join(map(str, ament_prefixes(context.environment))) or "none"
        raise Trouble(
            f"no package {arguments[0]} is installed; prefixes in AMENT_PREFIX_PATH: {prefixes}; "
            "source its workspace"
        )
    return str(folder)


def _prefix(context: Context, arguments: list[str]) -> str:
    return str(Path(_share(context, arguments)).parent.parent)


def executable_in_package(context: Context, arguments: list[str]) -> str:
    """Return the path of an executable of a package, which are given in this order."""
    program, package = arguments
    folder = Path(_prefix(context, [package])) / "lib" / package
    found = shutil.which(program, path=str(folder))
    if found is None:
        raise Trouble(f"there is no executable {program} in {folder}")
    return found


def _on_path(context: Context, arguments: list[str]) -> str:
    found = shutil.which(arguments[0], path=context.environment.get("PATH"))
    if found is None:
        raise Trouble(f"there is no executable {arguments[0]} in PATH")
    return found


def _file_content(_: Context, arguments: list[str]) -> str:
    try:
        return text_of(arguments[0])
    except UnreadableError as error:
        raise Trouble(f"the file {arguments[0]}: {error}") from error


def _eval(_: Context, arguments: list[str]) -> str:
    modules = {
        each.strip() for each in (arguments[1] if len(arguments) == 2 else "math").split(",")
    }
    if modules - {"math"}:
        raise Trouble(f"modules in $(eval) are not understood without ROS's launch: {modules}")
    return expression.evaluate(arguments[0])


def _anonymous(context: Context, arguments: list[str]) -> str:
    key = f"anon{arguments[0]}"
    if key not in context.configurations:
        # Random in ROS, and another one at each start: a configuration needs one that stays.
        name = f"{_NO_NAME.sub('_', arguments[0])}_anonymous"
        context.configurations[key] = name
        context.losses.note("(names)", f"the anonymous name {arguments[0]} is always {name}")
    return str(context.configurations[key])


def _parameter(context: Context, arguments: list[str]) -> str:
    for each in context.configurations.get("global_params", []):
        if isinstance(each, tuple) and each[0] == arguments[0]:
            return str(each[1])
    if len(arguments) == 2:
        return arguments[1]
    raise Trouble(f"no parameter {arguments[0]} was set for all nodes")


def _log_dir(context: Context, _: list[str]) -> str:
    # Whatever the launch file has set since then.
    return log_folder(context.initial_environment)


def _equal(one: str, other: str) -> bool:
    words = ("true", "false", "1", "0")
    if one.lower() in words and other.lower() in words:
        return (one.lower() in ("true", "1")) == (other.lower() in ("true", "1"))
    try:
        return math.isclose(float(one), float(other))
    except ValueError:
        return one == other


def _truths(texts: list[str]) -> list[bool]:
    """Return all truth values: each must be one, also where the first ones decide."""
    return [truth(each) for each in texts]


def _said(value: bool) -> str:
    return "true" if value else "false"


_ANY_NUMBER: Final = 1000
_FUNCTIONS: Final[dict[str, tuple[Function, int, int]]] = {
    "var": (_var, 1, 1),
    "env": (_env, 1, 2),
    "find-pkg-share": (_share, 1, 1),
    "find-pkg-prefix": (_prefix, 1, 1),
    "exec-in-pkg": (executable_in_package, 2, 2),
    "find-exec": (_on_path, 1, 1),
    "file-content": (_file_content, 1, 1),
    "command": (run_command, 1, 2),
    "eval": (_eval, 1, 2),
    "anon": (_anonymous, 1, 1),
    "param": (_parameter, 1, 2),
    "dirname": (lambda context, _: context.directory, 0, 0),
    "filename": (lambda context, _: context.file, 0, 0),
    "log_dir": (_log_dir, 0, 0),
    "launch_log_dir": (_log_dir, 0, 0),
    "not": (lambda _, given: _said(not truth(given[0])), 1, 1),
    "and": (lambda _, given: _said(all(_truths(given))), 2, 2),
    "or": (lambda _, given: _said(any(_truths(given))), 2, 2),
    "all": (lambda _, given: _said(all(_truths(given))), 0, _ANY_NUMBER),
    "any": (lambda _, given: _said(any(_truths(given))), 0, _ANY_NUMBER),
    "equals": (lambda _, given: _said(_equal(*given)), 2, 2),
    "not-equals": (lambda _, given: _said(not _equal(*given)), 2, 2),
}

"""Says what is wrong with text that is not YAML, in words for people who write launch files."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from play_launch.config.problems import Place, excerpt

if TYPE_CHECKING:
    import yaml

_INDENTATION_TAB = re.compile(r"[ \-?:]*\t")
_MOST_DIRECTIVES = 3
_FIXES = (
    ("mapping values are not allowed", 'quote text that holds ": ", or check the indentation'),
    ("found character that cannot start any token", "put the text in quotes"),
    ("found unexpected end of stream", "a quotation mark is not closed"),
    ("did not find expected key", "check the indentation of this line and the one before"),
    ("did not find expected '-' indicator", "a list goes on with `- `; check the indentation"),
    ("did not find expected ',' or", "a bracket is not closed or a comma is missing"),
    ("did not find expected <document start>", "only one value may stand at the top"),
    ("did not find expected node content", "a value is missing before this"),
    ("could not find expected ':'", "a key needs a colon and a space after it"),
    ("found undefined tag handle", "write the value without the tag"),
    ("incompatible YAML document", "leave the %YAML line out"),
)


def explain(error: yaml.YAMLError, text: str, file: str) -> tuple[Place, str]:
    """Return place and message for the parser's `error` in `text`."""
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    if mark is None:
        return Place(file, 1, 1), f"is not YAML: {excerpt(str(error))[1:-1]}"
    tab = _tab_in_indentation(text, mark.line)
    if tab is not None:
        return Place(file, mark.line + 1, tab + 1), "a tab cannot indent YAML; use spaces"
    problem = getattr(error, "problem", None) or getattr(error, "context", None) or "not YAML"
    message = str(problem)
    context = getattr(error, "context", None)
    begin = getattr(error, "context_mark", None)
    if context and context != problem:
        message += f" {context}"
        if begin is not None and (begin.line, begin.column) != (mark.line, mark.column):
            message += f" that begins at {begin.line + 1}:{begin.column + 1}"
    fix = next((advice for symptom, advice in _FIXES if symptom in message), None)
    if fix is not None:
        message += f"; {fix}"
    return Place(file, mark.line + 1, mark.column + 1), message


def refused_directive(text: str, file: str) -> tuple[Place, str] | None:
    """Find the directive that is one too many; the parser's time grows with their square."""
    for index, found in enumerate(re.finditer(r"^%", text, re.MULTILINE)):
        if index >= _MOST_DIRECTIVES:
            line = text.count("\n", 0, found.start()) + 1
            return Place(file, line, 1), f"more than {_MOST_DIRECTIVES} directives (lines with %)"
    return None


def _tab_in_indentation(text: str, line: int) -> int | None:
    lines = text.splitlines()
    if line >= len(lines):
        return None
    found = _INDENTATION_TAB.match(lines[line])
    return None if found is None else found.end() - 1

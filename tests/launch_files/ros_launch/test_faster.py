"""What the evaluation does in place of launch, beside launch itself."""

from __future__ import annotations

import random

import pytest

from tests.launch_files.ros_launch.prefix import needs_launch

pytestmark = needs_launch

PIECES = (
    "$(var x)",
    "$(",
    "$",
    ")",
    "(",
    " ",
    "  ",
    "'",
    '"',
    "a",
    "-1.5",
    "/",
    "$(env HOME ",
    "$(eval ",
    "$(var 'a b')",
    "$(dirname)",
    "$(anon",
    "\n",
    "\t",
    "\u00e9",
    "==",
    "$(no-such x)",
)


def described(parts: object) -> object:
    """Return what substitutions are made of, all the way down."""
    if isinstance(parts, list | tuple):
        return [described(each) for each in parts]
    if type(parts).__module__.startswith("launch"):
        return type(parts), {name: described(value) for name, value in vars(parts).items()}
    return parts


@pytest.mark.parametrize("seed", range(4))
def test_texts_become_the_substitutions_of_launch(seed: int) -> None:
    """Where our parser answers, launch's gives the same; all else is left to that one."""
    from launch.frontend.parse_substitution import parse_substitution
    from launch.frontend.parser import Parser

    from play_launch.launch_files.ros_launch import faster

    Parser.load_launch_extensions()
    chance = random.Random(seed)
    answered = 0
    for _ in range(400):
        text = "".join(chance.choices(PIECES, k=chance.randint(1, 7)))
        text += chance.choice(("", ")", "')", '")'))
        found = faster.parsed(text)
        if found:
            answered += 1
            assert described(found) == described(parse_substitution(text)), text
    assert answered

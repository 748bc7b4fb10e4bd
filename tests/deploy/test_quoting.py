"""Words of a unit: what systemd reads is what was meant."""

from __future__ import annotations

import re

from hypothesis import given
from hypothesis import strategies as st

from play_launch.deploy.quoting import argument, is_acceptable, quoted, specified

TEXTS = st.text(
    st.one_of(st.sampled_from("ab %$\\\"'\n\t;#{}=/-"), st.characters(codec="utf-8"))
).filter(is_acceptable)
_ESCAPES = {"\\\\": "\\", '\\"': '"', "\\n": "\n", "\\t": "\t"}


def read(word: str, *, of_a_command: bool = False) -> str:
    """As systemd does: quotes, then specifiers, then variables."""
    if word.startswith('"'):
        assert word.endswith('"')
        assert len(word) > 1
        inner = word[1:-1]
        assert re.fullmatch(r'([^"\\\n]|\\[\\"nt])*', inner), inner
        word = re.sub(r"\\.", lambda match: _ESCAPES[match[0]], inner)
    else:
        assert re.fullmatch(r"[^\s\"'\\]+", word), word
    assert re.fullmatch(r"([^%]|%%)*", word), word
    word = word.replace("%%", "%")
    if of_a_command:
        assert re.fullmatch(r"([^$]|\$\$)*", word), word
        word = word.replace("$$", "$")
    return word


@given(TEXTS)
def test_what_is_read_is_what_was_written(text: str) -> None:
    assert read(quoted(text)) == text
    assert read(argument(text), of_a_command=True) == text
    assert specified(text).replace("%%", "%") == text


@given(st.text(max_size=20))
def test_words_stay_in_their_line(text: str) -> None:
    assert "\n" not in argument(text)
    assert argument(text)


def test_what_systemd_refuses_is_known() -> None:
    assert is_acceptable("a\tb\nc ä")
    for text in ("\0", "\x07", "\x7f", "\udc80"):
        assert not is_acceptable(text)

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from play_launch.recording.errors import SchemaNotFoundError
from play_launch.recording.topics import ALL_TOPICS, message_definition

if TYPE_CHECKING:
    from pathlib import Path

SEPARATOR = "=" * 80 + "\n"


def define(prefix: Path, type_name: str, text: str) -> None:
    package, _, name = type_name.split("/")
    folder = prefix / "share" / package / "msg"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.msg").write_text(text, encoding="utf-8")


def test_a_definition_carries_what_it_uses_once_and_the_top_first(tmp_path: Path) -> None:
    define(
        tmp_path,
        "a/msg/Top",
        "# Comment/With a slash\nb/Inner[] many\nInner near\nb/msg/Inner one # b/Unused x\n"
        'string<=10 name\nfloat64[<=3] values\nuint8 KIND=1\nstring words "Fake other"\n',
    )
    define(tmp_path, "a/msg/Inner", "int32 x")
    define(tmp_path, "b/msg/Inner", "builtin_interfaces/Time[2] stamps\n")
    define(tmp_path, "builtin_interfaces/msg/Time", "int32 sec\nuint32 nanosec\n")

    parts = message_definition("a/msg/Top", (tmp_path,)).split(SEPARATOR)

    assert parts[0].startswith("# Comment/With a slash")
    assert [part.splitlines()[0] for part in parts[1:]] == [
        "MSG: b/Inner",
        "MSG: a/Inner",
        "MSG: builtin_interfaces/Time",
    ]
    assert parts[2] == "MSG: a/Inner\nint32 x\n"


def test_an_overlay_goes_before_what_lies_under_it(tmp_path: Path) -> None:
    define(tmp_path / "under", "a/msg/Top", "int32 old\n")
    define(tmp_path / "over", "a/msg/Top", "int32 new\n")
    assert message_definition("a/msg/Top", (tmp_path / "over", tmp_path / "under")) == "int32 new\n"


def test_a_missing_definition_is_named(tmp_path: Path) -> None:
    define(tmp_path, "a/msg/Top", "b/Gone x\n")
    with pytest.raises(SchemaNotFoundError, match="definition b/msg/Gone is not installed"):
        message_definition("a/msg/Top", (tmp_path,))
    with pytest.raises(SchemaNotFoundError, match="a/action/Go_FeedbackMessage is that of an act"):
        message_definition("a/action/Go_FeedbackMessage", (tmp_path,))


@pytest.mark.parametrize("type_name", sorted({topic.type_name for topic in ALL_TOPICS}))
def test_the_types_that_are_recorded_are_installed(type_name: str) -> None:
    text = message_definition(type_name)
    assert "MSG: builtin_interfaces/Time" in text

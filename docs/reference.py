"""Adds pages that are made from sources: the help of all commands, and the headers of the SDK."""

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

from play_launch.cli.manual import manual_as

HEADERS = Path(__file__).parents[1] / "container_native" / "include" / "play_launch"
MACRO = r"(?m)((?:^///.*\n)*)^(#define PLAY_LAUNCH_(?!DETAIL)\w+\([^)]*\))"
LEFT_OUT = (  # what is private, bodies, initialisers, names alone
    (r"(?ms)^namespace detail \{.*?^\}  // namespace detail\n", ""),
    (r"(?ms)^ (?:private|protected):\n.*?(?=^(?: public:|};))", ""),
    (r"(?m)\n      : [^;]*?\{\}$", ";"),
    (r"(?m) \{\n(?:    .*\n|\n)*?  \}$", ";"),
    (r"(?m)(\)(?: const)?(?: noexcept)?) \{ .* \}$", r"\1;"),
    (r"\n      : [^;]*;", ";"),
    (r"(?m)^(?:class \w+;|.* = delete;)\n", ""),
    (r"\n\n(?=\n|\};)", "\n"),
)


def on_files(files: Files, config: Any) -> Files:
    for name, content in (("commands.md", manual_as("markdown")), ("sdk.md", sdk())):
        files.append(File.generated(config, name, content=content))
    return files


def sdk() -> str:
    declared = {each.name: declarations(each.read_text("utf-8")) for each in HEADERS.glob("*.hpp")}
    parts = [
        f"## {name}\n\n```cpp\n{text}\n```\n" for name, text in sorted(declared.items()) if text
    ]
    return "\n".join(["# The headers of the SDK\n", *parts])


def declarations(text: str) -> str:
    macros = ["".join(each) for each in re.findall(MACRO, text)]
    text = text.partition("namespace play_launch {\n")[2]
    text = text.rpartition("}  // namespace play_launch")[0]
    for pattern, instead in LEFT_OUT:
        text = re.sub(pattern, instead, text)
    return "\n".join([text.strip(), *macros]).strip()

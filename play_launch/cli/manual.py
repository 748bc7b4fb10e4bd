"""``play-launch manual``: the help of all commands, as text, manual page (roff) or Markdown."""

from __future__ import annotations

import importlib.metadata
import re
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import typer

from play_launch import ExitCode
from play_launch.cli.output import say

if TYPE_CHECKING:
    from collections.abc import Iterator

Format = Literal["text", "man", "markdown"]
_WIDTH: Final = 80


def manual(
    form: Annotated[
        Format,
        typer.Option(
            "--format",
            metavar="FORMAT",
            show_default=False,
            help="text (default), man (roff, for man(1)) or markdown.",
        ),
    ] = "text",
) -> ExitCode:
    """Print the help of all commands.

    \b
    play-launch manual | less
    play-launch manual --format man > ~/.local/share/man/man1/play-launch.1
    """  # noqa: D301 - typer's mark of lines that stay as they are
    say(manual_as(form).removesuffix("\n"))
    return ExitCode.OK


def manual_as(form: Format) -> str:
    return _WRITERS[form](_help())


def _help() -> Iterator[tuple[str, str, str]]:
    """Each command in the order of the help: its group, its words (``param get``), its help."""
    from play_launch.cli.app import COMMANDS, app, command_of  # noqa: PLC0415 - imports this

    def walk(command: Any, words: str, parent: Any = None) -> Iterator[tuple[str, str]]:
        context = command.context_class(
            command,
            info_name=words.rpartition(" ")[2],
            parent=parent,
            terminal_width=_WIDTH,
            max_content_width=_WIDTH,
            **command.context_settings,
        )
        yield words, command.get_help(context)
        if parent:
            for name, part in getattr(command, "commands", {}).items():
                yield from walk(part, f"{words} {name}", context)
        else:
            for each in COMMANDS.values():
                yield from walk(command_of(each), each.name, context)

    groups = {each.name: each.group for each in COMMANDS.values()}
    for words, text in walk(typer.main.get_command(app), "play-launch"):
        yield groups.get(words.partition(" ")[0], ""), words, text


def _as_text(commands: Iterator[tuple[str, str, str]]) -> str:
    return f"\n{'-' * _WIDTH}\n".join(f"{text.rstrip()}\n" for _, _, text in commands)


def _as_markdown(commands: Iterator[tuple[str, str, str]]) -> str:
    lines, last = ["# Commands"], ""
    for group, words, text in commands:
        if group != last:
            lines.append(f"## {group}")
            last = group
        lines += [f"### {words}"] if group else []
        lines.append(f"```text\n{text.rstrip()}\n```")
    return "\n\n".join(lines) + "\n"


def _as_roff(commands: Iterator[tuple[str, str, str]]) -> str:
    version = importlib.metadata.version("play-launch-py")
    _, name, text = next(commands)
    _, _, rest = text.partition("\n\n")
    about, _, rest = rest.partition("\n\n")
    lines = [f'.TH PLAY\\-LAUNCH 1 "" "play\\-launch {version}" "User Commands"', ".SH NAME"]
    lines += [f"{_escaped(name)} \\- {_escaped(' '.join(about.split()))}", ".SH SYNOPSIS"]
    lines += [_escaped(f"{name} [OPTIONS] COMMAND [ARGS]..."), ".SH OVERVIEW", *_verbatim(rest)]
    last = ""
    for group, words, each in commands:
        if group != last:
            lines.append(f".SH {_escaped(group.upper())}")
            last = group
        lines += [f".SS {_escaped(words)}", *_verbatim(each)]
    return "\n".join(lines) + "\n"


def _verbatim(text: str) -> tuple[str, ...]:
    # Its lines have up to 80 columns.
    return ".in 0", ".nf", _escaped(text.rstrip()), ".fi", ".in"


def _escaped(text: str) -> str:
    """Escape what roff reads: backslashes, hyphens, and lines that begin with a dot or a quote."""
    text = text.replace("\\", "\\e").replace("-", "\\-")
    return re.sub(r"^([.'])", r"\\&\1", text, flags=re.MULTILINE)


_WRITERS: Final = {"text": _as_text, "man": _as_roff, "markdown": _as_markdown}

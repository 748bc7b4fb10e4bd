"""Completion of command lines in bash, zsh and fish by typer; candidates come from sessions."""

from __future__ import annotations

import os
import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from play_launch.control.protocol import MEMBER_ACTIONS, NODE_ACTIONS

if TYPE_CHECKING:
    from collections.abc import Iterator


COMPLETE_VARIABLE: Final = "_PLAY_LAUNCH_COMPLETE"
_MEMBERS, _COMPONENTS = frozenset({"container", "process"}), frozenset({"component"})
_NODES: Final = frozenset({"component", "process"})
_KINDS: Final = {
    **dict.fromkeys(MEMBER_ACTIONS, _MEMBERS),
    **dict.fromkeys(NODE_ACTIONS, _COMPONENTS),
    **dict.fromkeys(("get", "set", "dump"), _NODES),
}
"""Kinds that a command works on; all for the others."""


class Shell(StrEnum):
    """Shells whose completion typer supports."""

    BASH = "bash"
    ZSH = "zsh"
    FISH = "fish"


def completion(
    shell: Annotated[Shell, typer.Argument(metavar="SHELL", show_default=False)],
) -> None:
    """Print the completion script of a shell, which is bash, zsh or fish.

    The file that it belongs into, so that each new shell reads it:

    \b
    bash  ~/.local/share/bash-completion/completions/play-launch
    zsh   "${fpath[1]}/_play-launch"
    fish  ~/.config/fish/completions/play-launch.fish

    For this shell alone: source <(play-launch completion bash)
    """  # noqa: D301 - typer's mark of lines that stay as they are
    from typer import completion as of_typer  # noqa: PLC0415 - not at Tab

    from play_launch.cli.output import say  # noqa: PLC0415 - not at Tab

    script: str = of_typer.get_completion_script(  # type: ignore[attr-defined]
        prog_name="play-launch", complete_var=COMPLETE_VARIABLE, shell=shell
    )
    say(script)


def sessions(_ctx: typer.Context, incomplete: str) -> list[tuple[str, str]]:
    """List names and pids of the running sessions."""
    found = []
    for each, _ in _seen("ps", ()):
        found += [(each.name, each.folder), (str(each.pid), f"{each.name}, {each.folder}")]
    return [pair for pair in found if pair[0].startswith(incomplete)]


def units(ctx: typer.Context, incomplete: str) -> list[tuple[str, str]]:
    """List names of containers, nodes and processes: full ones, or last parts."""
    kinds = _KINDS.get(ctx.info_name or "")
    given = {*(ctx.params.get("names") or ())}
    found: dict[str, str] = {}
    for row in _rows(ctx, "ps", ()):
        name = str(row["name"])
        if incomplete and incomplete[0] != "/":
            name = name.rpartition("/")[2]
        if (kinds is None or row["kind"] in kinds) and name not in given:
            found[name] = f"{row['kind']}, {row['state']}"
    return [pair for pair in found.items() if pair[0].startswith(incomplete)]


def parameters(ctx: typer.Context, incomplete: str) -> list[str]:
    """List the parameters of the node on the line, as far as its session knows them."""
    node = ctx.params.get("node") or ""
    given = ctx.params.get("parameters") or ()
    rows = _rows(ctx, "parameters", (node,))
    found = [str(name) for row in rows for name in row["parameters"]]
    return [name for name in found if name.startswith(incomplete) and name not in given]


def launch_files(ctx: typer.Context, incomplete: str) -> list[str]:
    """List packages, or launch files of the package on the line; a shell completes paths itself."""
    from play_launch.config.substitutions import (  # noqa: PLC0415 - slow
        ament_prefixes,
        share_folder,
    )
    from play_launch.launch_files.find import launch_files as files_of  # noqa: PLC0415

    given = [each for each in ctx.params.get("target") or () if ":=" not in each]
    names: set[str] = set()
    if len(given) == 1 and not Path(given[0]).is_file():
        share = share_folder(given[0])
        names = set(files_of(share)) if share is not None else set()
    elif not given and "/" not in incomplete:
        for prefix in (Path(sys.prefix), *ament_prefixes(os.environ)):
            index = prefix / "share/ament_index/resource_index/packages"
            names |= {each.name for each in index.iterdir()} if index.is_dir() else set()
        names |= {each.name for each in Path().iterdir()}
    return sorted(name for name in names if name.startswith(incomplete))


def _rows(ctx: typer.Context, operation: str, names: tuple[str, ...]) -> Iterator[dict[str, Any]]:
    """Query the sessions that ``--session`` on the line selects."""
    session = str(ctx.params.get("session") or "").rstrip("/")
    for each, rows in _seen(operation, names):
        folder = each.folder.rstrip("/")
        if not session or session in {each.name, str(each.pid), folder, Path(folder).name}:
            yield from rows


def _seen(operation: str, names: tuple[str, ...]) -> Any:
    from play_launch.control.sessions import glance  # noqa: PLC0415 - at Tab only

    return glance(operation, names)

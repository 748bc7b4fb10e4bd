"""``play-launch completion``: the script by which a shell completes command lines."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from play_launch.cli import completion as scripts


class Shell(StrEnum):
    """The shells."""

    BASH = "bash"
    ZSH = "zsh"
    FISH = "fish"


def completion(
    shell: Annotated[Shell, typer.Argument(help="Which shell.", show_default=False)],
) -> None:
    r"""Print the script by which a shell completes verbs, options and the names of what runs.

    \b
    bash  play-launch completion bash > ~/.local/share/bash-completion/completions/play-launch
    zsh   play-launch completion zsh > "${fpath[1]}/_play-launch"
    fish  play-launch completion fish > ~/.config/fish/completions/play-launch.fish

    \b
    For this shell alone: source <(play-launch completion bash)
    """
    script = Path(scripts.__file__).with_name(f"play-launch.{shell}")
    sys.stdout.write(script.read_text(encoding="utf-8"))

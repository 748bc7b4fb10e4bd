"""``play-launch version``: what is installed here."""

from __future__ import annotations

import json
import os
from typing import Annotated

import typer

from play_launch.cli.output import say


def version(
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object, for machines.")] = False,
) -> None:
    """Print versions, for a report of a problem.

    Those of play-launch, of Python's packages and of ROS, and where the container's program is.
    """
    print_version(as_json=as_json)


def print_version(*, as_json: bool) -> None:
    """Print versions, one a line, play-launch first; a program that is missing is named so."""
    from play_launch.container.ros import (  # noqa: PLC0415
        MixedInstallationError,
        NotInstalledError,
        component_container,
        ros_installation,
    )
    from play_launch.recording.facts import host_facts, versions  # noqa: PLC0415

    found = versions()
    own = found.pop("play-launch-py", "not installed as a package")
    try:
        ros = ros_installation().source.value
    except (NotInstalledError, MixedInstallationError) as error:
        ros = f"unusable: {error}"
    try:
        container = str(component_container())
    except NotInstalledError:
        container = ""
    facts = host_facts()
    values = {
        "play-launch": own,
        **found,
        "ros": ros,
        "ros_distro": os.environ.get("ROS_DISTRO", ""),
        "component_container": container,
        "system": ", ".join(str(facts[key]) for key in ("distribution", "kernel", "machine")),
    }
    if as_json:
        say(json.dumps(values, ensure_ascii=False))
        return
    width = max(len(name) for name in values)
    for name, value in values.items():
        say(f"{name:<{width}}  {value or 'none'}")

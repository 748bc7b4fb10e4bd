"""``play-launch version``: what is installed here."""

from __future__ import annotations

import json
import os

from play_launch.cli import options
from play_launch.cli.output import say


def version(as_json: options.Json = False) -> None:
    """Print versions for a bug report: play-launch, Python packages, ROS, the container program."""
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

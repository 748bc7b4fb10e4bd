"""``play-launch kubernetes``: manifests by which Kubernetes runs a system."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from play_launch.cli import options
from play_launch.cli.output import fail, make_folder, say, warn, write_file

_IMAGE = "play-launch:latest"


def kubernetes(
    config: options.ConfigFile,
    arguments: options.ConfigArguments = None,
    output: Annotated[
        Path | None,
        options.output(
            "The folder for system.yaml and its overlay. Default: system.yaml on stdout.",
            "DIR",
        ),
    ] = None,
    image: Annotated[
        str, typer.Option(metavar="IMAGE", help="Image with play-launch and the packages.")
    ] = _IMAGE,
    fleet: Annotated[
        bool,
        typer.Option(
            "--fleet",
            help="A DaemonSet: every node with the machine's label runs it. Otherwise one node.",
        ),
    ] = False,
) -> None:
    """Write Kubernetes manifests of a system: a pod for each machine, none for each node.

    A pod runs on the node with the label play-launch/machine=NAME; without machines, on any. The
    recordings are in /var/log/play_launch of that node.
    """
    from play_launch.config.load import load_config  # noqa: PLC0415
    from play_launch.config.machines import discovery_problems  # noqa: PLC0415
    from play_launch.config.problems import ConfigError  # noqa: PLC0415
    from play_launch.config.substitutions import Inputs, parse_arguments  # noqa: PLC0415
    from play_launch.deploy.kubernetes import (  # noqa: PLC0415
        Workload,
        kustomization,
        manifests,
    )

    try:
        loaded = load_config(config, Inputs(arguments=parse_arguments(arguments or ())))
        workload = Workload(image=image, arguments=tuple(arguments or ()), fleet=fleet)
        text = manifests(loaded, workload)
    except ConfigError as error:
        fail(f"{config} cannot be used, nothing was written\n{error.for_people()}")
    for each in discovery_problems(loaded, {}):
        warn(each)
    if output is None:
        say(text.rstrip("\n"))
        return
    files = {"system.yaml": text, **kustomization(loaded, image)}
    make_folder(output)
    for name, content in files.items():
        write_file(output / name, content)
    say(f"{output} is written; kubectl apply -k {output}")

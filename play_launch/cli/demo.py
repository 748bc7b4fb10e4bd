"""What ``play-launch demo`` does: starts the system of the package, on one machine or on three."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
import yaml

from play_launch.cli import options
from play_launch.cli.output import fail, say_live

if TYPE_CHECKING:
    from collections.abc import Sequence

    from play_launch.deploy.machines.namespaces import Namespaces

DEMO: Final = Path(__file__).with_name("demo.yaml")
_MOST_MACHINES: Final = 3
"""As many as the demo has containers."""


def demo(
    seconds: Annotated[
        float, options.time("Stop after this time: 30, 2min.", "--seconds", default="10s")
    ] = 10.0,
    log_dir: options.LogDir = None,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
    machines: Annotated[
        int,
        typer.Option(
            min=1,
            max=_MOST_MACHINES,
            help="With 2 or 3: run it on so many hosts, which are made of network namespaces for "
            "it and removed afterwards, with the recordings of all but the first. Needs root.",
        ),
    ] = 1,
) -> int:
    """Start the demo system: three containers with eight nodes, on this machine only.

    It is `replay` of a configuration that is part of the package.
    """
    if machines == 1:
        from play_launch.cli.replay import bring_up  # noqa: PLC0415

        return bring_up(DEMO, log_dir, seconds, quiet=quiet, as_json=as_json)
    from play_launch.cli.systemd_unit import program  # noqa: PLC0415
    from play_launch.deploy.machines.namespaces import Namespaces, missing  # noqa: PLC0415

    if problem := missing():
        fail(f"--machines: {problem}")
    words = [
        *(("--log-dir", str(log_dir.absolute())) if log_dir else ()),
        *(("--quiet",) if quiet else ()),
        *(("--json",) if as_json else ()),
    ]
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.default_int_handler)  # the hosts are to be removed
    with tempfile.TemporaryDirectory(prefix="play-launch-demo-") as folder:
        config = Path(folder) / "demo.yaml"
        config.write_text(
            yaml.safe_dump(_spread(machines, seconds, str(program())), sort_keys=False)
        )
        try:
            with Namespaces(Path(folder), machines) as hosts:
                if not as_json:
                    on_h1 = shlex.join(hosts.command(str(program())))
                    say_live(f"hosts h1 to h{machines} are up; in another shell: {on_h1} top")
                return _run(hosts, [str(program()), "replay", str(config), *words])
        except OSError as error:
            fail(f"--machines: the hosts cannot be made: {error}")


def _spread(machines: int, seconds: float, program: str) -> dict[str, Any]:
    """Return the demo's configuration with its containers on h1, h2 and so on in turn."""
    config: dict[str, Any] = yaml.safe_load(DEMO.read_text())
    others = {"service": "none", "play_launch": program}
    config["duration"] = seconds
    config["environment"] = {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
        "ROS_DOMAIN_ID": os.environ.get("ROS_DOMAIN_ID") or "0",
    }
    config["machines"] = {"h1": {"local": True}} | {
        f"h{number}": others for number in range(2, machines + 1)
    }
    for number, container in enumerate(config["containers"]):
        container["machine"] = f"h{number % machines + 1}"
    return config


def _run(hosts: Namespaces, words: Sequence[str]) -> int:
    """Run play-launch on h1 to its end, as a program of ours that gets our signals."""
    home = {"ROS_HOME": os.environ.get("ROS_HOME", str(Path.home() / ".ros"))}
    child = subprocess.Popen(
        hosts.command(*words),
        env={**hosts.environment, **home},
        stdout=sys.stdout,  # descriptor 1 is stderr here: see cli.entry
        # A terminal's Ctrl-C would reach it twice, which is a stop without patience.
        process_group=0,
    )
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: child.send_signal(number))
    code = child.wait()
    return code if code >= 0 else 128 - code

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


def demo(  # noqa: PLR0917 - options, by name
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
            metavar="N",
            help="With 2 or 3: run it on so many hosts, which are made of network namespaces for "
            "it and removed afterwards, with the recordings of all but the first. Needs root.",
        ),
    ] = 1,
    web: Annotated[
        bool,
        typer.Option(
            "--web",
            help="With a page for a browser, a node that crashes again and again, two nodes that "
            "do not connect, and a topic that is too slow.",
        ),
    ] = False,
) -> int:
    """Start the demo system: three containers with eight nodes, on this machine only.

    It is `replay` of a configuration that is part of the package.
    """
    if web and machines > 1:
        fail("--web: the hosts of --machines cannot be reached by a browser of this one")
    if machines == 1 and not web:
        from play_launch.cli.replay import bring_up  # noqa: PLC0415

        return bring_up(DEMO, log_dir, seconds, quiet=quiet, as_json=as_json)
    with tempfile.TemporaryDirectory(prefix="play-launch-demo-") as name:
        folder = Path(name)
        config = folder / "demo.yaml"
        if web:
            from play_launch.cli.replay import bring_up  # noqa: PLC0415

            _write(config, with_page())
            return bring_up(config, log_dir, seconds, quiet=quiet, as_json=as_json)
        words = [
            *(("--log-dir", str(log_dir.absolute())) if log_dir else ()),
            *(("--quiet",) if quiet else ()),
            *(("--json",) if as_json else ()),
        ]
        _write(config, _spread(machines, seconds))
        return _on_hosts(folder, machines, ["replay", str(config), *words], as_json=as_json)


def _on_hosts(folder: Path, machines: int, words: Sequence[str], *, as_json: bool) -> int:
    from play_launch.deploy.machines.namespaces import Namespaces, missing  # noqa: PLC0415

    if problem := missing():
        fail(f"--machines: {problem}")
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.default_int_handler)  # the hosts are to be removed
    try:
        with Namespaces(folder, machines) as hosts:
            if not as_json:
                on_h1 = shlex.join(hosts.command(_program()))
                say_live(f"hosts h1 to h{machines} are up; in another shell: {on_h1} top")
            return _run(hosts, [_program(), *words])
    except OSError as error:
        fail(f"--machines: the hosts cannot be made: {error}")


def _program() -> str:
    from play_launch.cli.systemd_unit import program  # noqa: PLC0415

    return str(program())


def _write(path: Path, config: dict[str, Any]) -> None:
    path.write_text(yaml.safe_dump(config, sort_keys=False))


def with_page() -> dict[str, Any]:
    """Return the demo's configuration with a page, and what it finds.

    A node crashes, the QoS of two others does not match, and a topic is too slow.
    """
    from play_launch.cli.web import require_nicegui  # noqa: PLC0415

    require_nicegui()
    config: dict[str, Any] = yaml.safe_load(DEMO.read_text())
    config["name"] = "demo-web"
    unlucky = {
        "package": "play_launch_demo",
        "plugin": "play_launch_demo::Crasher",
        "name": "unlucky",
        "parameters": {"how": "segv", "after": 2.0},
        "restart": {"max_restarts": 100, "backoff": {"initial": "1 s", "maximum": "5 s"}},
    }
    # Its listener requests reliable, and hears nothing.
    whisper = _talking("Talker", "whisper", "gossip", {"reliable": False, "rate": 1.0})
    eager = _talking("Listener", "eager_listener", "gossip", {})
    tired = _talking("Talker", "tired", "heartbeat", {"rate": 2.0})
    lab = [unlucky, whisper, eager, tired]
    config["containers"].append(
        {"name": "lab", "container_type": "isolated", "composable_nodes": lab}
    )
    config["expect"] = {
        "/chatter": {"min_rate": "8 Hz", "max_gap": "500 ms", "publishers": 1},
        "/heartbeat": {"min_rate": "5 Hz"},
    }
    config["web"] = {"allow_control": True}
    return config


def _talking(plugin: str, name: str, topic: str, parameters: dict[str, Any]) -> dict[str, Any]:
    return {
        "package": "play_launch_demo",
        "plugin": f"play_launch_demo::{plugin}",
        "name": name,
        "remappings": {"chatter": topic},
        "parameters": parameters,
    }


def _spread(machines: int, seconds: float) -> dict[str, Any]:
    """Return the demo's configuration with its containers on h1, h2 and so on in turn."""
    config: dict[str, Any] = yaml.safe_load(DEMO.read_text())
    others = {"service": "none", "play_launch": _program()}
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
    from play_launch.deploy.machines.namespaces import ends_with_us  # noqa: PLC0415

    home = {"ROS_HOME": os.environ.get("ROS_HOME", str(Path.home() / ".ros"))}
    child = subprocess.Popen(
        [*ends_with_us("INT"), *hosts.command(*words)],
        env={**hosts.environment, **home},
        stdout=sys.stdout,  # descriptor 1 is stderr here: see cli.entry
        # A terminal's Ctrl-C would reach it twice, which is a stop without patience.
        process_group=0,
    )
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: child.send_signal(number))
    code = child.wait()
    return code if code >= 0 else 128 - code

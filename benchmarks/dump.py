"""How long `dump` takes, beside ROS's own launch evaluating the same file in a process of its own.

    python -m benchmarks.dump [PKG FILE | PATH] [NAME:=VALUE]... [--runs N] [--json]

Without a launch file a made-up one is taken: 63 files that include each other, six deep, each with
a node and 40 arguments. Times are those of
whole processes, the start of Python and all imports included. ROS's launch is as it is installed:
the description is visited as LaunchService does, and only what would be started is left out. It has
to be installed (a sourced ROS); dump takes it as well then, without what launch does needlessly
often.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.bring_up import COMMAND, ENVIRONMENT, cpu_of_children
from benchmarks.statistics import header, row

FILES = 63
ARGUMENTS = 40
REFERENCE = """
import asyncio, sys
import launch
from launch.actions import ExecuteLocal, IncludeLaunchDescription, TimerAction
from launch.launch_description_sources import AnyLaunchDescriptionSource
from launch_ros.actions import LifecycleNode, LoadComposableNodes, Node
from launch_ros.actions.load_composable_nodes import get_composable_node_load_request

def load(self, context):
    for node in self._LoadComposableNodes__composable_node_descriptions:
        get_composable_node_load_request(node, context)

ExecuteLocal.execute = lambda self, context: self.prepare(context)
LifecycleNode.execute = lambda self, context: Node.execute(self, context)
LoadComposableNodes.execute = load
TimerAction.execute = lambda self, context: list(self.actions)

path, *arguments = sys.argv[1:]
context = launch.LaunchContext(argv=arguments)
context._set_asyncio_loop(asyncio.new_event_loop())
pairs = [argument.split(":=", 1) for argument in arguments]

def visit(entity):
    for below in entity.visit(context) or ():
        visit(below)

source = AnyLaunchDescriptionSource(path)
visit(IncludeLaunchDescription(source, launch_arguments=pairs))
"""


def tree(folder: Path) -> Path:
    """Write the made-up launch files, and the package whose nodes they start; return the first."""
    index = folder / "share" / "ament_index" / "resource_index" / "packages"
    programs, files = folder / "lib" / "made_up", folder / "share" / "made_up"
    for each in (index, programs, files):
        each.mkdir(parents=True)
    (index / "made_up").touch()
    (programs / "node").write_text("#!/bin/sh\n")
    (programs / "node").chmod(0o755)
    values = "".join(f"    x{number}: {number / 2}\n" for number in range(ARGUMENTS))
    for number in range(FILES):
        parameters = files / f"{number}.param.yaml"
        parameters.write_text(f"/**:\n  ros__parameters:\n{values}")
        defaults = (
            f'<arg name="a{each}" default="$(env HOME)/{number if each % 2 else 0}/{each}"/>\n'
            for each in range(ARGUMENTS)
        )
        given = "".join(
            f'<arg name="a{each}" value="$(var a{each})"/>\n' for each in range(0, ARGUMENTS, 2)
        )
        included = (
            f'<include file="$(find-pkg-share made_up)/{each}.launch.xml">\n{given}</include>\n'
            for each in (2 * number + 1, 2 * number + 2)
            if each < FILES
        )
        (files / f"{number}.launch.xml").write_text(
            f"<launch>\n{''.join(defaults)}{''.join(included)}"
            f'<node pkg="made_up" exec="node" name="node_{number}">'
            f'<param name="x" value="$(var a1)"/><param from="{parameters}"/></node>\n</launch>\n'
        )
    return files / "0.launch.xml"


class Times:
    """Of all runs of one command, in seconds."""

    def __init__(self) -> None:
        self.wall: list[float] = []
        self.cpu: list[float] = []

    def take(self, command: Sequence[str | Path], environment: dict[str, str]) -> None:
        """Run it once more."""
        cpu, began = cpu_of_children(), time.monotonic()
        done = subprocess.run(command, check=False, capture_output=True, env=environment)
        if done.returncode != 0:
            raise SystemExit(done.stderr.decode(errors="replace"))
        self.wall.append(time.monotonic() - began)
        self.cpu.append(cpu_of_children() - cpu)


def path_of(words: Sequence[str]) -> str:
    """Return the path of a launch file that is given as for `dump`."""
    if len(words) == 1:
        return words[0]
    from ament_index_python import get_package_share_directory  # noqa: PLC0415 - with ROS only

    found = sorted(Path(get_package_share_directory(words[0])).rglob(words[1]))
    if not found:
        raise SystemExit(f"no {words[1]} in the package {words[0]}")
    return str(found[0])


def measure(words: Sequence[str], runs: int) -> dict[str, Times]:
    """Evaluate by turns, so many times."""
    found = {"dump": Times(), "ROS's launch": Times()}
    with tempfile.TemporaryDirectory(prefix="dump-") as name:
        folder = Path(name)
        environment = {**ENVIRONMENT, "ROS_LOG_DIR": name, "TMPDIR": name}
        arguments = [word for word in words if ":=" in word]
        target = [word for word in words if ":=" not in word]
        if not target:
            target = [str(tree(folder))]
            prefixes = [name, *filter(None, [environment.get("AMENT_PREFIX_PATH")])]
            environment["AMENT_PREFIX_PATH"] = os.pathsep.join(prefixes)
        path = path_of(target)
        commands: dict[str, list[str | Path]] = {
            "dump": [COMMAND, "dump", path, *arguments, "--output", folder / "found.yaml"],
            "ROS's launch": [sys.executable, "-P", "-c", REFERENCE, path, *arguments],
        }
        for _ in range(runs):
            (folder / "found.yaml").unlink(missing_ok=True)
            for key, command in commands.items():
                found[key].take(command, environment)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("words", nargs="*", metavar="PKG FILE | PATH | NAME:=VALUE")
    parser.add_argument("--runs", type=int, default=9)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = measure(options.words, options.runs)
    if options.json:
        print(json.dumps({name: vars(times) for name, times in found.items()}))
        return
    shown = " ".join(options.words) or f"{FILES} files"
    print(f"{shown}, {os.cpu_count()} CPUs, {options.runs} runs, load {os.getloadavg()[0]:.1f}")
    print(header())
    for name, times in found.items():
        print(row(name, times.wall, "s"))
        print(row("  CPU", times.cpu, "s"))


if __name__ == "__main__":
    main()

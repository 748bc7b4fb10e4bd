"""Starts our container once, as a supervisor does, and hears what it says of itself."""

from __future__ import annotations

import asyncio
import subprocess
import tempfile
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from play_launch.container.allocator import allocating_with, find_allocator
from play_launch.container.channel import ControlChannel, ControlError, control_pair
from play_launch.container.environment import child_environment
from play_launch.container.messages import Hello, Shutdown
from play_launch.container.ros import NotInstalledError, component_container, spawn_guard
from play_launch.doctor.facts import ContainerFacts

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from play_launch.container.ros import RosInstallation

_HELLO_LIMIT: Final = 20.0
"""Seconds from its start to its hello."""
_END_LIMIT: Final = 5.0
_ALONE: Final = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF", "ROS_DOMAIN_ID": "0"}
"""What is wrong with the domain is reported elsewhere."""
_NAME: Final = "_play_launch_doctor"
_WORDS: Final = 500
"""Characters of what it wrote that are passed on."""


def probe_container(ros: RosInstallation, environ: Mapping[str, str]) -> ContainerFacts:
    """Ask the container; it finds nobody meanwhile and is gone afterwards."""
    try:
        program = component_container()
        spawn_guard()
    except NotInstalledError as error:
        return ContainerFacts(problem=str(error))
    allocator = find_allocator()
    facts = ContainerFacts(
        program=str(program),
        allocator=str(allocator.library or ""),
        allocator_problem=allocator.problem,
    )
    environment = child_environment(environ, ros, _ALONE)
    if allocator.library is not None:
        environment = allocating_with(environment, allocator.library)
    return asyncio.run(_ask(program, environment, facts))


async def _ask(
    program: Path, environment: Mapping[str, str], facts: ContainerFacts
) -> ContainerFacts:
    with tempfile.TemporaryFile() as output, control_pair() as pair:
        try:
            process = subprocess.Popen(  # noqa: ASYNC220 - nothing else runs in this loop
                [program, "--isolated", "--ros-args", "-r", f"__node:={_NAME}"],
                env={**environment, **pair.environment},
                pass_fds=(pair.child_fd,),
                stdout=output,
                stderr=subprocess.STDOUT,
            )
        except OSError as error:
            return replace(facts, problem=f"cannot be started: {error.strerror}")
        pair.close_child_end()
        try:
            channel = ControlChannel(pair.ours, container=f"/{_NAME}")
            try:
                async with asyncio.timeout(_HELLO_LIMIT):
                    hello = await channel.handshake(Hello(version="doctor"))
                channel.send(Shutdown(reason="asked enough"))
                await _end(process)
            finally:
                channel.close()
        except TimeoutError:
            return replace(facts, problem=f"says nothing for {_HELLO_LIMIT:g} s")
        except ControlError as error:
            await _end(process)
            return replace(facts, problem=f"{error}; {_last_words(output)}")
        finally:
            if process.poll() is None:
                process.kill()
            process.wait()
    return replace(
        facts,
        version=hello.version,
        backends=hello.backends,
        mechanism=hello.mechanism,
        notes=hello.notes,
    )


async def _end(process: subprocess.Popen[bytes]) -> None:
    """Wait for its end, as long as that takes in order."""
    with suppress(subprocess.TimeoutExpired):
        await asyncio.to_thread(process.wait, _END_LIMIT)


def _last_words(output: Any) -> str:
    output.seek(0)
    text = output.read().decode(errors="replace").strip()
    return text[-_WORDS:] if text else "it wrote nothing"

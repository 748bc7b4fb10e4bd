"""``play-launch collect``: the recordings of all machines, as one."""

from __future__ import annotations

import asyncio
import json
import time
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.output import fail, note, say, size, warn, whole_file
from play_launch.recording.folder import MACHINES

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

COLLECTED = "all-machines.mcap"
_NOTED: Final = 5.0
"""Seconds between two notes of how much has arrived."""


def collect(
    session: options.Recording,
    output: Annotated[
        Path | None,
        options.output(f"The file to write. Default: {COLLECTED} in the folder of the session."),
    ] = None,
    as_json: options.Json = False,
) -> int:
    """Fetch the recordings of all machines of a session, and merge them on one clock.

    The session is that of the machine where `replay` ran. The recordings of the others come into
    its folder, and are read by all commands, too. Exits with 1 if a machine is missing.
    """
    folder = session if session.is_dir() else session.parent
    try:
        recorded = json.loads((folder / MACHINES).read_text())
    except (OSError, ValueError):
        fail(f"{folder} is no session of several machines: there is no {MACHINES}")
    from play_launch.postmortem.archive import complete_files, session_entry  # noqa: PLC0415
    from play_launch.postmortem.merge import Source, merge  # noqa: PLC0415 - slow
    from play_launch.recording.folder import parts_of  # noqa: PLC0415

    entry = session_entry(folder)
    if entry is not None and entry.is_running:
        fail(f"{folder}: the session still runs; collect it when it has ended")
    complete_files(folder)
    places = _places(folder, recorded)
    missing = asyncio.run(_fetch(recorded, places))
    if not (files := parts_of(folder)):
        fail(f"{folder}: no session.mcap is in this folder")
    sources = [Source("", files, [])]
    for about, place in zip(recorded, places, strict=True):
        name = about["machine"]
        if not place.is_dir():
            continue
        if complete_files(place):
            warn(f"{name}: its recording is not finished, and is taken as far as it goes")
        if files := parts_of(place):
            sources.append(Source(name, files, [(at, ahead) for at, ahead in about["offsets"]]))
        elif name not in missing:
            warn(f"{name}: it has recorded nothing")
            missing.add(name)
    target = output or folder / COLLECTED
    # Of an earlier time: all that it held is here.
    with whole_file(target, replaces_recording=output is None) as half:
        count = merge(sources, half)
    if as_json:
        say(json.dumps({"output": str(target), "messages": count, "missing": sorted(missing)}))
        return ExitCode.NODE_FAILED if missing else ExitCode.OK
    say(f"{target}: {count:,} messages, {size(target.stat().st_size)}", beside=target)
    return ExitCode.NODE_FAILED if missing else ExitCode.OK


def _places(folder: Path, recorded: Sequence[Mapping[str, Any]]) -> list[Path]:
    """Give where each recording comes: a machine has several where its session was killed."""
    # Not by the names that they have there, which the other machines choose.
    count: Counter[str] = Counter()
    found = []
    for about in recorded:
        count[about["machine"]] += 1
        found.append(folder / about["machine"] / str(count[about["machine"]]))
    return found


def _noted_now_and_then(machine: str) -> Callable[[int, int], None]:
    """Return what notes how much of the recording of a machine has arrived."""
    noted = time.monotonic()

    def arrived(done: int, total: int) -> None:
        nonlocal noted
        if time.monotonic() - noted > _NOTED:
            noted = time.monotonic()
            note(f"{machine}: {size(done)} of {size(total)}")

    return arrived


async def _fetch(recorded: Sequence[Mapping[str, Any]], places: Sequence[Path]) -> set[str]:
    """Fetch all recordings at once; return the machines of which one is missing."""
    from play_launch.config.machines import MachineConfig  # noqa: PLC0415
    from play_launch.deploy.machines.hosts import HostError, LinkLost, connect  # noqa: PLC0415

    missing: set[str] = set()

    async def fetch(about: Mapping[str, Any], place: Path) -> None:
        name = about["machine"]
        machine = MachineConfig(name=name, local=about["local"], ssh=about["ssh"])
        try:
            host = await connect(machine)
            try:
                await host.get(about["folder"], place, _noted_now_and_then(name))
            finally:
                await host.close()
        except (HostError, LinkLost, OSError) as error:
            warn(f"{name}: its recording cannot be fetched: {error}")
            missing.add(name)

    async with asyncio.TaskGroup() as tasks:
        for about, place in zip(recorded, places, strict=True):
            tasks.create_task(fetch(about, place))
    return missing

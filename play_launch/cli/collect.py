"""``play-launch collect``: the recordings of all machines, as one."""

from __future__ import annotations

import asyncio
import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.output import fail, say, size, warn, whole_file
from play_launch.recording.folder import MACHINES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

COLLECTED = "all-machines.mcap"


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
    from play_launch.recording.folder import BAG_NAME, parts_of  # noqa: PLC0415

    entry = session_entry(folder)
    if entry is not None and entry.is_running:
        fail(f"{folder}: the session still runs; collect it when it has ended")
    complete_files(folder)
    missing = asyncio.run(_fetch(recorded, folder))
    sources = [Source("", [each.path for each in parts_of(folder)], 0)]
    for about in recorded:
        name, fetched = about["machine"], _place(folder, about)
        if fetched.is_dir() and complete_files(fetched):
            warn(f"{name}: its recording is not finished, and is taken as far as it goes")
        files = [each.path for each in parts_of(fetched)] if fetched.is_dir() else []
        if files:
            sources.append(Source(name, files, about["offset_ns"] or 0))
        elif name not in missing:
            warn(f"{name}: it has recorded nothing")
            missing.add(name)
    target = output or folder / COLLECTED
    if output is None:
        target.unlink(missing_ok=True)  # of an earlier time; all that it held is here
    with whole_file(target) as half:
        count = merge(folder / BAG_NAME, sources, half)
    if as_json:
        say(json.dumps({"output": str(target), "messages": count, "missing": sorted(missing)}))
        return ExitCode.NODE_FAILED if missing else ExitCode.OK
    say(f"{target}: {count:,} messages, {size(target.stat().st_size)}", beside=target)
    return ExitCode.NODE_FAILED if missing else ExitCode.OK


def _place(folder: Path, about: Mapping[str, Any]) -> Path:
    """Give where a recording comes: a machine has several where its session was killed."""
    return folder / str(about["machine"]) / Path(about["folder"]).name


async def _fetch(recorded: Sequence[Mapping[str, Any]], folder: Path) -> set[str]:
    """Fetch all recordings at once; return the machines of which one is missing."""
    from play_launch.config.machines import MachineConfig  # noqa: PLC0415
    from play_launch.deploy.machines.hosts import HostError, LinkLost, connect  # noqa: PLC0415

    missing: set[str] = set()

    async def fetch(about: Mapping[str, Any]) -> None:
        name = about["machine"]
        machine = MachineConfig(name=name, local=about["local"], ssh=about["ssh"])
        try:
            host = await connect(machine)
            try:
                place = _place(folder, about)
                fetched = place.with_name(f".{place.name}")
                shutil.rmtree(fetched, ignore_errors=True)
                await host.get(about["folder"], fetched)
                # What was completed from an earlier, shorter copy must not stay.
                shutil.rmtree(place, ignore_errors=True)
                fetched.rename(place)
            finally:
                host.close()
        except (HostError, LinkLost, OSError) as error:
            warn(f"{name}: its recording cannot be fetched: {error}")
            missing.add(name)

    async with asyncio.TaskGroup() as tasks:
        for about in recorded:
            tasks.create_task(fetch(about))
    return missing

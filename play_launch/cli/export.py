"""``play-launch export``: a recording in the formats of other tools."""

from __future__ import annotations

from contextlib import ExitStack, closing
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

import typer

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.info import report_damage
from play_launch.cli.output import fail, is_passed_on, make_folder, say, whole_file
from play_launch.postmortem.export.tables import WRITERS, rows
from play_launch.postmortem.export.trace import write_trace
from play_launch.postmortem.timeline import Timeline
from play_launch.recording.folder import beside

if TYPE_CHECKING:
    from play_launch.postmortem.export.tables import TableWriter
    from play_launch.postmortem.past_session import PastSession

TRACE: Final = "perfetto"
Format = Literal["perfetto", "csv", "parquet"]


def export(
    file: options.Recording,
    form: Annotated[
        Format,
        typer.Option(
            "--format", help="perfetto: a trace for Perfetto and chrome://tracing. Others: tables."
        ),
    ] = "perfetto",
    output: Annotated[
        Path | None,
        options.output(
            "The file of a trace, the folder of tables. Default: beside the recording.", "PATH"
        ),
    ] = None,
) -> int:
    """Convert a recording to a trace, or to tables.

    Damaged and unfinished recordings (.active) are read as far as possible; exits with 5 then, with
    2 if the file is not a recording, with 1 if nothing could be written.
    """
    if form == "parquet" and find_spec("pyarrow") is None:
        fail("--format parquet needs pyarrow: pip install 'play-launch-py[parquet]', or use csv")
    if form != TRACE and output is not None and is_passed_on(output):
        fail(f"--output {output}: tables need a folder")
    timeline = Timeline(file)
    session = timeline.session
    target = output or beside(file, ".trace.json" if form == TRACE else f"-{form}")
    written = (
        _write_trace(timeline, target) if form == TRACE else _write_tables(session, form, target)
    )
    say(f"{target}: {written}", beside=target)
    return ExitCode.DAMAGED if report_damage(session.reader) else 0


def _write_trace(timeline: Timeline, target: Path) -> str:
    with whole_file(target) as half, half.open("w", encoding="utf-8") as file:
        write_trace(timeline, file)
    return "open it in ui.perfetto.dev or chrome://tracing"


def _write_tables(session: PastSession, form: str, folder: Path) -> str:
    tables: dict[str, TableWriter] = {}
    with ExitStack() as files:
        for table, values in rows(session):
            writer = tables.get(table)
            if writer is None:
                make_folder(folder)
                half = files.enter_context(whole_file(folder / f"{table}.{form}"))
                writer = tables[table] = files.enter_context(closing(WRITERS[form](half)))
            writer.add(values)
    return ", ".join(f"{table}.{form}" for table in sorted(tables)) or "nothing to write"

"""A session as tables: samples of processes, samples of the machine, changes of state."""

from __future__ import annotations

import csv
import math
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

from msgspec import structs

from play_launch.supervisor.events import (
    ContainerStateChanged,
    GroupSample,
    NodeStateChanged,
    ProcessEvent,
    ProcessSample,
    SubjectKind,
    SystemSample,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from play_launch.postmortem.past_session import PastSession
    from play_launch.supervisor.events import RunEvent

    Value = str | int | float

_BATCH: Final = 50_000
"""Rows of one group in a Parquet file."""


class TableRow(NamedTuple):
    """One row, and which table it belongs to."""

    table: str
    values: Mapping[str, Value]


def rows(session: PastSession) -> Iterator[TableRow]:
    """Give the rows of all tables while a session is read; ``time_s`` is seconds since its start.

    Raises:
        NotARecordingError: At once, for another kind of file.
    """
    for happened in session.events():
        made = _row(happened.event)
        if made is not None:
            table, values = made
            time_s = (happened.log_time - session.started_ns) / 1e9
            yield TableRow(table, {"time_s": round(time_s, 6), **values})


def _row(event: RunEvent) -> TableRow | None:
    match event:
        case ProcessSample():
            values = structs.asdict(event)
            values["kind"] = event.kind.name.lower()
            values["memory_kind"] = event.memory_kind.name.lower()
            return TableRow("processes", values)
        case GroupSample():
            values = structs.asdict(event)
            values["kind"] = event.kind.name.lower()
            return TableRow("cgroups", values)
        case SystemSample():
            values = structs.asdict(event)
            for name in ("core_percent", "core_mhz"):
                what = name.removeprefix("core_")
                cores = values.pop(name)
                values |= {f"core_{core}_{what}": value for core, value in enumerate(cores)}
            return TableRow("machine", values)
        case NodeStateChanged():
            return _state(event, SubjectKind.NODE, str(event.key), event.state.name, event.reason)
        case ContainerStateChanged():
            kind = SubjectKind.CONTAINER
            return _state(event, kind, event.container, event.state.name, event.reason)
        case ProcessEvent():
            return _state(event, SubjectKind.PROCESS, event.name, event.kind.name, event.message)
        case _:
            return None


def _state(
    event: NodeStateChanged | ContainerStateChanged | ProcessEvent,
    kind: SubjectKind,
    key: str,
    state: str,
    reason: str,
) -> TableRow:
    return TableRow(
        "states",
        {
            "stamp_ns": event.stamp_ns,
            "kind": kind.name.lower(),
            "key": key,
            "state": state.lower(),
            "pid": 0 if isinstance(event, ContainerStateChanged) else event.pid,
            "reason": reason,
        },
    )


class CsvWriter:
    """A table as comma-separated values with a line of names; what is no number is empty."""

    def __init__(self, path: Path) -> None:
        """Create the file. Raises OSError."""
        self._file = path.open("w", encoding="utf-8", newline="")
        self._writer: csv.DictWriter[str] | None = None

    def add(self, values: Mapping[str, Value]) -> None:
        """Take a row; the first one says which columns there are. Raises OSError."""
        if self._writer is None:
            self._writer = csv.DictWriter(
                self._file, list(values), restval="", extrasaction="ignore"
            )
            self._writer.writeheader()
        self._writer.writerow(
            {
                name: "" if isinstance(value, float) and not math.isfinite(value) else value
                for name, value in values.items()
            }
        )

    def close(self) -> None:
        """Complete the file. Raises OSError."""
        self._file.close()


class ParquetWriter:
    """A table as Apache Parquet, by pyarrow."""

    def __init__(self, path: Path) -> None:
        """Write nothing yet. Raises ImportError without pyarrow."""
        # Large, and optional.
        self._arrow: Any = import_module("pyarrow")
        self._parquet: Any = import_module("pyarrow.parquet")
        self._path = path
        self._batch: list[Mapping[str, Value]] = []
        self._file: Any = None

    def add(self, values: Mapping[str, Value]) -> None:
        """Take a row. Raises OSError."""
        self._batch.append(values)
        if len(self._batch) >= _BATCH:
            self._write()

    def close(self) -> None:
        """Complete the file. Raises OSError."""
        self._write()
        if self._file is not None:
            self._file.close()

    def _write(self) -> None:
        if not self._batch:
            return
        if self._file is None:
            columns = [(name, self._type(name, one)) for name, one in self._batch[0].items()]
            self._file = self._parquet.ParquetWriter(self._path, self._arrow.schema(columns))
        self._file.write_table(self._arrow.Table.from_pylist(self._batch, schema=self._file.schema))
        self._batch = []

    def _type(self, name: str, value: Value) -> Any:
        match value:
            case str():
                return self._arrow.string()
            case float():
                return self._arrow.float64()
            case _:
                return self._arrow.int32() if name == "pid" else self._arrow.uint64()


TableWriter: TypeAlias = CsvWriter | ParquetWriter
WRITERS: Final[dict[str, Callable[[Path], TableWriter]]] = {
    "csv": CsvWriter,
    "parquet": ParquetWriter,
}
"""By the ending of the file."""

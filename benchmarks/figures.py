"""The figures that components leave in shared memory, see fixtures/src/measurements.hpp."""

from __future__ import annotations

import mmap
import tempfile
from types import TracebackType
from typing import Self

VARIABLE = "PLAY_LAUNCH_MEASUREMENTS"
"""Environment variable that names the file to the components."""
_SIZE = 8


class Figures:
    """64-bit numbers in a file; components write them, without locks, while we read."""

    def __init__(self, count: int) -> None:
        self._file = tempfile.NamedTemporaryFile(prefix="play-launch-figures-")  # noqa: SIM115
        self._file.truncate(count * _SIZE)
        self._map = mmap.mmap(self._file.fileno(), count * _SIZE)
        self._numbers = memoryview(self._map).cast("Q")

    @property
    def environment(self) -> dict[str, str]:
        """What tells the components about it."""
        return {VARIABLE: self._file.name}

    def __getitem__(self, place: int) -> int:
        return self._numbers[place]

    def __setitem__(self, place: int, value: int) -> None:
        self._numbers[place] = value

    def read(self, first: int, count: int) -> list[int]:
        return self._numbers[first : first + count].tolist()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._numbers.release()
        self._map.close()
        self._file.close()

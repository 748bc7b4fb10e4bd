"""The frames of a backtrace, and what makes two crashes the same one."""

from __future__ import annotations

import hashlib
import re
from typing import TYPE_CHECKING, Final

from msgspec import Struct

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

_NUMBER: Final = re.compile(r"#\d+ +")
_IN_LIBRARY: Final = re.compile(r"(?P<library>\S+)\+0x(?P<offset>[0-9a-f]+)")
_IN_FUNCTION: Final = re.compile(
    r"(?P<function>.+)\+0x[0-9a-f]+ \((?P<library>[^\s()]+)\+0x(?P<offset>[0-9a-f]+)\)"
)

_RUNTIME: Final = re.compile(
    r"(?:libc|libm|libstdc\+\+|libgcc_s|libpthread|ld-linux[\w-]*|linux-vdso|libasan|libtsan)\.so"
)
_FRAMEWORK: Final = re.compile(
    r"component_container|libplay_launch_component\.so|"
    r"lib(?:rcl|rclcpp|rclcpp_components|rcl_\w+|rmw|rmw_\w+|fastrtps|fastdds|fastcdr|ddsc)\.so"
)
_CLONES: Final = re.compile(r" ?\[clone [^\]]*\]|\.(?:isra|part|constprop|cold|lto_priv)(?:\.\d+)?")
_LAMBDA: Final = re.compile(r"\{lambda\(.*?\)#\d+\}")
FAULTS: Final = frozenset({"SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL", "SIGTRAP"})
"""Signals of which the first frame is the instruction that failed, and no call under way."""
_FRAMES: Final = 4
"""Frames of a signature: enough to tell places apart, few enough for callers to change."""


class StackFrame(Struct, frozen=True):
    """One line of a backtrace; what it does not say is empty or 0."""

    text: str
    function: str = ""
    library: str = ""
    """File name of the library or program."""
    offset: int = 0
    """From where the library was loaded, in bytes: an address as its file counts them."""

    @property
    def is_runtime(self) -> bool:
        """Whether it is in the C or C++ library: a fault shows there, the cause is further out."""
        return bool(_RUNTIME.match(self.library))

    @property
    def is_own(self) -> bool:
        """Whether it is in code of the user's, judged by the library's name."""
        return bool(self.library) and not self.is_runtime and not _FRAMEWORK.match(self.library)


class Signature(Struct, frozen=True, order=True):
    """What equal crashes have in common: how they ended, and where, without addresses."""

    what: str
    """``SIGSEGV``, an exception's type, ``exit status 3``."""
    frames: tuple[str, ...]
    """``demo::Talker::tick (libdemo.so)``, innermost first; or the node's name."""

    @property
    def id(self) -> str:
        """Eight characters that are the same in every session."""
        text = "\n".join((self.what, *self.frames))
        return hashlib.blake2s(text.encode(), digest_size=4).hexdigest()

    def __str__(self) -> str:
        """``SIGSEGV in demo::Talker::tick (libdemo.so)``."""
        return f"{self.what} in {self.frames[0]}" if self.frames else self.what


def frame_of(line: str) -> StackFrame:
    """Read one line of a backtrace as containers write it."""
    text = _NUMBER.sub("", line, count=1)
    found = _IN_FUNCTION.fullmatch(text)
    if found is not None:
        return StackFrame(line, found["function"], found["library"], int(found["offset"], 16))
    found = _IN_LIBRARY.fullmatch(text)
    return StackFrame(line) if found is None else StackFrame(line, "", found[1], int(found[2], 16))


def blamed(frames: Sequence[StackFrame]) -> int | None:
    """Choose the frame to show first: the innermost one of the user's code, else of any library."""
    own = [number for number, frame in enumerate(frames) if frame.is_own]
    libraries = [n for n, frame in enumerate(frames) if frame.library and not frame.is_runtime]
    return next(iter((*own, *libraries, *range(len(frames)))), None)


def blamed_line(backtrace: Sequence[str]) -> str:
    """Choose the line of a backtrace to show where there is room for one; empty: there is none."""
    at = blamed([frame_of(line) for line in backtrace])
    return "" if at is None else backtrace[at]


def signature_of(what: str, frames: Iterable[StackFrame], name: str) -> Signature:
    """Make the signature of a crash; ``name`` stands for the place where no frame is known."""
    known = [frame for frame in frames if frame.library]
    chosen = [frame for frame in known if frame.is_own]
    chosen = chosen or [frame for frame in known if not frame.is_runtime] or known
    names = (f"{plain_function(frame.function) or '?'} ({frame.library})" for frame in chosen)
    # Several frames in a row that read the same are a recursion, or a wrapper of a wrapper.
    different = tuple(dict.fromkeys(names))[:_FRAMES]
    return Signature(what, different or (name,))


def plain_function(name: str) -> str:
    """Take from a function's name what differs between builds: arguments, clones, numbers."""
    name = _CLONES.sub("", name).replace("(anonymous namespace)::", "")
    name = _LAMBDA.sub("{lambda}", name)
    kept: list[str] = []
    depth = 0
    for number, letter in enumerate(name):
        if letter in "<(" and not _is_operator(name, number):
            depth += 1
        elif letter in ">)" and depth and not _is_operator(name, number):
            depth -= 1
        elif not depth:
            kept.append(letter)
    return "".join(kept).removesuffix(" const").strip()


_OPERATOR: Final = {
    "(": re.compile(r"\boperator$"),
    ")": re.compile(r"\boperator\($"),
    "<": re.compile(r"\boperator<?$"),
    ">": re.compile(r"\boperator[-<=>]*$"),
}
"""What stands before a bracket that belongs to the name of an operator."""


def _is_operator(name: str, at: int) -> bool:
    return bool(_OPERATOR[name[at]].search(name[:at]))

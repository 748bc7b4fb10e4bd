"""Source lines come from the very build that crashed, or there are none."""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from play_launch.postmortem.findings import Finding
from play_launch.postmortem.source_lines import (
    Module,
    SourceLine,
    debug_files,
    located,
    module_of,
    read_elf,
)
from play_launch.supervisor.frames import Signature, StackFrame, frame_of

if TYPE_CHECKING:
    from collections.abc import Iterable

SOURCE = """int other(int x);
int add(int x) {
  x += 1;
  return other(x) +
         1;
}
int other(int x) { return x * 2; }
"""


@dataclass
class Library:
    path: Path
    folder: Path
    """Where debug files of packages are."""

    @property
    def module(self) -> Module:
        elf = read_elf(self.path)
        assert elf is not None
        return Module(self.path.name, elf.build_id, str(self.path))

    def address(self, function: str) -> int:
        table = subprocess.check_output(["nm", self.path], text=True)
        line = next(line for line in table.splitlines() if line.endswith(f" {function}"))
        return int(line.split()[0], 16)

    def ask(self, *offsets: int, module: Module | None = None, is_fault: bool) -> Finding:
        module = module or self.module
        frames = [StackFrame("", "", module.name, offset) for offset in offsets]
        signature = Signature("SIGSEGV" if is_fault else "SIGABRT", ())
        (found,) = located([crash(frames, module, signature=signature)], (self.folder,))
        return found


def crash(
    frames: Iterable[StackFrame], *modules: Module, signature: Signature | None = None
) -> Finding:
    return Finding(
        kind="crashed",
        rank=0,
        says="crashed",
        name="/a",
        times_ns=(1,),
        frames=tuple(frames),
        modules=modules,
        signature=signature,
    )


def run(*command: object) -> None:
    subprocess.run([str(each) for each in command], check=True)


def build(folder: Path, *options: str, text: str = SOURCE, source: Path | None = None) -> Library:
    source = source or folder / "lib.c"
    source.write_text(text)
    path = folder / "libadd.so"
    # As with an installed package: the paths in it are relative.
    run("cc", "-O0", "-shared", "-fPIC", "-Wl,--build-id", *options, source, "-o", path)
    return Library(path, folder / "debug")


@pytest.fixture
def library(tmp_path: Path) -> Library:
    return build(tmp_path, "-g")


def line(found: Finding, number: int = 0) -> int:
    assert not found.problems
    return known(found, number).line


def known(found: Finding, number: int = 0) -> SourceLine:
    each = found.lines[number]
    assert each is not None
    return each


def test_the_lines_of_a_fault_and_of_a_call(library: Library) -> None:
    add, other = library.address("add"), library.address("other")
    found = library.ask(add, other, is_fault=True)
    assert line(found) == 2
    assert Path(known(found).file).name == "lib.c"
    # The other is where a call returns: what precedes it counts, which ends the function before.
    assert 2 <= line(found, 1) <= 6
    assert line(library.ask(other, is_fault=True)) == 7
    assert 2 <= line(library.ask(other, is_fault=False)) <= 6


def test_a_path_through_a_build_folder_is_shortened(tmp_path: Path) -> None:
    (tmp_path / "build").mkdir()
    library = build(tmp_path, "-g", source=tmp_path / "build" / ".." / "lib.c")
    found = library.ask(library.address("add"), is_fault=True)
    assert known(found).file == str(tmp_path / "lib.c")


def test_a_program_at_a_fixed_address(tmp_path: Path) -> None:
    source = tmp_path / "main.c"
    source.write_text("int main(void) {\n  return 0;\n}\n")
    path = tmp_path / "program"
    run("cc", "-g", "-O0", "-no-pie", "-Wl,--build-id", source, "-o", path)
    program = Library(path, tmp_path)
    assert line(program.ask(program.address("main"), is_fault=True)) == 1


def strip(library: Library, debug: Path) -> None:
    debug.parent.mkdir(parents=True, exist_ok=True)
    run("objcopy", "--only-keep-debug", library.path, debug)
    run("strip", "--strip-debug", library.path)


def test_the_debug_file_of_a_stripped_library_is_found_by_its_build_id(library: Library) -> None:
    at = library.address("add")
    build_id = library.module.build_id
    strip(library, library.folder / ".build-id" / build_id[:2] / f"{build_id[2:]}.debug")
    assert line(library.ask(at, is_fault=True)) == 2


@pytest.mark.parametrize("place", ["", ".debug"])
def test_the_debug_file_of_a_stripped_library_is_found_by_its_link(
    library: Library, place: str
) -> None:
    at = library.address("add")
    debug = library.path.parent / place / "libadd.so.debug"
    strip(library, debug)
    run("objcopy", f"--add-gnu-debuglink={debug}", library.path)
    assert line(library.ask(at, is_fault=True)) == 2


def test_a_debug_file_in_the_cache_of_debuginfod_is_found(
    library: Library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    at = library.address("add")
    monkeypatch.setenv("DEBUGINFOD_CACHE_PATH", str(tmp_path / "cache"))
    strip(library, tmp_path / "cache" / library.module.build_id / "debuginfo")
    assert line(library.ask(at, is_fault=True)) == 2


def test_a_debug_file_of_another_build_is_not_believed(library: Library, tmp_path: Path) -> None:
    at = library.address("add")
    debug = library.path.parent / "libadd.so.debug"
    strip(library, debug)
    run("objcopy", f"--add-gnu-debuglink={debug}", library.path)
    (tmp_path / "other").mkdir()
    shutil.copy(build(tmp_path / "other", "-g", text=f"\n\n{SOURCE}").path, debug)
    found = library.ask(at, is_fault=True)
    assert not any(found.lines)
    assert "no debug file" in found.problems[0]


def test_another_build_is_named_and_gives_no_line(library: Library) -> None:
    then, at = library.module, library.address("add")
    build(library.path.parent, "-g", text=f"\n\n{SOURCE}")
    found = library.ask(at, module=then, is_fault=True)
    assert not any(found.lines)
    assert "is another build now" in found.problems[0]
    assert then.build_id[:12] in found.problems[0]


def test_without_debug_information_the_fix_is_named(tmp_path: Path) -> None:
    library = build(tmp_path)
    found = library.ask(library.address("add"), is_fault=True)
    assert "build it with -g" in found.problems[0]


def test_a_library_that_is_gone_is_named(library: Library) -> None:
    module = library.module
    library.path.unlink()
    found = library.ask(1, module=module, is_fault=True)
    assert found.problems[0] == f"no source line: {library.path} is not on this machine"


def test_without_a_build_id_nothing_is_believed(tmp_path: Path) -> None:
    library = build(tmp_path, "-g", "-Wl,--build-id=none")
    assert library.module.build_id == ""
    found = library.ask(library.address("add"), is_fault=True)
    assert "no build id" in found.problems[0]


def test_the_missing_tool_is_named(library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    at = library.address("add")
    monkeypatch.setenv("PATH", "/nowhere")
    found = library.ask(at, is_fault=True)
    assert found.problems[0] == "no source line: addr2line is not installed; install binutils"


def test_a_library_is_read_once_for_all_findings(
    library: Library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = shutil.which("addr2line")
    tool, runs = tmp_path / "bin" / "addr2line", tmp_path / "runs"
    tool.parent.mkdir()
    tool.write_text(f'#!/bin/sh\necho run >> {runs}\nexec {real} "$@"\n')
    tool.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tool.parent}:{os.environ['PATH']}")
    places = (library.address("add"), library.address("other"))
    findings = [
        crash([StackFrame("", "f", "libadd.so", at + 1)], library.module) for at in places * 10
    ]
    findings.insert(3, Finding(kind="unfinished", rank=7, says="", times_ns=(1,)))
    found = located(findings, (library.folder,))
    assert runs.read_text() == "run\n"
    assert [str(each.place.line).rpartition(":")[2] for each in found[:5]] == [
        "2", "7", "2", "None", "7"
    ]  # fmt: skip


def test_a_function_that_the_container_had_no_time_to_look_up_is_named(library: Library) -> None:
    at = library.address("add") + 1
    lines = (f"#0 libadd.so+0x{at:x}", f"#1 known+0x4 (libadd.so+0x{at:x})", "#2 0x10")
    (found,) = located([crash(map(frame_of, lines), library.module)], (library.folder,))
    assert [frame.text for frame in found.frames] == [f"#0 add (libadd.so+0x{at:x})", *lines[1:]]
    assert [frame.function for frame in found.frames] == ["add", "known", ""]


def test_a_library_that_the_recording_does_not_describe_is_named() -> None:
    (found,) = located([crash([StackFrame("", "", "libold.so", 5)])])
    text = "the recording does not say which build libold.so was"
    assert found.problems == (f"no source line: {text}",)


def test_a_module_is_read() -> None:
    assert module_of("lib.so 4ae3 /a b/lib.so") == Module("lib.so", "4ae3", "/a b/lib.so")
    assert module_of("lib.so - /lib.so") == Module("lib.so", "", "/lib.so")
    assert module_of("nonsense") is None


def test_any_file_can_be_asked(library: Library, tmp_path: Path) -> None:
    whole = library.path.read_bytes()
    for size in (0, 3, 40, 64, 200, len(whole) - 10):
        cut = tmp_path / "cut.so"
        cut.write_bytes(whole[:size])
        found = read_elf(cut)
        assert found is None or found.path == cut
    assert read_elf(tmp_path) is None
    assert read_elf(tmp_path / "nothing") is None


def test_where_debug_files_are_looked_for() -> None:
    elf = read_elf(Path("/proc/self/exe"))
    assert elf is not None
    places = list(debug_files(elf._replace(build_id="abcd", debug_link="x.debug"), environ={}))
    assert Path("/usr/lib/debug/.build-id/ab/cd.debug") in places
    assert all(place.is_absolute() for place in places)

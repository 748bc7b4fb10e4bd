"""Puts the overlay in place and takes it away: planned first, written in one step, verified."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import importlib.metadata
import json
import os
import shutil
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Final

from play_launch.graph_daemon.patch import PatchError, VerificationError
from play_launch.graph_daemon.patch.known import KNOWN, Known
from play_launch.graph_daemon.patch.manifest import (
    FILE,
    PACKAGE,
    STARTER,
    Manifest,
    Ros2cli,
    digest_of,
    manifest_in,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.graph_daemon.patch.target import Target

_SOURCE: Final = Path(__file__).with_name("overlay")
# In one line, as Python wants it; silent when the package has been removed without this file.
_START: Final = (
    f'import sys; exec("try:\\n    import {PACKAGE} as o; o.install()\\n'
    'except ImportError:\\n    pass")\n'
)


class Action(Enum):
    """What putting the overlay in place amounts to."""

    NOTHING = "nothing"
    """It is there already, the same."""
    WRITE = "write"
    REPLACE = "replace"
    """It is there, but written by another release or for another ros2cli."""


@dataclass(frozen=True, slots=True)
class PatchPlan:
    """What ``carry_out`` will do.

    Attributes:
        target: The Python whose ros2cli is changed.
        distribution: The ROS 2 distribution that it belongs to.
        place: The folder that is written to.
        action: Whether anything is to be done.
        contents: What is written, by path relative to ``place``.
    """

    target: Target
    distribution: str
    place: Path
    action: Action
    contents: dict[str, bytes]

    def carry_out(self) -> None:
        """Write and verify.

        Raises ``PatchError``, also for missing permissions, and ``VerificationError`` if ros2cli
        does not work with it; everything is then as it was.
        """
        if self.action is Action.NOTHING:
            return
        with _permissions(self.place, ", or use --user to change ros2 for yourself alone"):
            made = _make_folders(self.place)
            try:
                with _locked(self.place):
                    self._write(made)
            except BaseException:
                _remove_folders(made)
                raise

    def _write(self, made: list[Path]) -> None:
        package, new, old = (self.place / f"{PACKAGE}{end}" for end in ("", ".new", ".old"))
        starter = self.place / STARTER
        before = manifest_in(self.place)
        kept = [*(before.made_folders if before else ()), *map(str, made)]
        manifest = Manifest(
            ros2cli=Ros2cli(
                folder=str(self.target.folder),
                version=self.target.version,
                distribution=self.distribution,
                files=_ros2cli_digests(self.target),
            ),
            files={name: _digest(content) for name, content in self.contents.items()},
            made_folders=tuple(kept),
            written_by=_own_name(),
        )
        for rest in (new, old):
            # Of a run that was killed; the lock says that nobody is at it.
            shutil.rmtree(rest, ignore_errors=True)
        starter_before = starter.read_bytes() if starter.exists() else None
        try:
            self._write_package(new, manifest)
            if package.exists():
                package.rename(old)
            new.rename(package)
            _write_file(starter, self.contents[STARTER])
            verify(self.target)
        except BaseException:
            # First what starts it, so that no Python comes up with half of it.
            if starter_before is None:
                starter.unlink(missing_ok=True)
            shutil.rmtree(new, ignore_errors=True)
            if old.exists() or before is None:
                shutil.rmtree(package, ignore_errors=True)
            if old.exists():
                old.rename(package)
            if starter_before is not None and starter.read_bytes() != starter_before:
                _write_file(starter, starter_before)
            raise
        shutil.rmtree(old, ignore_errors=True)

    def _write_package(self, folder: Path, manifest: Manifest) -> None:
        folder.mkdir()
        folder.chmod(0o755)
        for name, content in self.contents.items():
            if name != STARTER:
                _write_file(folder / Path(name).name, content)
        _write_file(folder / FILE, manifest.to_json())


def plan_patch(
    target: Target, *, for_user: bool = False, force: bool = False, known: Known = KNOWN
) -> PatchPlan:
    """Find out what is to be done; nothing is changed.

    Raises ``PatchError`` for a ros2cli that is not known, and for an overlay that somebody has
    edited, unless ``force``.
    """
    distribution = known.check(target.folder, target.version)
    contents = {
        f"{PACKAGE}/{path.name}": path.read_bytes() for path in sorted(_SOURCE.glob("*.py"))
    }
    contents[STARTER] = _START.encode()
    found = overlays(target)
    if not found:
        place = target.place(for_user=for_user)
        return PatchPlan(target, distribution, place, Action.WRITE, contents)
    # One is enough, wherever it is.
    place, manifest = found[0]
    refuse_edited(place, manifest, force=force)
    same = (
        manifest.files == {name: _digest(content) for name, content in contents.items()}
        and all((place / name).exists() for name in manifest.files)
        and not manifest.edited(place)
        and manifest.ros2cli.files == _ros2cli_digests(target, known)
    )
    action = Action.NOTHING if same else Action.REPLACE
    return PatchPlan(target, distribution, place, action, contents)


def overlays(target: Target) -> list[tuple[Path, Manifest]]:
    """Find the overlays that are in place; more than one only where Python's folders changed."""
    found = ((place, manifest_in(place)) for place in target.places)
    return [(place, manifest) for place, manifest in found if manifest is not None]


def refuse_edited(place: Path, manifest: Manifest, *, force: bool) -> None:
    """Raise ``PatchError`` when somebody has worked on the overlay's files."""
    touched = [*manifest.edited(place), *manifest.unknown(place)]
    if touched and not force:
        names = ", ".join(map(str, touched))
        raise PatchError(
            f"edited or added since they were written: {names}. Nothing was changed; save them if "
            "they matter, then use --force"
        )


def remove(place: Path, manifest: Manifest, *, force: bool = False) -> None:
    """Take an overlay away, with what Python has compiled of it.

    Raises ``PatchError`` when its files were edited, unless ``force``, or for want of permissions.
    """
    refuse_edited(place, manifest, force=force)
    with _permissions(place), _locked(place):
        if not os.access(place / PACKAGE, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(place / PACKAGE))
        # First what starts it.
        (place / STARTER).unlink(missing_ok=True)
        shutil.rmtree(place / PACKAGE)
    _remove_folders([Path(folder) for folder in manifest.made_folders])


def verify(target: Target) -> None:
    """Import ros2cli's daemon in its Python and make a call; raises ``VerificationError``."""
    outcome = target.run(["-m", f"{PACKAGE}.verify"])
    try:
        problems = json.loads(outcome.stdout.rstrip().rpartition("\n")[2])["problems"]
    except (ValueError, TypeError, KeyError):
        lines = outcome.stderr.rstrip().splitlines()
        problems = [lines[-1] if lines else f"it ended with status {outcome.returncode}"]
    if problems or outcome.returncode:
        raise VerificationError(
            "ros2cli does not work with the changes, so they were taken back: "
            + "; ".join(map(str, problems))
        )


def _ros2cli_digests(target: Target, known: Known = KNOWN) -> dict[str, str]:
    return {name: digest_of(target.folder / name) for name in known.files}


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _own_name() -> str:
    try:
        return f"play-launch {importlib.metadata.version('play-launch-py')}"
    except importlib.metadata.PackageNotFoundError:
        return "play-launch"


def _write_file(path: Path, content: bytes) -> None:
    """Write a file whole or not at all, readable for everybody whatever the umask is."""
    part = path.with_name(f"{path.name}.part")
    part.write_bytes(content)
    part.chmod(0o644)
    part.rename(path)


def _make_folders(place: Path) -> list[Path]:
    missing = [folder for folder in (place, *place.parents) if not folder.exists()][::-1]
    made: list[Path] = []
    try:
        for folder in missing:
            folder.mkdir(mode=0o755)
            made.append(folder)
    except BaseException:
        _remove_folders(made)
        raise
    return made


def _remove_folders(folders: list[Path]) -> None:
    """Remove folders that we have made, as far as nobody uses them."""
    for folder in reversed(folders):
        with contextlib.suppress(OSError):
            folder.rmdir()


@contextlib.contextmanager
def _locked(place: Path) -> Iterator[None]:
    """Keep a second run away from ``place`` until the end."""
    descriptor = os.open(place, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError:
        raise PatchError(f"another patch or unpatch is at work in {place}") from None
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def _permissions(place: Path, otherwise: str = "") -> Iterator[None]:
    """Turn what the system refuses into advice."""
    try:
        yield
    except OSError as error:
        if isinstance(error, PermissionError) or error.errno == errno.EROFS:
            raise PatchError(
                f"{place} cannot be written to by this user; run the same command as a user who "
                f"may (for example with sudo, and the environment of your ROS){otherwise}"
            ) from None
        raise PatchError(f"{error.filename or place}: {error.strerror or error}") from None

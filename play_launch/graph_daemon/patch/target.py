"""The Python of an installed ROS 2, asked about itself and about its ros2cli.

It is another one than ours as a rule: Humble's is 3.10, and ours may live in an environment.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from play_launch.graph_daemon.patch import PatchError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

_LIMIT: Final = 60.0
"""Seconds; importing rclpy on a loaded machine takes a few."""
_BOOTSTRAP: Final = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
_OLDEST: Final = (3, 10)

# Runs in that Python, so nothing newer than 3.10 may be used.
_QUESTIONS: Final = """
import importlib.metadata, importlib.util, json, site, sys
spec = importlib.util.find_spec("ros2cli")
try:
    version = importlib.metadata.version("ros2cli")
except importlib.metadata.PackageNotFoundError:
    version = ""
print()
print(json.dumps({
    "version": sys.version_info[:2],
    "prefix": sys.prefix,
    "folder": next(iter(spec.submodule_search_locations or ()), "") if spec else "",
    "ros2cli": version,
    "sites": site.getsitepackages(),
    "user_site": site.getusersitepackages() if site.ENABLE_USER_SITE else "",
}))
"""


@dataclass(frozen=True, slots=True)
class Target:
    """A Python and the ros2cli that it imports.

    Attributes:
        python: The interpreter.
        environment: Of processes that run it.
        folder: Where ros2cli's modules are; meaningless, as ``version``, where it may be gone.
        version: ros2cli's release.
        sites: The folders whose ``.pth`` files this Python reads; the first is the one for what
            the administrator adds.
        user_site: The same for its user; None where users have none, as in an environment.
    """

    python: Path
    environment: Mapping[str, str]
    folder: Path
    version: str
    sites: tuple[Path, ...]
    user_site: Path | None

    def place(self, *, for_user: bool) -> Path:
        """Choose the folder for the overlay: ros2cli's own where ``.pth`` files work there.

        A sourced ROS is found by PYTHONPATH, where they do not; then the first of ``sites``.
        """
        if for_user:
            if self.user_site is None:
                raise PatchError(
                    f"{self.python} reads no packages of its user; leave --user away, what is "
                    "installed there belongs to its environment"
                )
            return self.user_site
        own = self.folder.parent
        return own if own in self.sites else self.sites[0]

    @property
    def places(self) -> tuple[Path, ...]:
        """Everywhere an overlay can be."""
        return (*self.sites, *([self.user_site] if self.user_site else []))

    def run(self, arguments: Sequence[str]) -> subprocess.CompletedProcess[str]:
        """Run the interpreter and take its output; raises ``PatchError`` if it cannot be run."""
        return _run(self.python, arguments, self.environment)


def find_target(
    python: Path | None,
    environment: Mapping[str, str] = os.environ,
    *,
    needs_ros2cli: bool = True,
) -> Target:
    """Ask ``python``, or without it the Python that the command ``ros2`` starts.

    Without ``needs_ros2cli``, ros2cli may be gone meanwhile: what was put in place for it can be
    taken away all the same. Raises ``PatchError`` when there is no such Python, when it does not
    work, or has no ros2cli.
    """
    interpreter = (python or _python_of_ros2(environment)).absolute()
    clean = _environment_for(interpreter, environment)
    outcome = _run(interpreter, ["-c", _QUESTIONS], clean)
    try:
        facts = json.loads(outcome.stdout.rpartition("\n\n")[2] or "null")
        version = tuple(facts["version"])
        sites = tuple(dict.fromkeys(Path(site) for site in facts["sites"]))
        folder, release, user_site = facts["folder"], facts["ros2cli"], facts["user_site"]
    except (ValueError, TypeError, KeyError):
        raise PatchError(
            f"{interpreter} does not work as a Python: {_last_line(outcome.stderr)}"
        ) from None
    if version < _OLDEST:
        raise PatchError(f"{interpreter} is Python {version[0]}.{version[1]}; 3.10 is needed")
    if not folder and needs_ros2cli:
        raise PatchError(
            f"{interpreter} has no ros2cli; source your ROS 2 first, or name its Python: "
            "--python PATH"
        )
    if not release and needs_ros2cli:
        raise PatchError(f"the release of ros2cli in {folder} is not recorded there")
    return Target(
        interpreter, clean, Path(folder), release, sites, Path(user_site) if user_site else None
    )


def _python_of_ros2(environment: Mapping[str, str]) -> Path:
    search = environment.get("PATH", os.defpath)
    program = shutil.which("ros2", path=search)
    if program is None:
        raise PatchError(
            "there is no command ros2 here; source your ROS 2 first, or name the Python that has "
            "ros2cli: --python PATH"
        )
    with Path(program).open("rb") as file:
        first = file.readline(4096).decode("utf-8", "replace").rstrip()
    words = first.removeprefix("#!").split()
    if first.startswith("#!") and words:
        name = words[1] if Path(words[0]).name == "env" and len(words) == 2 else words[0]
        found = shutil.which(name, path=search)
        if found and Path(name).name.startswith("python"):
            return Path(found)
    raise PatchError(f"{program} does not say which Python it is for; name it: --python PATH")


def _environment_for(interpreter: Path, environment: Mapping[str, str]) -> dict[str, str]:
    """Take what our own environment of ROS wheels has set out of ``environment``.

    Another Python would load our libraries, or not look for its own.
    """
    clean = dict(environment)
    if interpreter.parent.resolve() == (Path(sys.prefix) / "bin").resolve():
        return clean
    clean.pop(_BOOTSTRAP, None)
    folders = clean.pop("LD_LIBRARY_PATH", "").split(os.pathsep)
    others = [folder for folder in folders if folder and not folder.startswith(f"{sys.prefix}/")]
    if others:
        clean["LD_LIBRARY_PATH"] = os.pathsep.join(others)
    return clean


def _run(
    python: Path, arguments: Sequence[str], environment: Mapping[str, str]
) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(
            [str(python), *arguments],
            env=environment,
            # Not where we are: Python looks for modules there.
            cwd="/",
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_LIMIT,
            check=False,
        )
    except OSError as error:
        raise PatchError(f"{python} cannot be run: {error.strerror or error}") from None
    except subprocess.TimeoutExpired:
        raise PatchError(f"{python} has not answered within {_LIMIT:g} s") from None


def _last_line(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip()]
    return lines[-1].strip() if lines else "it said nothing"

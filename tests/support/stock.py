"""Stock containers for tests: the double as a program in a prefix of its own, and its journal."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from play_launch.config.substitutions import ament_prefixes
from play_launch.container.command import NotInPackageError, find_executable
from play_launch.container.environment import child_environment
from play_launch.container.ros import ros_installation
from tests.support import stock_double

PACKAGE = "stock_double"
EXECUTABLE = "container"


@dataclass(frozen=True)
class Double:
    """The double, installed; ``environment`` has to be that of the process that looks for it."""

    prefix: Path
    state: Path

    @property
    def environment(self) -> dict[str, str]:
        present = os.environ.get("AMENT_PREFIX_PATH", "")
        return {
            "AMENT_PREFIX_PATH": os.pathsep.join(filter(None, [str(self.prefix), present])),
            stock_double.STATE: str(self.state),
        }

    @property
    def program(self) -> Path:
        return self.prefix / "lib" / PACKAGE / EXECUTABLE

    def journal(self, word: str) -> list[list[str]]:
        """The rest of each line of that kind, in the order of the file."""
        path = self.state / stock_double.JOURNAL
        lines = path.read_text().splitlines() if path.exists() else []
        return [line.split()[2:] for line in lines if line.split()[1] == word]

    def alive(self) -> list[str]:
        """Names of the nodes that were constructed and not destroyed, of all processes."""
        names = [name for name, _ in self.journal("construct")]
        for name, _ in self.journal("destroy"):
            names.remove(name)
        return sorted(names)


def install(folder: Path) -> Double:
    """Make a prefix that holds the double as ``lib/stock_double/container``."""
    double = Double(folder / "prefix", folder / "state")
    double.program.parent.mkdir(parents=True)
    double.state.mkdir()
    double.program.write_text(
        f"#!{sys.executable}\nimport runpy\n"
        f"runpy.run_path({stock_double.__file__!r}, run_name='__main__')\n"
    )
    double.program.chmod(0o755)
    return double


@contextmanager
def running_double(
    double: Double, *arguments: str, name: str = "theirs"
) -> Iterator[subprocess.Popen[bytes]]:
    """Run the double without a supervisor; afterwards it is gone."""
    process = subprocess.Popen(
        [str(double.program), *arguments, "--ros-args", "-r", f"__node:={name}"],
        env={**child_environment(os.environ, ros_installation()), **double.environment},
    )
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(timeout=60)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def rclcpp_container() -> Path | None:
    """The real ``component_container`` of rclcpp_components, if this machine has it."""
    environment = child_environment(os.environ, ros_installation())
    try:
        return find_executable(
            "rclcpp_components", "component_container", ament_prefixes(environment)
        )
    except NotInPackageError:
        return None


def has_components(package: str) -> bool:
    """Whether this machine has the rclcpp components of a package."""
    environment = child_environment(os.environ, ros_installation())
    index = Path("share/ament_index/resource_index/rclcpp_components") / package
    return any((prefix / index).is_file() for prefix in ament_prefixes(environment))

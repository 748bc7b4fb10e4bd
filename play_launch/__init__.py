"""play-launch: brings up a whole ROS 2 system from one YAML file and records what happened."""

from enum import IntEnum


class ExitCode(IntEnum):
    """Exit codes of all commands; docs/control.md#exit-codes explains them."""

    OK = 0
    NODE_FAILED = 1
    """Failure: of a node, of a request; or `diff`, `compare`, `explain` found something."""
    USAGE = 2
    NODES_MISSING = 3
    """Something that was declared does not run, and has not failed."""
    TIMEOUT = 4
    DAMAGED = 5
    """A recording could not be read completely."""
    SIGNAL_BASE = 128


class UserError(Exception):
    """An error that the user can mend; a command that it ends prints its text."""

    exit_code: int = ExitCode.USAGE
    """Exit code of the command: 2 for what was given to it, 1 for what failed."""

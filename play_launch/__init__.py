"""play-launch: brings up a whole ROS 2 system from one YAML file and records what happened."""


class UserError(Exception):
    """An error that the user can mend; a command that it ends prints its text."""

    exit_code = 2
    """Exit code of the command: 2 for what was given to it, 1 for what failed."""

"""Makes an installed ros2cli's own daemon bear a start-up storm, without changing its files.

``overlay`` is copied beside ros2cli and hooks in when Python imports the daemon; the other modules
here put it in place and take it away. Nothing of ros2cli's source is here or in what is written.
"""


class PatchError(Exception):
    """An overlay was not put in place or not taken away; the text names the fix.

    Nothing was changed, or everything was put back.
    """


class VerificationError(PatchError):
    """The overlay was written, did not work, and was taken away again."""

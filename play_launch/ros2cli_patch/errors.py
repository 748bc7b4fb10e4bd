"""Why an overlay was not put in place or not taken away; each text names the fix."""

from __future__ import annotations


class PatchError(Exception):
    """Nothing was changed, or everything was put back."""


class VerificationError(PatchError):
    """The overlay was written, did not work, and was taken away again."""

"""``play-launch top``: the screen of a running session."""

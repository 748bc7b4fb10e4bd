"""The configuration file: read it, check it, resolve it into an immutable model."""

"""Packages that a test installs; they cannot be imported from here."""

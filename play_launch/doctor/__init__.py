"""Checks of this machine: what play-launch needs or profits from, and how to get it.

Changes nothing and knows no configuration.
"""

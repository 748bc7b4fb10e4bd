"""Recordings, read back: findings, pages, exports, comparisons, repair and retention.

Reads the formats of `play_launch.recording`, damaged files too. Knows no running system.
"""

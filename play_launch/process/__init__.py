"""Processes of this machine: starting, watching, reading, stopping them and cleaning up after them.

Everything here runs on the asyncio loop's thread unless a function says otherwise.
"""

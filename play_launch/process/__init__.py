"""Processes of this machine: start, observe, measure, stop them and clean up after them.

Owns signals, output, scheduling and control groups. Everything here runs on the asyncio loop's
thread unless a function says otherwise. Does not know what a process is for.
"""

"""Kinds of findings, each in one file: detection, words and importance.

A module has a function ``detect(timeline)`` that gives its findings; no list names the modules.
"""

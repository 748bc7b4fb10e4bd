"""The command line: one module for each verb, and the screen output that they share.

Owns options, help texts, tables and exit codes. Nothing imports it.
"""

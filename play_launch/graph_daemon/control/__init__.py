"""Starts and stops a daemon, whoever has its port."""

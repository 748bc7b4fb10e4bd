"""Crashes by the thousand: what the container, the supervisor and the neighbours make of them."""

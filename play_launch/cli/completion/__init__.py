"""Completes command lines of ``play-launch`` in bash, zsh and fish.

The scripts of the shells give the line up to the cursor to ``play-launch completion --answer`` and
get candidates, so that they know no verb and no option, and do not age.
"""

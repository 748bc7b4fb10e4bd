"""Running a system unattended: systemd units and the notifications of a service.

Does not know how a system is brought up.
"""

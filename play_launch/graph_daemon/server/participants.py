"""How many DDS participants this machine has in a domain, as the kernel knows it.

A participant that joins a domain meets the others one by one, some only after three seconds, and
nothing in the graph shows that somebody is still missing. But every participant binds UDP ports of
its own, by a rule that RTPS fixes (section 9.6.1.1), so the table of sockets gives their number.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

_TABLE: Final = Path("/proc/net/udp")
_BASE: Final = 7400
_PER_DOMAIN: Final = 250
_FIRST: Final = 10
"""Offset of the first participant's port for unicast discovery; those of the others are even."""
MOST: Final = (_PER_DOMAIN - _FIRST) // 2
"""With more participants their ports reach into those of the next domain."""


def count_participants(table: str, domain: int) -> int:
    """Count the participants of ``domain`` in a table like ``/proc/net/udp``; 120 at most.

    Those whose profile gives them other ports, and those of other machines and network
    namespaces, are not there.
    """
    first = _BASE + _PER_DOMAIN * domain + _FIRST
    wanted = range(first, first + 2 * MOST, 2)
    ports = set()
    for line in table.splitlines():
        fields = line.split()
        # The local address, in hexadecimal digits.
        address, colon, port = fields[1].rpartition(":") if len(fields) > 3 else ("", "", "")
        if colon and address:
            try:
                ports.add(int(port, 16))
            except ValueError:
                continue
    return sum(port in ports for port in wanted)


def participants_here(domain: int) -> int:
    """Count the participants of ``domain`` in this network namespace; 0 where they are hidden."""
    try:
        table = _TABLE.read_text(encoding="ascii")
    except (OSError, UnicodeDecodeError):
        return 0
    return count_participants(table, domain)

"""The process of a daemon in the background; `start_stop` starts it."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import logging
import os
import socket

from play_launch.graph_daemon.contract import DOMAIN_VARIABLE, WARM, DaemonAddress
from play_launch.graph_daemon.daemon import Daemon
from play_launch.process.time_slice import ask_for_more_turns, ask_for_short_turns


def main() -> None:
    """Run the daemon on the socket that the starter passes."""
    parser = argparse.ArgumentParser(prog="play_launch.graph_daemon")
    parser.add_argument("--domain", type=int, required=True)
    parser.add_argument("--listener", type=int, required=True, help="descriptor of the socket")
    parser.add_argument("--ready", type=int, required=True, help="descriptor to report on")
    parser.add_argument("--idle-timeout", type=float, required=True, help="seconds; 0 for never")
    options = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s")
    # Before there are other threads.
    ask_for_more_turns()
    ask_for_short_turns()
    address = DaemonAddress(options.domain)
    os.environ[DOMAIN_VARIABLE] = str(address.domain)
    daemon = Daemon(address, idle_timeout=options.idle_timeout)
    with open(options.ready, "w", encoding="ascii") as ready:  # noqa: PTH123 - a descriptor

        def report(what: str) -> None:
            # The starter may have gone.
            with contextlib.suppress(OSError):
                ready.write(f"{what}\n")
                ready.flush()
            if what == WARM:
                with contextlib.suppress(OSError):
                    ready.close()

        asyncio.run(daemon.run(socket.socket(fileno=options.listener), report))


if __name__ == "__main__":
    main()

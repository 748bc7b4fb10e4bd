"""What an event that came over the control socket says to a person, in one line or more."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, Final

from play_launch.cli.show.terminal import printable

if TYPE_CHECKING:
    from collections.abc import Mapping

OWN_NAME: Final = "play-launch"


def lines_of(event: Mapping[str, Any]) -> str:
    """Write an event as `supervisor.event_object` makes it; a text of several lines stays."""
    source, text = _words(event)
    clean = printable(text, colour=False).replace("\n", f"\n{' ' * 13}")
    return f"{clock(event.get('stamp_ns', 0))} [{printable(source, colour=False)}] {clean}"


def clock(stamp_ns: int) -> str:
    """Write the local time of day to the millisecond."""
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    return f"{time.strftime('%H:%M:%S', time.localtime(seconds))}.{rest // 1_000_000:03}"


def _words(event: Mapping[str, Any]) -> tuple[str, str]:
    match event.get("event"):
        case "node":
            return event["container"], _because(
                f"{event['node']} {event['state']}", event["reason"]
            )
        case "container":
            return event["container"], _because(event["state"], event["reason"])
        case "process":
            return event["name"], _because(
                str(event["kind"]).replace("_", " "), event["message"] or _pid(event)
            )
        case "component":
            name = event["full_node_name"] or event["plugin_name"]
            text = _because(str(event["kind"]).replace("_", " "), event["error_message"])
            return name, "\n".join([text, *(f"  {frame}" for frame in event["backtrace"])])
        case "output":
            return event["process"], event["text"] + (" [cut]" if event["truncated"] else "")
        case "log":
            return OWN_NAME, event["message"]
        case "action":
            names = ", ".join(event["targets"])
            who = f"user {event['uid']}, pid {event['pid']}: {event['command']}"
            text = _because(f"{event['action']} {names} {event['phase']}", event["reason"])
            return OWN_NAME, f"{text} ({who})" if event["phase"] == "requested" else text
        case "managed" if event["state"] == "failed":
            return event["node"], f"autostart failed: {event['reason']}"
        case "managed":
            is_known = event["state"] not in {"absent", "asked"}
            return event["node"], f"is {event['state']}" if is_known else "lifecycle state unknown"
        case "graph":
            came = [f"+ {name}" for name in event["appeared"]]
            went = [f"- {name}" for name in event["vanished"]]
            return "graph", ", ".join([*came, *went])
        case other:
            return OWN_NAME, f"{other}: " + ", ".join(
                f"{name} {value}"
                for name, value in event.items()
                if name not in {"event", "stamp_ns"} and value not in ("", None)
            )


def _because(what: str, reason: str) -> str:
    return f"{what}: {reason}" if reason else what


def _pid(event: Mapping[str, Any]) -> str:
    return f"pid {event['pid']}" if event["pid"] else ""

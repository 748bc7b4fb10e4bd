"""What ``play-launch diff`` prints of a plan."""

from __future__ import annotations

from typing import Any

from play_launch.cli.apply import plan_lines

WORDS = "/driver to be started; the file /flag, at most 2 s, else start; 0.5 s more"


def step(name: str, action: str, *changes: dict[str, Any]) -> dict[str, Any]:
    return {
        "name": name,
        "kind": "process" if name else "session",
        "action": action,
        "covered": False,
        "reason": "",
        "changes": list(changes),
    }


def change(path: str, before: Any, after: Any) -> dict[str, Any]:
    return {"path": path, "before": before, "after": after, "need": "nothing"}


def waiting(condition: str, subject: str, **more: Any) -> dict[str, Any]:
    common = {"unit": "", "timeout": "never", "on_timeout": "fail"}
    return {"condition": condition, "subject": subject, **common, **more}


def lines(*steps: dict[str, Any]) -> list[str]:
    return list(plan_lines({"steps": steps}, colour=False))


def test_what_something_waits_for_is_put_into_words() -> None:
    on_file = waiting("file", "/flag", timeout=2.0, on_timeout="start")
    on_driver = waiting("started", "", unit="/driver")
    made = {"delay": 0.5, "dependencies": [on_driver, on_file]}
    assert lines(
        step(
            "",
            "adopt",
            change("start_rules./a", None, made),
            change("start_rules./b.dependencies", [on_driver], []),
            change("start_rules./b.delay", 0.0, 2.0),
            change("stop.sigterm", 1.0, 2.0),
        )
    ) == [
        "~ session: adopt",
        f"    /a depends_on: (none) -> {WORDS}  (taken over at once)",
        "    /b depends_on: /driver to be started -> (none)  (taken over at once)",
        "    /b start_delay: 0.0 -> 2.0  (taken over at once)",
        "    stop.sigterm: 1.0 -> 2.0  (taken over at once)",
        "0 to add, 1 to change, 0 to remove",
    ]


def test_what_comes_or_goes_takes_its_start_rules_along() -> None:
    made = {"delay": 0.0, "dependencies": [waiting("file", "/flag")]}
    come = step("/a", "add")
    assert lines(come, step("", "adopt", change("start_rules./a", None, made))) == [
        "+ /a (process): add",
        "1 to add, 0 to change, 0 to remove",
    ]

"""Lets units start when their rules say so; :mod:`play_launch.core.order` decides."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING, Final

from play_launch.core.events import REPORTED_LOGGER
from play_launch.core.order import OrderRecord, Verdict, decide, forget, release, want

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from play_launch.core.dependency import Dependency, StartRule
    from play_launch.core.order import Look

_log = logging.getLogger(__name__)
_reported = logging.getLogger(REPORTED_LOGGER)

REPORT_INTERVAL: Final = 15.0
"""Seconds between two reports of one that waits."""
_RETRY_INTERVAL: Final = 1.0
"""Seconds after an exception until the order is evaluated again."""


class StartOrder:
    """Belongs to the thread of the event loop."""

    def __init__(
        self,
        *,
        look: Callable[[Dependency], Look],
        watch: Callable[[tuple[Dependency, ...]], None],
        report: Callable[[str, str], None],
    ) -> None:
        """Know no rules yet, see `use`.

        Args:
            look: Says how a condition stands.
            watch: Gets what is waited for, whenever that changes.
            report: Publishes of a unit what it waits for.
        """
        self._rules: Mapping[str, StartRule] = {}
        self._look = look
        self._watch = watch
        self._report = report
        self._loop = asyncio.get_running_loop()
        self._record = OrderRecord()
        self._on_verdict: dict[str, Callable[[Verdict], None]] = {}
        self._reports: dict[str, str] = {}
        self._report_due: dict[str, float] = {}
        self._watched: tuple[Dependency, ...] = ()
        self._timer: asyncio.TimerHandle | None = None
        self._is_due = False
        self._is_closed = False

    def use(self, rules: Mapping[str, StartRule]) -> None:
        """Take the rules by unit; only units that are in it ever wait."""
        self._rules = rules
        for unit in self._record.waiting.keys() - rules.keys():
            self.release(unit)
        self.look_again()

    def holds(self, unit: str) -> bool:
        """Whether the unit has to wait, if it is wanted."""
        return unit in self._rules and unit not in self._record.released

    def want(self, unit: str, on_verdict: Callable[[Verdict], None]) -> None:
        """Have a unit that has to wait start as soon as it may."""
        if unit not in self._record.waiting:
            self._record = want(self._record, unit, self._loop.time())
            self._report_due[unit] = self._loop.time() + REPORT_INTERVAL
        self._on_verdict[unit] = on_verdict
        self.look_again()

    async def turn(self, unit: str) -> str:
        """Wait until a unit may start; says why it never may, or nothing."""
        if not self.holds(unit):
            return ""
        verdict: asyncio.Future[Verdict] = self._loop.create_future()

        def decided(said: Verdict) -> None:
            if not verdict.done():
                verdict.set_result(said)

        self.want(unit, decided)
        try:
            said = await verdict
        except asyncio.CancelledError:
            self.forget(unit)
            raise
        return said.reason if said.fails else ""

    def release(self, unit: str) -> None:
        """Let a unit start whatever it waits for: somebody asked for that."""
        if self.holds(unit) or unit in self._record.waiting:
            self._record = release(self._record, unit, self._loop.time())
            self._settle(Verdict(unit, fails=False))
            self.look_again()

    def look_again(self) -> None:
        """Something has changed: look at all that wait, once for all changes of this moment."""
        if self._record.waiting and not self._is_due and not self._is_closed:
            self._is_due = True
            self._loop.call_soon(self._decide)

    def close(self) -> None:
        """Let nobody through any more: the system stops."""
        self._is_closed = True
        if self._timer is not None:
            self._timer.cancel()

    def _decide(self) -> None:
        self._is_due = False
        if self._is_closed:
            return
        if self._timer is not None:
            self._timer.cancel()
        due: float | None = self._loop.time() + _RETRY_INTERVAL
        try:
            due = self._carry_out_decisions()
        except Exception:  # noqa: BLE001 - units would wait for ever
            _log.exception("start order failed; it is evaluated again in %g s", _RETRY_INTERVAL)
        self._timer = self._loop.call_at(due, self.look_again) if due is not None else None

    def _carry_out_decisions(self) -> float | None:
        """Let through what may start; return when that has to be decided anew, if ever."""
        now = self._loop.time()
        self._record, verdicts, missing, next_at = decide(
            self._rules, self._record, self._look, now
        )
        for verdict in verdicts:
            if verdict.reason and not verdict.fails:
                _log.warning("%s starts all the same: %s", verdict.unit, verdict.reason)
            self._settle(verdict)
        for unit, dependencies in missing.items():
            self._report_wait(unit, dependencies, now)
        watched = tuple(dict.fromkeys(each for open_ in missing.values() for each in open_))
        if watched != self._watched:
            self._watched = watched
            self._watch(watched)
        reports = (self._report_due[unit] for unit in missing)
        if verdicts:
            # What has failed may be what others wait for.
            self.look_again()
        return min((at for at in (next_at, *reports) if at is not None), default=None)

    def _settle(self, verdict: Verdict) -> None:
        self._reports.pop(verdict.unit, None)
        self._report_due.pop(verdict.unit, None)
        if on_verdict := self._on_verdict.pop(verdict.unit, None):
            on_verdict(verdict)

    def forget(self, unit: str) -> None:
        """Have a unit wait no longer: it is not wanted any more. The next time it waits anew."""
        self._record = forget(self._record, unit)
        self._on_verdict.pop(unit, None)
        self._reports.pop(unit, None)
        self.look_again()

    def _report_wait(self, unit: str, dependencies: tuple[Dependency, ...], now: float) -> None:
        what = ", ".join(map(str, dependencies))
        rule = self._rules[unit]
        text = f"waits for {what}" if what else f"waits for its delay of {rule.delay:g} s"
        if self._reports.get(unit) != text:
            self._reports[unit] = text
            self._report(unit, text)
        if now >= self._report_due[unit]:
            self._report_due[unit] = now + REPORT_INTERVAL
            since = now - self._record.waiting[unit].since
            _reported.warning("%s has waited for %.0f s: it %s", unit, since, text)

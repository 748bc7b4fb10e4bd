"""Another configuration for a system that runs: machines are changed, added and removed."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from typing import TYPE_CHECKING, Any, Final

import anyio
from msgspec import to_builtins
from msgspec.structs import asdict, replace

from play_launch.config.machines import DiscoveryBy, part_of, used_machines
from play_launch.control.protocol import Code, OperationError
from play_launch.control.serve import read_change
from play_launch.deploy.machines.hosts import HostError, LinkLost
from play_launch.deploy.machines.part import BEGUN, OVER
from play_launch.deploy.unit import stop_seconds
from play_launch.supervisor.events import MachineState
from play_launch.supervisor.plan import Plan, Result, plan

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from play_launch.config.model import ReplayConfig
    from play_launch.control.messages import Caller, ChangeRequest
    from play_launch.deploy.machines.bundle import Bundle
    from play_launch.deploy.machines.coordinator import Coordinator
    from play_launch.deploy.machines.part import Part

    Report = Callable[[dict[str, Any]], None]
    """Takes the outcome of a step."""

_log = logging.getLogger(__name__)
_PLACE: Final = ("local", "ssh", "service")
"""What makes a machine another one."""


class Applying:
    """Carries out `apply` and `diff`, one change at a time."""

    def __init__(self, coordinator: Coordinator) -> None:
        self._coordinator = coordinator
        self._task: asyncio.Task[dict[str, Any]] | None = None

    async def __call__(self, request: ChangeRequest, caller: Caller) -> object:
        """Send the plan, and apply it unless it is a dry run; raises OperationError."""
        target = await read_change(request)
        if request.text is not None:
            text = "a launch file has no machines; write it with dump first"
            raise OperationError(Code.BAD_ARGUMENTS, text)
        ended: asyncio.Queue[dict[str, Any] | None] = asyncio.Queue()
        change = _Change(self._coordinator, target, request, caller, ended.put_nowait)
        try:
            await change.compare()
            if request.dry_run:
                await change.close()
                return {"plan": change.plan, "applying": None}
            await caller.send("plan", change.plan)
            self._require_idle()
            change.begin()
        except BaseException:
            await change.close()
            raise
        # It is carried out to its end also when the client disconnects.
        self._task = task = asyncio.create_task(change.carry_out())
        self._coordinator.on_change()

        def close(task: asyncio.Task[dict[str, Any]]) -> None:
            self._coordinator.on_change()
            ended.put_nowait(None)
            _ = task.cancelled() or task.exception()  # of a client that has gone

        task.add_done_callback(close)
        while (outcome := await ended.get()) is not None:
            await caller.send("step", outcome)
        return {"applied": task.result()}

    @property
    def is_busy(self) -> bool:
        return self._task is not None and not self._task.done()

    def _require_idle(self) -> None:
        if self.is_busy:
            text = "another configuration is being applied; try again when it is done"
            raise OperationError(Code.REFUSED, text)


class _Change:
    """One change: what stays of each machine, what ends and what begins."""

    def __init__(
        self,
        coordinator: Coordinator,
        target: ReplayConfig,
        request: ChangeRequest,
        caller: Caller,
        report: Report,
    ) -> None:
        self._coordinator = coordinator
        self._target = target
        self._request = request
        self._caller = caller
        self._kept: dict[Part, Bundle] = {}
        self._removed: list[Part] = []
        self._added: list[Part] = []
        self._steps: dict[str, list[dict[str, Any]]] = {}
        """By machine."""
        self._outcomes: list[dict[str, Any]] = []
        self._failures: list[str] = []
        self._report = report

    @property
    def plan(self) -> dict[str, Any]:
        return {"steps": [step for steps in self._steps.values() for step in steps]}

    async def close(self) -> None:
        """Disconnect from what was to be added; nothing is changed."""
        for part in self._added:
            await part.close()

    def begin(self) -> None:
        """Add the new machines, before others end: a system without a machine is over."""
        self._coordinator.require_running()
        if joined := {part.name for part in self._added} & self._coordinator.there.keys():
            text = f"{', '.join(joined)} has just been added, as it answers by now; try again"
            raise OperationError(Code.REFUSED, text)
        self._coordinator.parts |= {part.name: part for part in self._added}

    async def compare(self) -> None:
        """Connect to what is new, bring all files, and compare; raises OperationError."""
        self._coordinator.require_running()
        there = self._coordinator.there
        used = used_machines(self._target)
        kept = [there[name] for name in used if name in there]
        self._removed = [part for name, part in there.items() if name not in used]
        added = [name for name in used if name not in there]
        self._refuse_what_cannot_change(kept, added)
        await self._prepare(added)
        for part in kept:
            self._kept[part] = await self._brought(part)
        for part in self._removed:
            found = plan(part.config, without_units(part.config))
            self._steps[part.name] = _steps_of_units(found, part)
        for part, bundle in self._kept.items():
            asked = {**self._changes(bundle), "dry_run": True}
            answer = await self._coordinator.requests.result(part, "apply", asked, self._caller)
            self._steps[part.name] = _steps(answer["plan"]["steps"], part)
        for part in self._added:
            found = plan(without_units(part.config), part.config)
            self._steps[part.name] = _steps_of_units(found, part)

    def _refuse_what_cannot_change(self, kept: list[Part], added: list[str]) -> None:
        again = "stop the system and replay the other configuration"
        for part in kept:
            if part.state is not MachineState.RUNNING:
                raise OperationError(Code.REFUSED, f"machine {part.name} is {part.state}")
            other = self._target.machines[part.name]
            for key in _PLACE:
                if getattr(part.machine, key) != getattr(other, key):
                    text = f"machine {part.name}: {key} has changed; {again}, or name it otherwise"
                    raise OperationError(Code.REFUSED, text)
        if added and self._target.discovery is DiscoveryBy.PEERS:
            text = f"what runs does not look for nodes on {', '.join(added)} (discovery by peers)"
            raise OperationError(Code.REFUSED, f"{text}; {again}")

    async def _prepare(self, names: list[str]) -> None:
        self._added = [
            self._coordinator.part(part_of(self._target, name), self._request.arguments)
            for name in names
        ]
        try:
            for part in await self._coordinator.prepare(self._added):
                self._added.remove(part)
        except HostError as error:
            raise OperationError(Code.REFUSED, f"nothing was changed\n{error}") from None

    async def _brought(self, part: Part) -> Bundle:
        try:
            return await part.bring(part_of(self._target, part.name), self._request.arguments)
        except (LinkLost, HostError) as error:
            raise OperationError(Code.REFUSED, f"machine {part.name}: {error}") from None

    def _changes(self, bundle: Bundle) -> dict[str, Any]:
        """Give the request for one machine; the variables are those of the machine."""
        values = {**asdict(self._request), "path": bundle.source}
        del values["text"], values["environment"]
        return values

    async def carry_out(self) -> dict[str, Any]:
        """Stop what is removed, then change and add; return all outcomes. Raises OperationError."""
        async with anyio.create_task_group() as tasks:
            for part in self._removed:
                tasks.start_soon(self._remove, part)
        async with anyio.create_task_group() as tasks:
            for part, bundle in self._kept.items():
                if self._steps[part.name]:
                    tasks.start_soon(self._change, part, bundle)
            for part in self._added:
                tasks.start_soon(self._add, part)
        self._coordinator.config = self._target
        self._coordinator.arguments = self._request.arguments
        applied = {"plan": self.plan, "outcomes": self._outcomes, "rollback": None}
        if self._failures:
            raise OperationError(Code.FAILED, "; ".join(self._failures), applied=applied)
        return applied

    def _ended(self, outcome: dict[str, Any]) -> None:
        self._outcomes.append(outcome)
        self._report(outcome)

    async def _change(self, part: Part, bundle: Bundle) -> None:
        asked = {**self._changes(bundle), "dry_run": False}
        requests = self._coordinator.requests
        stays = False
        try:
            async for message in requests.stream(part, "apply", asked, self._caller):
                stays = True
                if "step" in message:
                    message["step"]["step"]["machine"] = part.name
                    self._ended(message["step"])
        except OperationError as error:
            self._failures.append(f"{part.name}: {error}")
            applied = error.details.get("applied")
            stays = stays and not (isinstance(applied, dict) and applied.get("rollback"))
        if not stays:
            return
        try:
            await part.adopt(part_of(self._target, part.name), bundle)
            await part.refresh()
        except (OperationError, LinkLost) as error:
            self._failures.append(f"{part.name}: {error}")

    async def _remove(self, part: Part) -> None:
        began = anyio.current_time()
        reason = ""
        await part.stop(float(stop_seconds(part.config)))
        if part.state is MachineState.UNREACHABLE:
            reason = "the machine is unreachable; what runs there was left alone"
            await self._coordinator.leave(part)
        if part.state not in OVER:
            self._failures.append(f"{part.name}: it could not be stopped")
            return
        part.config, part.rows, part.met = without_units(part.config), [], []
        self._all_done(part, {}, reason, anyio.current_time() - began)

    async def _add(self, part: Part) -> None:
        began = anyio.current_time()
        failed: dict[str, str] = {}
        try:
            self._coordinator.follow(part)
        except OperationError as refusal:
            await part.close()
            part.put(MachineState.ENDED, str(refusal))
        with anyio.move_on_after(self._request.timeout) as limit:
            await part.until_not(BEGUN)
        if limit.cancelled_caught or part.state in OVER:
            error = OperationError(Code.FAILED, part.reason or f"it is {part.state}")
            failed = self._failed(part, error)
        else:
            left = max(self._request.timeout - (anyio.current_time() - began), 0.001)
            asked = {"timeout": left}
            try:
                await self._coordinator.requests.result(part, "wait", asked, self._caller)
            except OperationError as error:
                failed = self._failed(part, error)
            with contextlib.suppress(OperationError, LinkLost):
                await part.refresh()
        self._all_done(part, failed, "", anyio.current_time() - began)

    def _failed(self, part: Part, error: OperationError) -> dict[str, str]:
        """Give by step why it failed; of `wait`, the results tell what is up all the same."""
        self._failures.append(f"{part.name}: {error}")
        results = error.details.get("results")
        found = {
            f"{each['container']}:{each['name']}" if each["container"] else each["name"]: each
            for each in (results if isinstance(results, list) else ())
        }
        return {
            name: found[name]["reason"] if name in found else str(error)
            for name in (step["name"] for step in self._steps[part.name])
            if name not in found or not found[name]["done"]
        }

    def _all_done(self, part: Part, failed: Mapping[str, str], reason: str, seconds: float) -> None:
        for step in self._steps[part.name]:
            problem = failed.get(step["name"])
            self._ended(
                {
                    "step": step,
                    "result": str(Result.DONE if problem is None else Result.FAILED),
                    "reason": reason if problem is None else problem,
                    "seconds": seconds,
                }
            )


def without_units(config: ReplayConfig) -> ReplayConfig:
    return replace(config, containers=(), nodes=(), start_rules={}, managed={})


def _steps_of_units(found: Plan, part: Part) -> list[dict[str, Any]]:
    return _steps([to_builtins(step) for step in found.steps if step.name], part)


def _steps(found: list[dict[str, Any]], part: Part) -> list[dict[str, Any]]:
    """Give the steps of a machine, without what changes about other machines."""
    own, others = f"machines.{part.name}.", "machines."
    steps = []
    for step in found:
        changes = [
            each
            for each in step["changes"]
            if each["path"].startswith(own) or not each["path"].startswith(others)
        ]
        if changes or not step["changes"]:
            steps.append({**step, "changes": changes, "machine": part.name})
    return steps

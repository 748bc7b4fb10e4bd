"""Any sequence of answers, against a container that loses and delays words."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
)

from play_launch.runtime.stock.composition import Composition
from play_launch.runtime.stock.composition_words import (
    Action,
    AskList,
    ReportFailed,
    ReportLoaded,
    ReportUnloaded,
    SendLoad,
    SendUnload,
    Wanted,
)


@dataclass
class Container:
    """What it does is true, what it says may be lost or late.

    Some constructors run in the background, which is not known to the other side.
    """

    next_id: int = 1
    nodes: dict[int, str] = field(default_factory=dict)
    requests: list[tuple[str, Any]] = field(default_factory=list)
    """Waiting for its executor, in the order of their arrival."""
    answers: list[tuple[Any, ...]] = field(default_factory=list)
    """On their way back, or lost for good when taken away."""
    background: list[int] = field(default_factory=list)
    """Attempts whose constructors run while others are served."""


class Dialogue(RuleBasedStateMachine):
    """The supervisor's side against a truthful container behind a bad line."""

    def __init__(self) -> None:
        super().__init__()
        self.composition = Composition()
        self.container = Container()
        self.attempts: dict[int, str] = {}
        self.ended: dict[int, Action] = {}
        self.constructed: dict[int, list[int]] = {}
        self.heard_of: set[int] = set()
        """Nodes whose success was answered, and the answer arrived."""
        self.upcoming = 1

    @initialize(names=st.lists(st.sampled_from("abc"), unique=True, min_size=1))
    def declare(self, names: list[str]) -> None:
        for name in names:
            self.load(name)

    def load(self, name: str) -> None:
        attempt, self.upcoming = self.upcoming, self.upcoming + 1
        self.attempts[attempt] = name
        self.do(self.composition.load(attempt, Wanted(f"/{name}", "/")))

    def do(self, actions: list[Action]) -> None:
        for action in actions:
            match action:
                case SendLoad(attempt):
                    waiting = [each for kind, each in self.container.requests if kind == "load"]
                    assert attempt not in waiting, "sent twice"
                    assert not self.constructed.get(attempt), "sent twice"
                    self.composition.sent(attempt)
                    self.container.requests.append(("load", attempt))
                case SendUnload(unique_id):
                    self.container.requests.append(("unload", unique_id))
                case AskList(serial):
                    self.container.requests.append(("list", serial))
                case ReportLoaded(attempt, unique_id):
                    assert attempt not in self.ended, "two ends of one attempt"
                    self.ended[attempt] = action
                    others = [
                        each.unique_id
                        for each in self.composition.loaded()
                        if each.attempt != attempt
                    ]
                    assert unique_id not in others, "one node for two attempts"
                case ReportFailed(attempt):
                    assert attempt not in self.ended, "two ends of one attempt"
                    self.ended[attempt] = action
                case ReportUnloaded(attempt, unique_id):
                    assert unique_id not in self.container.nodes, "told dead while it lives"

    @precondition(lambda self: self.container.requests)
    @rule(fails=st.booleans(), takes_long=st.booleans())
    def container_works(self, fails: bool, takes_long: bool) -> None:
        """It takes the oldest request."""
        box = self.container
        kind, what = box.requests.pop(0)
        if kind == "load" and takes_long:
            box.background.append(what)
        elif kind == "load":
            self.construct(what, fails)
        elif kind == "unload":
            box.answers.append(("unload", what, box.nodes.pop(what, None) is not None))
        else:
            box.answers.append(("list", what, tuple(box.nodes.items())))

    def construct(self, attempt: int, fails: bool) -> None:
        box = self.container
        name = f"/{self.attempts[attempt]}"
        unique_id, box.next_id = box.next_id, box.next_id + 1
        if not fails:
            box.nodes[unique_id] = name
            self.constructed.setdefault(attempt, []).append(unique_id)
        box.answers.append(("load", attempt, not fails, unique_id, name))

    @precondition(lambda self: self.container.background)
    @rule(fails=st.booleans())
    def a_slow_constructor_returns(self, fails: bool) -> None:
        self.construct(self.container.background.pop(0), fails)

    @precondition(lambda self: self.container.answers)
    @rule(data=st.data())
    def an_answer_arrives(self, data: st.DataObject) -> None:
        """In any order."""
        answers = self.container.answers
        self.hear(answers.pop(data.draw(st.integers(0, len(answers) - 1))))

    def hear(self, answer: tuple[Any, ...]) -> None:
        kind, what, *rest = answer
        if kind == "load":
            ok, unique_id, name = rest
            self.heard_of |= {unique_id} if ok else set()
            self.do(
                self.composition.answered(
                    what,
                    success=ok,
                    unique_id=unique_id if ok else 0,
                    full_name=name if ok else "",
                    reason="" if ok else "refused",
                )
            )
        elif kind == "unload":
            self.do(self.composition.unload_answered(what, success=rest[0], reason="unknown"))
        else:
            self.do(self.composition.listed(what, rest[0]))

    @precondition(lambda self: self.container.answers)
    @rule()
    def an_answer_is_lost(self) -> None:
        kind, what, *_ = self.container.answers.pop(0)
        if kind == "list":
            self.do(self.composition.list_unanswered(what))
        elif kind == "unload":
            self.do(self.composition.unload_answered(what, success=False, reason="silence"))

    @precondition(lambda self: self.container.requests)
    @rule()
    def a_request_is_lost(self) -> None:
        kind, what = self.container.requests.pop(0)
        if kind == "list":
            self.do(self.composition.list_unanswered(what))
        elif kind == "unload":
            self.do(self.composition.unload_answered(what, success=False, reason="silence"))

    @rule()
    def silence_lasts(self) -> None:
        self.do(self.composition.ask_about(self.attempts))
        self.resend()

    def resend(self) -> None:
        """As the actor does when the answer to its question is that nobody knows the attempt."""
        for attempt, name in list(self.attempts.items()):
            is_latest = attempt == max(a for a, n in self.attempts.items() if n == name)
            is_forgotten = self.composition.stage(attempt) is None and attempt not in self.ended
            if is_latest and is_forgotten and len(self.attempts) < 20:
                self.load(name)

    @rule()
    def somebody_looks(self) -> None:
        self.do(self.composition.look())

    @precondition(lambda self: self.composition.loaded())
    @rule(data=st.data())
    def it_is_unloaded(self, data: st.DataObject) -> None:
        load = data.draw(st.sampled_from(self.composition.loaded()))
        self.do(self.composition.unload(load.unique_id))

    @invariant()
    def one_load_at_a_time(self) -> None:
        if self.composition.serially:
            assert len([kind for kind, _ in self.container.requests if kind == "load"]) <= 1

    @invariant()
    def nothing_is_constructed_twice_for_one_attempt(self) -> None:
        assert all(len(ids) == 1 for ids in self.constructed.values())

    @invariant()
    def one_node_is_one_attempt(self) -> None:
        ids = [load.unique_id for load in self.composition.loaded()]
        assert len(ids) == len(set(ids))

    def teardown(self) -> None:
        """When the line is good again, all comes to its end, and each node is there once."""
        box = self.container
        for _ in range(1000):
            if box.background:
                self.construct(box.background.pop(0), fails=False)
            elif box.requests:
                self.container_works(fails=False, takes_long=False)
            elif box.answers:
                self.hear(box.answers.pop(0))
            elif self.composition.current is not None:
                self.silence_lasts()
            else:
                self.resend()
                if not box.requests:
                    break
        assert self.composition.current is None
        for _ in range(3):
            self.do(self.composition.look())
            while box.requests or box.answers:
                if box.requests:
                    self.container_works(fails=False, takes_long=False)
                else:
                    self.hear(box.answers.pop(0))
        believed = {load.unique_id: load.full_name for load in self.composition.loaded()}
        assert believed.items() <= box.nodes.items(), "a dead node is believed alive"
        surplus = box.nodes.keys() - believed.keys()
        assert not surplus & self.heard_of, "a node that was told of is there and nobody has it"


TestDialogue = Dialogue.TestCase
TestDialogue.settings = settings(max_examples=400, stateful_step_count=40)

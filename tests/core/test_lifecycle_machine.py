"""One node against a container whose answers are lost, doubled, delayed and reordered."""

from __future__ import annotations

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from play_launch.core.events import NodeState
from play_launch.core.lifecycle import NodeRecord, Patience, Step, is_silent, step
from play_launch.core.node_key import NodeKey
from play_launch.core.node_table import WAITING, NodeAction, NodeInput
from play_launch.core.questions import Asked, ids_to_ask, read_answer

from .model_container import Load, ModelContainer, Query, Status, Unload, Word

KEY = NodeKey("/c", "/n")
PATIENCE = Patience(loading_timeout=10.0, report_interval=15.0)
DEATHS = {
    NodeInput.REJECTED,
    NodeInput.LOAD_FAILED,
    NodeInput.UNLOADED,
    NodeInput.CRASHED,
    NodeInput.STATUS_UNKNOWN,
}


class OneNode(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0
        self.record = NodeRecord()
        self.container = ModelContainer()
        self.alive = False
        self.death_told = True
        self.asked: dict[int, Asked] = {}
        self.attempts = 0
        self.dead: set[int] = set()
        self.reload_planned = False
        self.lossless = True
        self.loads: list[Load] = []

    # What the supervisor does with an input.

    def apply(self, said: NodeInput, attempt: int = 0, unique_id: int = 0) -> Step:
        before = self.record
        if said in DEATHS and attempt == before.attempt:
            self.dead.add(attempt)
        if said is NodeInput.CONTAINER_LOST:
            self.dead.add(before.attempt)
            self.reload_planned = False
        result = step(
            before,
            said,
            now=self.now,
            patience=PATIENCE,
            next_attempt=self.attempts + 1,
            attempt=attempt,
            unique_id=unique_id,
        )
        self.record = result.record
        if attempt not in (0, before.attempt):
            assert self.record == before, "an old attempt touched a newer one"
        if self.record.state is NodeState.LOADED:
            assert self.record.attempt not in self.dead, "a dead node was promoted"
        for action in result.actions:
            self.execute(action)
        return result

    def execute(self, action: NodeAction) -> None:
        record = self.record
        match action:
            case NodeAction.SEND_LOAD | NodeAction.RESEND_LOAD:
                assert record.attempt == self.attempts + 1
                self.attempts += 1
                self.send(Load(record.attempt))
            case NodeAction.SEND_QUERY:
                query_id = len(self.asked) + 1
                self.asked[query_id] = Asked(KEY, record.attempt, record.unique_id)
                self.send(Query(query_id, ids_to_ask([self.asked[query_id]])))
            case NodeAction.SEND_CANCEL | NodeAction.SEND_UNLOAD:
                assert record.unique_id
                self.send(Unload(record.unique_id))
            case NodeAction.FOLLOW_UP:
                assert not self.reload_planned, "one death is followed up twice"
                self.reload_planned = True

    def send(self, request: Load | Query | Unload) -> None:
        if self.alive:
            self.container.requests.append(request)

    def hear(self, answer: Word | Status) -> None:
        if isinstance(answer, Word):
            self.apply(answer.said, answer.attempt, answer.unique_id)
            return
        asked = self.asked[answer.query_id]
        for each in read_answer([asked], answer.listed):
            unique_id = each.listed.unique_id if each.listed else asked.unique_id
            self.apply(each.said, asked.attempt, unique_id)

    # The wires.

    @precondition(lambda self: self.container.requests)
    @rule(reject=st.booleans())
    def deliver_request(self, reject: bool) -> None:
        request = self.container.take(reject=reject)
        if isinstance(request, Load):
            self.loads.append(request)

    @precondition(lambda self: self.container.requests)
    @rule()
    def lose_request(self) -> None:
        self.container.requests.popleft()

    @precondition(lambda self: self.alive and self.loads)
    @rule(data=st.data())
    def deliver_load_twice(self, data: st.DataObject) -> None:
        load = data.draw(st.sampled_from(self.loads))
        if load.attempt in self.container.seen:
            self.container.handle(load)

    @precondition(lambda self: self.container.answers)
    @rule(data=st.data(), keep=st.booleans())
    def deliver_some_answer(self, data: st.DataObject, keep: bool) -> None:
        index = data.draw(st.integers(0, len(self.container.answers) - 1))
        answer = self.container.answers[index]
        if not keep:
            del self.container.answers[index]
        self.hear(answer)

    @precondition(lambda self: self.container.answers)
    @rule()
    def deliver_in_order(self) -> None:
        self.hear(self.container.answers.pop(0))

    @precondition(lambda self: self.container.answers)
    @rule(data=st.data())
    def lose_answer(self, data: st.DataObject) -> None:
        del self.container.answers[data.draw(st.integers(0, len(self.container.answers) - 1))]
        self.lossless = False

    # The container.

    @precondition(lambda self: self.container.held)
    @rule(data=st.data())
    def something_happens_to_a_node(self, data: st.DataObject) -> None:
        held = data.draw(st.sampled_from(list(self.container.held.values())))
        ends = [NodeInput.CRASHED, NodeInput.UNLOADED]
        if not held.loaded:
            ends += [NodeInput.LOADED, NodeInput.LOADED, NodeInput.LOAD_FAILED]
        self.container.finish(held.unique_id, data.draw(st.sampled_from(ends)))

    @precondition(lambda self: self.alive)
    @rule()
    def container_dies(self) -> None:
        self.container.die()
        self.alive = False
        self.loads.clear()

    @precondition(lambda self: not self.alive and not self.death_told)
    @rule()
    def death_is_told(self) -> None:
        self.death_told = True
        self.apply(NodeInput.CONTAINER_LOST)

    @precondition(lambda self: not self.alive and self.death_told)
    @rule()
    def container_starts(self) -> None:
        self.alive, self.death_told = True, False
        self.apply(NodeInput.CONTAINER_READY)

    # The supervisor's own inputs.

    @rule(seconds=st.sampled_from([0.5, 5.0, 20.0]))
    def time_passes(self, seconds: float) -> None:
        self.now += seconds
        if is_silent(self.record, self.now):
            self.apply(NodeInput.SILENT)

    @precondition(lambda self: self.reload_planned)
    @rule()
    def reload(self) -> None:
        self.reload_planned = False
        self.apply(NodeInput.RELOAD_DUE)

    @precondition(lambda self: self.reload_planned)
    @rule(really=st.integers(0, 9))
    def give_up(self, really: int) -> None:
        if really == 0:
            self.reload_planned = False
            self.apply(NodeInput.GIVEN_UP)

    @rule(really=st.integers(0, 9))
    def unload(self, really: int) -> None:
        if really == 0:
            self.apply(NodeInput.UNLOAD_REQUESTED)

    @rule(really=st.integers(0, 3), again=st.booleans())
    def load_or_reload(self, really: int, again: bool) -> None:
        if really:
            return
        self.reload_planned = False
        if not self.alive:
            self.apply(NodeInput.WANTED)
        else:
            self.apply(NodeInput.RELOAD_REQUESTED if again else NodeInput.LOAD_REQUESTED)

    @rule()
    def ready_is_told_twice(self) -> None:
        if self.record.state in WAITING or self.record.state is NodeState.LOADED:
            assert not self.apply(NodeInput.CONTAINER_READY).actions

    @precondition(lambda self: self.alive)
    @rule()
    def all_wires_work_for_a_while(self) -> None:
        """Then nothing may be stuck: who still waits, waits for something real."""
        for _ in range(12):
            while self.container.requests or self.container.answers:
                if self.container.requests:
                    self.container.take()
                else:
                    self.hear(self.container.answers.pop(0))
            self.time_passes(20.0)
        while self.container.requests or self.container.answers:
            if self.container.requests:
                self.container.take()
            else:
                self.hear(self.container.answers.pop(0))
        held = [h for h in self.container.held.values() if h.attempt == self.record.attempt]
        if self.record.state in WAITING:
            assert held, "waits for nothing"
            assert not held[0].loaded
        if self.lossless:
            assert (self.record.state is NodeState.LOADED) == bool(held and held[0].loaded)

    @invariant()
    def never_two_alive(self) -> None:
        assert len(self.container.held) <= 1

    @invariant()
    def nobody_loads_what_is_unwanted(self) -> None:
        assert self.record.wanted or self.record.state is not NodeState.LOADED

    @invariant()
    def asks_only_while_waiting(self) -> None:
        assert (self.record.ask_at is not None) == (self.record.state in WAITING)


TestOneNode = OneNode.TestCase
TestOneNode.settings = settings(max_examples=150, stateful_step_count=60)

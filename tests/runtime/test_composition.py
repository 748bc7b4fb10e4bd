"""Single answers of a composition container, and what follows from them."""

from __future__ import annotations

from play_launch.runtime.stock.composition import Composition
from play_launch.runtime.stock.composition_words import (
    Action,
    AskList,
    Remark,
    ReportFailed,
    ReportLoaded,
    ReportRejected,
    ReportUnloaded,
    SendLoad,
    SendUnload,
    Stage,
    Wanted,
)

TALKER = Wanted("/talker", "/")


def success(composition: Composition, attempt: int, unique_id: int, name: str) -> list[Action]:
    return composition.answered(
        attempt, success=True, unique_id=unique_id, full_name=name, reason=""
    )


def failure(composition: Composition, attempt: int, reason: str) -> list[Action]:
    return composition.answered(attempt, success=False, unique_id=0, full_name="", reason=reason)


def sent(composition: Composition, attempt: int, wanted: Wanted = TALKER) -> None:
    assert composition.load(attempt, wanted) == [SendLoad(attempt)]
    composition.sent(attempt)


def test_a_success_counts_when_the_list_agrees() -> None:
    composition = Composition()
    sent(composition, 1)
    assert success(composition, 1, 4, "/talker") == [AskList(1)]
    assert composition.stage(1) is Stage.SAID_LOADED
    assert composition.listed(1, [(4, "/talker")]) == [ReportLoaded(1, 4, "/talker")]


def test_the_next_load_waits_for_the_end_of_the_one_before() -> None:
    composition = Composition()
    sent(composition, 1)
    assert composition.load(2, Wanted("/listener", "/")) == []
    success(composition, 1, 1, "/talker")
    told, go_on = composition.listed(1, [(1, "/talker")])
    assert (told, go_on) == (ReportLoaded(1, 1, "/talker"), SendLoad(2))


def test_a_list_that_was_asked_before_the_answer_came_does_not_count() -> None:
    composition = Composition()
    sent(composition, 1)
    assert composition.look() == [AskList(1)]
    assert success(composition, 1, 1, "/talker") == []
    assert composition.listed(1, []) == [AskList(2)]
    assert composition.listed(2, [(1, "/talker")]) == [ReportLoaded(1, 1, "/talker")]


def test_a_success_that_is_listed_nowhere_is_a_failure() -> None:
    composition = Composition()
    sent(composition, 1)
    success(composition, 1, 1, "/talker")
    (again,) = composition.listed(1, [])
    assert isinstance(again, AskList)
    assert again.delay > 0
    (failed,) = composition.listed(2, [])
    assert isinstance(failed, ReportFailed)


def test_a_failure_that_is_listed_is_a_success_with_a_remark() -> None:
    composition = Composition()
    sent(composition, 1)
    failure(composition, 1, "out of luck")
    (loaded,) = composition.listed(1, [(3, "/talker")])
    assert isinstance(loaded, ReportLoaded)
    assert (loaded.unique_id, loaded.confirmed_by) == (3, "list_nodes")
    assert "out of luck" in loaded.remark


def test_a_node_that_was_there_before_is_not_taken_for_one_that_failed() -> None:
    composition = Composition()
    composition.begin([(1, "/somebody")])
    sent(composition, 1, Wanted("", "/"))
    failure(composition, 1, "no")
    assert composition.listed(1, [(1, "/somebody")]) == [ReportFailed(1, "no")]


def test_silence_is_asked_about_and_a_listed_node_is_found() -> None:
    composition = Composition()
    sent(composition, 1)
    assert composition.ask_about([1]) == [AskList(1)]
    assert composition.ask_about([1]) == []
    (loaded,) = composition.listed(1, [(1, "/talker")])
    assert isinstance(loaded, ReportLoaded)
    assert loaded.confirmed_by == "list_nodes"


def test_a_container_that_constructs_one_after_the_other_forgets_what_it_lists_nowhere() -> None:
    composition = Composition()
    sent(composition, 1)
    composition.ask_about([1])
    composition.listed(1, [])
    assert composition.stage(1) is Stage.SENT
    composition.listed(2, [])
    assert composition.stage(1) is None
    assert composition.load(2, TALKER) == [SendLoad(2)]


def test_where_constructors_run_in_the_background_silence_stays_silence() -> None:
    composition = Composition(serially=False)
    sent(composition, 1)
    for serial in (1, 3):
        composition.ask_about([1])
        composition.listed(serial, [])
        composition.listed(serial + 1, [])
        assert composition.stage(1) is Stage.SENT
    assert composition.load(2, Wanted("/listener", "/")) == [SendLoad(2)]
    composition.sent(2)
    success(composition, 1, 1, "/talker")
    assert composition.listed(5, [(1, "/talker")]) == [ReportLoaded(1, 1, "/talker")]


def test_an_unanswered_list_says_nothing_about_a_load() -> None:
    composition = Composition()
    sent(composition, 1)
    for serial in range(1, 20):
        assert composition.ask_about([1]) == [AskList(serial)]
        assert composition.list_unanswered(serial) == []
        assert composition.stage(1) is Stage.SENT


def test_a_late_answer_saves_the_second_load() -> None:
    composition = Composition()
    sent(composition, 1)
    assert composition.load(2, Wanted("/other", "/")) == []
    composition.ask_about([1])
    composition.listed(1, [])
    assert composition.listed(2, []) == [SendLoad(2)]
    assert composition.load(3, TALKER) == []
    composition.sent(2)
    assert success(composition, 1, 9, "/talker") == [AskList(3)]
    assert composition.listed(3, [(9, "/talker")]) == [ReportLoaded(3, 9, "/talker")]


def test_a_late_answer_after_the_second_load_unloads_the_surplus() -> None:
    composition = Composition()
    sent(composition, 1)
    composition.ask_about([1])
    composition.listed(1, [])
    composition.listed(2, [])
    sent(composition, 2)
    success(composition, 1, 1, "/talker")
    success(composition, 2, 2, "/talker")
    told, remark, unload = composition.listed(3, [(1, "/talker"), (2, "/talker")])
    assert told == ReportLoaded(2, 2, "/talker")
    assert isinstance(remark, Remark)
    assert unload == SendUnload(1)
    assert not composition.serially


def test_the_unload_of_a_surplus_node_is_sent_again_until_a_list_lacks_the_node() -> None:
    composition = Composition()
    sent(composition, 1)
    composition.ask_about([1])
    composition.listed(1, [])
    composition.listed(2, [])
    assert success(composition, 1, 1, "/talker")[-1] == SendUnload(1)
    assert composition.unload_answered(1, success=False, reason="silence") == []
    assert composition.listed(2, [(1, "/talker")]) == [], "a list of before the failure"
    assert composition.look() == [AskList(3)]
    assert composition.listed(3, [(1, "/talker")]) == [SendUnload(1)]
    assert composition.look() == [AskList(4)]
    assert composition.listed(4, [(1, "/talker")]) == [], "the second one is under way"
    assert composition.unload_answered(1, success=False, reason="silence") == []
    composition.look()
    assert composition.listed(5, []) == []
    composition.look()
    assert composition.listed(6, [(1, "/talker")]) == [], "somebody else's"


def test_a_surplus_node_that_is_being_unloaded_is_nobodys() -> None:
    composition = Composition()
    sent(composition, 1)
    composition.ask_about([1])
    composition.listed(1, [])
    composition.listed(2, [])
    success(composition, 1, 1, "/talker")
    composition.look()
    composition.listed(3, [(1, "/talker")])
    assert composition.load(2, TALKER) == [SendLoad(2)], "not adopted"


def test_a_refusal_because_the_late_one_is_there_is_no_failure() -> None:
    """As containers do that refuse a name which is taken."""
    composition = Composition()
    sent(composition, 1)
    composition.ask_about([1])
    composition.listed(1, [])
    composition.listed(2, [])
    sent(composition, 2)
    success(composition, 1, 1, "/talker")
    failure(composition, 2, "the name is taken")
    (loaded,) = composition.listed(3, [(1, "/talker")])
    assert isinstance(loaded, ReportLoaded)
    assert (loaded.attempt, loaded.unique_id) == (2, 1)


def test_what_is_there_is_adopted_once_and_only_if_it_is_still_there() -> None:
    composition = Composition()
    composition.begin([(1, "/talker"), (2, "/talker"), (3, "/gone")])
    assert composition.load(1, TALKER) == [AskList(1)]
    assert composition.load(2, Wanted("/gone", "/")) == []
    first, again = composition.listed(1, [(1, "/talker"), (2, "/talker")])
    assert isinstance(first, ReportLoaded)
    assert (first.unique_id, first.adopted) == (1, True)
    assert "unique_id 2" in first.remark
    assert isinstance(again, AskList)
    assert isinstance(composition.listed(2, [(1, "/talker"), (2, "/talker")])[0], AskList)
    assert composition.listed(3, [(1, "/talker"), (2, "/talker")])[-1] == SendLoad(2)


def test_a_node_that_is_gone_from_two_lists_is_gone() -> None:
    composition = Composition()
    sent(composition, 1)
    success(composition, 1, 1, "/talker")
    composition.listed(1, [(1, "/talker")])
    composition.look()
    (again,) = composition.listed(2, [])
    assert isinstance(again, AskList)
    (gone,) = composition.listed(3, [])
    assert isinstance(gone, ReportUnloaded)
    assert gone.reason
    assert composition.load(2, TALKER) == [SendLoad(2)]


def test_an_unload_that_is_refused_is_looked_up() -> None:
    composition = Composition()
    sent(composition, 1)
    success(composition, 1, 1, "/talker")
    composition.listed(1, [(1, "/talker")])
    assert composition.unload(1) == [SendUnload(1)]
    composition.unload_answered(1, success=False, reason="not now")
    assert composition.listed(2, [(1, "/talker")]) == [ReportRejected(1, "not now")]
    composition.unload(1)
    composition.unload_answered(1, success=False, reason="no answer")
    assert composition.listed(3, []) == [ReportUnloaded(1, 1, "/talker")]
    assert composition.unload(1) == [ReportRejected(1, "there is no such node")]


def test_nodes_without_a_name_are_found_when_there_is_one_new_node_only() -> None:
    for listed, is_found in (([(2, "/own")], True), ([(2, "/own"), (3, "/x")], False)):
        composition = Composition()
        composition.begin([(1, "/old")])
        sent(composition, 1, Wanted("", "", "demo/demo::Own"))
        composition.ask_about([1])
        actions = composition.listed(1, [(1, "/old"), *listed])
        assert isinstance(actions[0], ReportLoaded) is is_found


def test_after_a_stop_nothing_more_is_sent() -> None:
    composition = Composition()
    sent(composition, 1)
    composition.load(2, Wanted("/listener", "/"))
    composition.stop()
    success(composition, 1, 1, "/talker")
    assert composition.listed(1, [(1, "/talker")]) == [ReportLoaded(1, 1, "/talker")]
    assert [each.attempt for each in composition.unfinished()] == [1]

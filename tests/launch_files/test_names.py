"""In a configuration names are unique, in a launch file they may repeat."""

from __future__ import annotations

from pathlib import Path

from play_launch.launch_files.records import LaunchedProcess, ProgramKind
from tests.launch_files.writing import evaluated, load, lost, node, params, write


def test_many_nodes_of_one_name_are_one_loss(tmp_path: Path) -> None:
    made = write(*(node(name="same") for _ in range(2000)), node(name="other"))
    names = {each.full_name for each in load(made, tmp_path).nodes}
    assert len(names) == 2001
    assert {"/a/same", "/a/same_2", "/a/same_2000", "/a/other"} <= names
    (only,) = lost(made)
    expected = "a second node is called /a/same; it becomes /a/same_2; 1998 more of that name"
    assert expected in only


def test_a_second_node_of_a_name_gets_what_it_got_under_that_name(tmp_path: Path) -> None:
    text = "{/a/same: {ros__parameters: {rate: 1}}, /a/same_2: {ros__parameters: {rate: 2}}}"
    file = params(tmp_path / "p.yaml", text)
    units = [evaluated(node(name="same", sources=[file])) for _ in range(2)]
    first, second = load(write(*units, folder=tmp_path), tmp_path).nodes
    assert [each.full_name for each in (first, second)] == ["/a/same", "/a/same_2"]
    for each in (first, second):
        assert [(one.name, one.value.value) for one in each.parameters] == [("rate", 1)]


def test_programs_of_one_name(tmp_path: Path) -> None:
    """For launch it is a name in its output, and no node's."""
    programs = [
        LaunchedProcess(kind=ProgramKind.PROCESS, command=["env"], label=label)
        for label in ("n", "n", "n_2", "talker", "n")
    ]
    made = write(*programs, node(name="talker", namespace="/"))
    names = [each.name for each in load(made, tmp_path).nodes]
    assert names == ["n", "n_2", "n_2_2", "talker_2", "n_3", "talker"]
    assert not lost(made)

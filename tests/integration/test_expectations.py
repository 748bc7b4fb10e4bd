"""Topics that are not as expected: a node that ends, one that never comes, and what waits."""

from __future__ import annotations

import json
import os
import signal
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from unittest.mock import ANY

import pytest

from play_launch.cli.expect import learned
from play_launch.config.load import load_config
from play_launch.control.protocol import OperationError
from play_launch.control.sessions import connect
from play_launch.supervisor.expectations import Measured
from tests.support.replay import named, replaying, run
from tests.support.scenes import node, written
from tests.support.waiting import until

EXPECT = {
    "/chatter": {
        "type": "std_msgs/String",
        "min_rate": 5,
        "max_rate": "20 Hz",
        "max_gap": "3 s",
        "publishers": 1,
        "reliability": "reliable",
        "durability": "volatile",
    }
}


def test_a_topic_is_measured_reported_and_waited_for(tmp_path: Path) -> None:
    late = {"name": "late", "command": ["true"], "depends_on": [{"expect": "chatter"}]}
    containers = [{"name": "c", "container_type": "isolated", "composable_nodes": [node("talker")]}]
    config = written(
        tmp_path, record={"ros": False}, expect=EXPECT, containers=containers, nodes=[late]
    )
    with replaying(config, tmp_path / "logs") as replay:
        replay.until(event="process", name="/late", kind="waiting")
        replay.until(event="expectation", topic="/chatter", is_met=True)
        replay.until(event="process", name="/late", kind="exited")
        replay.ask("wait", "--for", "ready", code=0)
        (row,) = json.loads(replay.ask("expect", "--json", code=0).stdout)
        assert (row["publishers"], row["type"]) == (1, "std_msgs/msg/String")
        assert 5 <= row["rate"] <= 20

        (recorder,) = named(replay.descendants(), "topic_recorder")
        recorder.suspend()
        until(lambda: "not measured for" in replay.ask("expect", code=None).stdout, "silence")
        recorder.kill()
        until(lambda: replay.ask("expect", code=None).returncode == 0, "the next measurements")

        learned = json.loads(replay.ask("expect", "--learn", "4s", "--json", code=0).stdout)
        assert learned["expect"]["/chatter"] == {
            "type": "std_msgs/msg/String",
            "min_rate": pytest.approx(8.0, abs=1.5),
            "max_gap": ANY,
            "publishers": 1,
            "reliability": "reliable",
            "durability": "volatile",
        }
        run("check", written(tmp_path / "learned.yaml", **learned, nodes=[late]), code=0)

        replay.ask("unload", "talker", code=0)
        broken = replay.until(event="expectation", is_met=False)
        # The publisher may still be in the graph, while too little comes in that second.
        reasons = "0 publishers instead of 1", "Hz, expected at least 5 Hz"
        assert any(each in broken["reason"] for each in reasons), broken["reason"]
        until(lambda: reasons[0] in replay.ask("expect", code=1).stdout, "no publisher")
        assert "broken" in replay.ask("expect", code=1).stdout
        refused = replay.ask("wait", "--for", "ready", "--timeout", "1s", code=4)
        assert "/chatter: 0 publishers instead of 1" in refused.stderr
        replay.ask("load", "talker", code=0)
        replay.until(event="expectation", is_met=True)
        # At the end, publishers go away because they are to.
        replay.process.send_signal(signal.SIGINT)
        replay.read_all()
        assert len(replay.told(event="expectation")) == 3
    found = json.loads(run("explain", "--json", replay.bag, code=1).stdout)["findings"]
    (finding,) = [each for each in found if each["kind"] == "not_as_expected"]
    assert finding["name"] == "/chatter"
    assert "as recorded" in run("rerun", replay.bag, code=0).stdout


def test_what_measures_may_die(tmp_path: Path) -> None:
    containers = [{"name": "c", "composable_nodes": [node("talker")]}]
    config = written(tmp_path, expect=EXPECT, containers=containers)
    with replaying(config, tmp_path / "logs") as replay:
        replay.until(event="expectation", is_met=True)
        (recorder,) = named(replay.descendants(), "topic_recorder")
        os.kill(recorder.pid, signal.SIGKILL)
        replay.read_until(
            lambda event: "topic_recorder" in event.get("message", ""), "the death of the recorder"
        )
        replay.ask("unload", "talker", code=0)
        replay.until(event="expectation", is_met=False)


def test_units_and_topics_are_waited_for_at_the_same_moment(tmp_path: Path) -> None:
    containers = [
        {
            "name": "c",
            "container_type": "isolated",
            "composable_nodes": [node("talker", on_crash="ignore")],
        }
    ]
    config = written(tmp_path, expect={"/never": {"publishers": 1}}, containers=containers)
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_until_up("/talker")
        replay.until_operable()
        with connect(str(replay.pid)) as client, ThreadPoolExecutor() as pool:
            asked = {"for": "expected", "timeout": 5.0}
            waiting = pool.submit(client.ask, "wait", asked, limit=60.0)
            # It has been handled when this is answered.
            assert not replay.ask("expect", "--json", code=1).stderr
            os.kill(replay.pids()["/talker"], signal.SIGSEGV)
            with pytest.raises(OperationError, match="not done within 5 s: /talker"):
                waiting.result(60)


@pytest.mark.parametrize(
    ("gap", "rate"), [(2e-6, 300_000.0), (0.011, 90.0), (0.4, 3.0), (250.0, 0.01)]
)
def test_what_is_learned_is_a_configuration(tmp_path: Path, gap: float, rate: float) -> None:
    seconds = 10 / rate
    found = Measured("/a", "a/msg/B", 1, 1, 0, 10, round(gap * 1e9), round(seconds * 1e9))
    values = learned([found])
    config = written(tmp_path, expect={"/a": values}, nodes=[{"name": "x", "command": ["x"]}])
    (read,) = load_config(config).expect.values()
    assert gap < read.max_gap <= 3.1 * gap + 0.001
    assert read.min_rate == pytest.approx(0.8 * rate, rel=0.05)

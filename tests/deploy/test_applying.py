"""Machines that come and go with `apply`, while the others run on."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from play_launch.deploy.machines.namespaces import missing
from tests.support.hosts import Hosts, Running, running, supervisors, system
from tests.support.waiting import until

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"hosts: {missing()}")


def without_h3(config: Path) -> str:
    """Give the text of a system without its third machine."""
    lines = config.read_text().splitlines(keepends=True)
    listen = next(at for at, line in enumerate(lines) if "name: listen" in line)
    nodes = lines.index("nodes:\n")
    ticks = next(at for at, line in enumerate(lines) if "name: ticks" in line)
    kept = [*lines[:listen], *lines[nodes:ticks]]
    return "".join(line for line in kept if "  h3:" not in line)


def actions(outcomes: str) -> set[tuple[str, str, str, str]]:
    found: list[dict[str, Any]] = json.loads(outcomes)["outcomes"]
    steps = ((each["step"], each["result"]) for each in found)
    return {
        (step["machine"], step["action"], step["name"], end) for step, end in steps if step["name"]
    }


@contextlib.contextmanager
def applying(system: Running, config: Path) -> Iterator[subprocess.Popen[str]]:
    """Begin to apply; what is to change has been printed."""
    command = system.net.play_launch("apply", "--session", str(system.process.pid), str(config))
    with subprocess.Popen(
        command, env=system.net.environment, stdout=subprocess.PIPE, text=True
    ) as client:
        assert client.stdout is not None
        assert any("to add" in line for line in client.stdout)
        yield client


def test_a_machine_comes_and_goes(net: Hosts, tmp_path: Path) -> None:
    config = system(tmp_path, "guest")
    whole, small = config.read_text(), without_h3(config)
    config.write_text(small)
    with running(net, config) as guest:
        before = guest.loaded().rows()
        assert {row["machine"] for row in before.values()} == {"main", "h2"}
        config.write_text(whole)
        assert "+ /listen:/listener" in guest.ask("diff", str(config), code=1)
        links = "find ~/.cache/play-launch/parts -type l -name '*guest*'"
        assert not net.ssh("h3", links), "it starts nothing else after a reboot"
        assert not supervisors(net, 3)
        assert actions(guest.ask("apply", "--json", str(config))) == {
            ("h3", "add", "/listen", "done"),
            ("h3", "add", "/listen:/listener", "done"),
            ("h3", "add", "/ticks", "done"),
        }
        during = guest.rows()
        assert during["/listener"]["state"] == "loaded"
        until(lambda: "World" in guest.ask("logs", "listener"), "a line of the listener")
        assert guest.ask("diff", str(config)).startswith("nothing differs")

        config.write_text(small)
        assert actions(guest.ask("apply", "--json", str(config))) == {
            ("h3", "remove", "/listen", "done"),
            ("h3", "remove", "/listen:/listener", "done"),
            ("h3", "remove", "/ticks", "done"),
        }
        after = guest.rows()
        assert after.keys() == before.keys()
        until(lambda: not supervisors(net, 3), "the end of the supervisor that was removed")
        assert {name: row["pid"] for name, row in after.items()} == {
            name: row["pid"] for name, row in before.items()
        }
        # It may come again, also when the client that asked for it does not wait.
        config.write_text(whole)
        with applying(guest, config) as client:
            client.kill()
        until(lambda: guest.rows()["/listener"]["state"] == "loaded", "its node")
        until(lambda: guest.ask("diff", str(config), code=None).startswith("nothing"), "the end")
        guest.stop()
        (recorded,) = (net.home / ".ros/play_launch").glob("*-guest/machines.json")
        machines = [each["machine"] for each in json.loads(recorded.read_text())]
        assert {*machines} == {"main", "h2", "h3"}
    assert not supervisors(net, 2)
    assert not supervisors(net, 3)


def test_a_machine_has_packages_and_variables_of_its_own(net: Hosts, tmp_path: Path) -> None:
    share = tmp_path / "there/share"
    index = share / "ament_index/resource_index/packages/only_there"
    program = tmp_path / "there/lib/only_there/hello"
    parameters = share / "only_there/hello.yaml"
    for file in (index, program, parameters):
        file.parent.mkdir(parents=True, exist_ok=True)
    index.write_text("")
    parameters.write_text("/**: {ros__parameters: {rate: 1.0}}\n")
    program.write_text('#!/bin/sh\necho "hello $GREETING $1 $2"; exec sleep 1000\n')
    program.chmod(0o755)
    setup = tmp_path / "setup.bash"
    setup.write_text(f"export AMENT_PREFIX_PATH={tmp_path}/there:$AMENT_PREFIX_PATH TITLE=robot\n")
    config = system(tmp_path, "own", h3=f", setup: [{setup}]")
    config.write_text(f"""{config.read_text()}\
  - name: hello
    machine: h3
    package: only_there
    executable: hello
    arguments: [$(find-pkg-share only_there), first]
    parameters: [$(find-pkg-share only_there)/hello.yaml]
    environment: {{GREETING: "${{env:TITLE:-none}}"}}
""")
    assert "h3: 1 container with 1 node, 2 processes" in net.run("check", str(config)).stdout
    assert net.run("check", "--machine", "main", str(config)).returncode == 0
    there = net.run("check", "--machine", "h3", str(config))
    assert "package only_there is not installed" in there.stderr
    with running(net, config) as own:
        own.loaded()
        until(lambda: f"hello robot {share}/only_there" in own.ask("logs", "hello"), "its line")
        config.write_text(config.read_text().replace("first", "second"))
        own.ask("apply", str(config))
        until(lambda: own.ask("logs", "hello").count("hello robot") == 2, "its second line")
        config.write_text(
            config.read_text().replace("machine: h3\n    package", "machine: h2\n    package")
        )
        assert "package only_there is not installed" in own.ask("apply", str(config), code=2)
        own.stop()


def test_a_system_moves_to_other_machines(net: Hosts, tmp_path: Path) -> None:
    config = system(tmp_path, "nomad")
    small = without_h3(config)
    config.write_text(small)
    with running(net, config) as nomad:
        nomad.loaded()
        config.write_text(small.replace("  h2:", "  h3:").replace("machine: h2", "machine: h3"))
        nomad.ask("apply", str(config))
        assert {name: row["machine"] for name, row in nomad.rows().items()} == {
            "/talk": "h3",
            "/talker": "h3",
            "/clock": "main",
        }
        assert not supervisors(net, 2)
        nomad.stop()
    assert not supervisors(net, 3)


def test_a_stop_amid_a_change_leaves_nothing(net: Hosts, tmp_path: Path) -> None:
    config = system(tmp_path, "hasty")
    whole = config.read_text()
    config.write_text(without_h3(config))
    with running(net, config) as hasty:
        hasty.loaded()
        config.write_text(whole)
        with applying(hasty, config) as client:
            hasty.process.send_signal(signal.SIGINT)
            assert client.wait(40)
        assert hasty.process.wait(40) in {1, 130}, hasty.printed()
    assert not supervisors(net, 2)
    assert not supervisors(net, 3)


def test_a_machine_that_has_ended_is_started_again(net: Hosts, tmp_path: Path) -> None:
    config = system(tmp_path, "ended")
    with running(net, config) as ended:
        ended.loaded()
        (supervisor,) = supervisors(net, 3)
        os.kill(supervisor, signal.SIGINT)
        until(lambda: ended.rows()["/ticks"]["state"] == "ended", "the end of its session")
        ended.ask("apply", str(config))
        assert ended.rows()["/listener"]["state"] == "loaded"
        ended.stop()
    assert not supervisors(net, 3)


def test_a_machine_that_is_gone_can_be_removed(net: Hosts, tmp_path: Path) -> None:
    config = system(tmp_path, "broken", h3=", on_lost: {stop_after: 3 s}")
    small = without_h3(config)
    with running(net, config) as broken:
        broken.loaded()
        net.set_link(3, "down")
        try:
            until(lambda: broken.rows()["/ticks"]["state"] == "unreachable", "its loss")
            config.write_text(small)
            assert "left alone" in broken.ask("apply", str(config))
            assert broken.rows().keys() == {"/talk", "/talker", "/clock"}
        finally:
            net.set_link(3, "up")
        broken.ask("diff", str(config))
        broken.stop()
    until(lambda: not supervisors(net, 3), "the machine to stop itself")


def test_nothing_changes_where_a_new_machine_cannot_be_used(net: Hosts, tmp_path: Path) -> None:
    config = system(tmp_path, "refused")
    whole, small = config.read_text(), without_h3(config)
    config.write_text(small)
    with running(net, config) as refused:
        rows = refused.loaded().rows()
        for other, problem in (
            (whole.replace("  h3: {", "  h3: {ssh: h9, "), "h9"),
            (small.replace("  h2: {", "  h2: {ssh: h3, "), "ssh has changed"),
            (f"discovery: {{by: peers}}\n{whole}", "by peers"),
        ):
            config.write_text(other)
            text = refused.ask("apply", str(config), code=1)
            assert problem in text, text
            assert refused.rows().keys() == rows.keys()
        assert not supervisors(net, 3)
        refused.stop()


def test_what_fails_on_a_new_machine_is_told_and_the_rest_stays(net: Hosts, tmp_path: Path) -> None:
    config = system(tmp_path, "partly")
    whole = config.read_text().replace("Listener", "Nothing")
    config.write_text(without_h3(config))
    with running(net, config) as partly:
        partly.loaded()
        config.write_text(whole)
        assert "has no component" in partly.ask("apply", str(config), code=1)
        states = {name: row["state"] for name, row in partly.rows().items()}
        assert states["/listener"] == "load failed"
        assert states["/ticks"] == "running"
        # As apply does on one machine, the next one tries what is not there.
        config.write_text(whole.replace("Nothing", "Listener"))
        partly.ask("apply", str(config))
        partly.stop(code=130)


@pytest.mark.parametrize("rolls_back", [False, True])
def test_what_has_failed_is_tried_again_by_a_new_supervisor(
    net: Hosts, tmp_path: Path, rolls_back: bool
) -> None:
    config = system(tmp_path, "again")
    with running(net, config) as again:
        before = again.loaded().rows()
        config.write_text(config.read_text().replace("Listener", "Nothing"))
        back = ["--rollback-on-failure"] if rolls_back else []
        again.ask("apply", *back, str(config), code=1)
        for pid in supervisors(net, 3):
            os.kill(pid, signal.SIGKILL)

        def is_back() -> bool:
            rows = again.rows()
            is_new = rows["/ticks"]["pid"] not in {None, before["/ticks"]["pid"]}
            return is_new and rows["/listener"]["state"] in {"loaded", "load failed"}

        until(is_back, "its return")
        state = again.rows()["/listener"]["state"]
        assert state == ("loaded" if rolls_back else "load failed")
        again.stop()


def test_a_program_that_is_to_be_copied_comes_with_the_change(net: Hosts, tmp_path: Path) -> None:
    tool = tmp_path / "tool"
    tool.write_text("#!/bin/sh\nexec sleep 1000\n")
    tool.chmod(0o755)
    config = system(tmp_path, "tools", more="log_dir: recordings")
    here = config.read_text().replace(
        "machine: h3\n    command", "machine: h3\n    cwd: .\n    command"
    )
    config.write_text(here)
    with running(net, config) as tools:
        before = tools.loaded().rows()
        config.write_text(
            here.replace("lost_after: 1 s}\ncont", "lost_after: 1 s, copy: [tool]}\ncont")
            + "  - {name: tool, machine: h3, cwd: ., command: [./tool]}\n"
        )
        tools.ask("apply", str(config))
        until(lambda: tools.rows()["/tool"]["state"] == "running", "the program")
        assert tools.rows()["/ticks"]["pid"] == before["/ticks"]["pid"]
        adopted = net.folder / "home3/.cache/play-launch/parts/tools-h3"
        tools.ask("restart", "ticks")
        (pid,) = (row["pid"] for name, row in tools.rows().items() if name == "/ticks")
        place = Path(f"/proc/{pid}/cwd").readlink()
        assert place == adopted.resolve() / "files" / tmp_path.relative_to("/")
        # The folder in which the session runs is kept, however many copies follow.
        for number in range(7):
            with config.open("a") as file:
                file.write(f"# {number}\n")
            tools.ask("diff", str(config), code=None)
        (supervisor,) = supervisors(net, 3)
        assert Path(f"/proc/{supervisor}/cwd").readlink().is_dir()
        assert len([*net.folder.glob("home3/.cache/play-launch/parts/tools-h3-*")]) < 9
        # What is recorded is not within a copy, which may be removed.
        recorded = net.folder / f"home3/.cache/play-launch/logs/tools-h3{tmp_path}/recordings"
        assert any(recorded.glob("*/session.mcap*"))
        tools.stop()

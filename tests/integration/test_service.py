"""A system as a service: the unit's own command lines, and a manager's end of the socket."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest

from tests.deploy.listening import Listening
from tests.deploy.units import settings_of, words
from tests.support.replay import run

SYSTEM = """
version: 1
name: robot
stop: {ask: 2 s, sigint: 2 s, sigterm: 2 s}
containers:
  - name: chat
    container_type: isolated
    composable_nodes:
      - {package: play_launch_demo, plugin: "play_launch_demo::Talker", name: talker}
nodes:
  - {name: sleeper, command: [sleep, "1000"]}
"""
MORE = '  - {name: another, command: [sleep, "1000"]}\n'


class Service:
    """What systemd does with a unit, as far as that matters here."""

    def __init__(self, config: Path, listening: Listening, watchdog: float) -> None:
        done = run(
            "systemd-unit", config, "--log-dir", config.parent / "logs", code=0, cwd=config.parent
        )
        self.unit = settings_of(done.stdout)
        self.listening = listening
        variables = [words(each.replace("$", "$$"))[0] for each in self.unit["Service.Environment"]]
        # Nothing else is in the environment of a service but its user.
        self.environment = {"HOME": os.environ["HOME"]} | dict(
            each.split("=", 1) for each in variables
        )
        # The sessions of the tests beside this one are not looked at.
        self.environment["PLAY_LAUNCH_SESSIONS_DIR"] = str(config.parent / "sessions")
        with (config.parent / "journal").open("w") as journal:
            self.process = subprocess.Popen(
                words(self.unit["Service.ExecStart"][0]),
                env={
                    **self.environment,
                    "NOTIFY_SOCKET": listening.address,
                    "WATCHDOG_USEC": f"{watchdog * 1e6:.0f}",
                },
                cwd=self.unit["Service.WorkingDirectory"][0],
                stdin=subprocess.DEVNULL,
                stdout=journal,
                stderr=subprocess.STDOUT,
            )

    def reload(self) -> None:
        command = words(self.unit["Service.ExecReload"][0], MAINPID=str(self.process.pid))
        done = subprocess.run(
            command,
            check=False,
            env=self.environment,
            cwd="/",
            capture_output=True,
            text=True,
            timeout=120,
        )
        assert done.returncode == 0, done.stdout + done.stderr

    def stop(self) -> int:
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(timeout=60)


@contextmanager
def serving(config: Path, listening: Listening, watchdog: float = 30.0) -> Iterator[Service]:
    service = Service(config, listening, watchdog)
    try:
        yield service
    finally:
        if service.process.poll() is None:
            service.process.send_signal(signal.SIGCONT)
            service.stop()
        listening.close()


@pytest.mark.parametrize("kind", ["path", "abstract"])
def test_a_service_lives_as_its_unit_says(tmp_path: Path, kind: str) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text(SYSTEM)
    listening = Listening.in_folder(tmp_path) if kind == "path" else Listening.abstract()
    with serving(config, listening) as service:
        listening.until("READY=1")
        supervisor = psutil.Process(service.process.pid)
        descendants = supervisor.children(recursive=True)
        names = {each.name() for each in descendants}
        assert {"component_conta", "sleep"} <= {name[:15] for name in names}, names
        for each in descendants:
            with contextlib.suppress(psutil.NoSuchProcess, OSError):
                if each.cmdline() == supervisor.cmdline():
                    continue  # forked, and not executed yet: nothing of it is there to be seen
                environment = Path("/proc", str(each.pid), "environ").read_bytes()
                for name in (b"NOTIFY_SOCKET", b"WATCHDOG_USEC"):
                    assert name not in environment, (each, name)
        listening.until("STATUS=1 of 1 nodes loaded, 1 of 1 containers running, 1 of 1 processes")
        config.write_text(SYSTEM + MORE)
        service.reload()
        listening.until("STATUS=1 of 1 nodes loaded, 1 of 1 containers running, 2 of 2 processes")
        status = service.stop()
        listening.until("STOPPING=1")
        assert str(status) in service.unit["Service.SuccessExitStatus"][0].split()
    assert listening.said.count("STOPPING=1") == 1
    assert listening.said.index("READY=1") < listening.said.index("STOPPING=1")
    assert not [each for each in descendants if each.is_running()]


def test_a_stopped_supervisor_feeds_no_watchdog(tmp_path: Path) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text('version: 1\nnodes:\n  - {name: sleeper, command: [sleep, "1000"]}\n')
    listening = Listening.in_folder(tmp_path)
    with serving(config, listening, watchdog=0.3) as service:
        listening.until("READY=1")
        listening.until("WATCHDOG=1")
        service.process.send_signal(signal.SIGSTOP)
        stat = psutil.Process(service.process.pid)
        os.waitid(os.P_PID, service.process.pid, os.WSTOPPED | os.WNOWAIT)
        assert stat.status() == psutil.STATUS_STOPPED
        listening.hear_all()
        assert listening.hear(1.5) == [], "five times as long as the watchdog waits"
        service.process.send_signal(signal.SIGCONT)
        listening.until("WATCHDOG=1")
        listening.hear_all()
        listening.until("WATCHDOG=1")


def test_a_system_that_fails_is_ready_and_says_what_failed(tmp_path: Path) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text(
        "version: 1\nnodes:\n"
        '  - {name: sleeper, command: [sleep, "1000"]}\n'
        '  - {name: broken, command: ["false"]}\n'
    )
    with serving(config, Listening.in_folder(tmp_path)) as service:
        service.listening.until("READY=1")
        service.listening.until("STATUS=1 of 2 processes running; failed: /broken")


def test_a_mistake_is_no_reason_to_start_again(tmp_path: Path) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text("version: 1\nnodes: [{command: ['true']}]\n")
    listening = Listening.in_folder(tmp_path)
    with serving(config, listening) as service:
        assert service.process.wait(timeout=60) == 0
        assert service.unit["Service.RestartPreventExitStatus"] == ["2"]
        config.write_text("version: 1\nnodes: [{comand: ['true']}]\n")
        command = words(service.unit["Service.ExecStart"][0])
        done = subprocess.run(command, check=False, env=service.environment, capture_output=True)
        assert done.returncode == 2
        # It was over before the first check, and that is a success.
        assert [each for each in listening.hear_all() if each.endswith("=1")][:1] != ["STOPPING=1"]
        assert "READY=1" in listening.said

"""Machines whose systemd keeps the session: a real one, booted over this machine's files."""

from __future__ import annotations

import json
import shutil
import signal
from pathlib import Path

import pytest

from tests.support.hosts import Hosts, missing_systemd, running
from tests.support.replay import COMMAND
from tests.support.waiting import until

pytestmark = pytest.mark.skipif(bool(missing_systemd()), reason=f"systemd: {missing_systemd()}")


def test_systemd_keeps_the_sessions_of_machines(tmp_path: Path) -> None:
    """One test, as hosts are booted for it: linger, notify, restart, adoption, reboots, service."""
    config = tmp_path / "units.yaml"
    config.write_text(
        f"""\
version: 1
name: units
environment: {{ROS_AUTOMATIC_DISCOVERY_RANGE: SUBNET}}
machines:
  main: {{local: true}}
  user: {{ssh: robot@s21, play_launch: {COMMAND}, lost_after: 1 s}}
  system: {{ssh: root@s22, service: system, play_launch: {COMMAND}, lost_after: 1 s}}
containers:
  - name: talk
    machine: user
    container_type: isolated
    composable_nodes:
      - {{package: play_launch_demo, plugin: "play_launch_demo::Talker", name: talker}}
  - name: listen
    machine: system
    depends_on: [talk]
    composable_nodes:
      - {{package: play_launch_demo, plugin: "play_launch_demo::Listener", name: listener}}
"""
    )
    with Hosts(tmp_path / "hosts", 1) as net:
        net.boot(21)
        net.boot(22)
        refused = net.run("replay", str(config))
        assert refused.returncode == 1
        assert "machine user: " in refused.stderr
        assert "loginctl enable-linger" in refused.stderr
        net.ssh("root@s21", "loginctl enable-linger robot")
        linger = tmp_path / "hosts/root21.disk/var/lib/systemd/linger"
        linger.mkdir(parents=True)
        (linger / "robot").touch()

        show = "systemctl --user show -p {} --value play-launch-units-user"
        with running(net, config) as first:
            first.loaded()
            # Type=notify: active means that all is loaded.
            assert (net.ssh("robot@s21", show.format("ActiveState")) or "").strip() == "active"
            status = net.ssh("root@s22", "systemctl status play-launch-units-system")
            assert "1 of 1 nodes loaded" in (status or "")
            net.ssh("robot@s21", f"kill -9 $({show.format('MainPID')})")
            until(lambda: "started anew" in first.printed(), "the restart by systemd")
            first.loaded()
            assert (net.ssh("robot@s21", show.format("NRestarts")) or "").strip() == "1"
            before = first.rows()
            first.process.send_signal(signal.SIGKILL)
            first.process.wait()
        with running(net, config) as second:
            rows = second.loaded().rows()
            assert {name: row["pid"] for name, row in rows.items()} == {
                name: row["pid"] for name, row in before.items()
            }
            net.boot(21)
            until(lambda: "was booted anew" in second.printed(), "the return after the reboot")
            second.loaded()
            assert second.rows()["/talker"]["state"] == "loaded"
            second.stop()
        _nothing_runs(net)
        _a_service_brings_them_up(net, config)
        _nothing_runs(net)


def _nothing_runs(net: Hosts) -> None:
    for host, manager in (("robot@s21", "systemctl --user"), ("root@s22", "systemctl")):
        assert not net.ssh(host, f"{manager} list-units --no-legend 'play-launch*'")


def _a_service_brings_them_up(net: Hosts, config: Path) -> None:
    """The coordinator's host starts it at boot; after another boot, it adopts what runs."""
    disk = net.folder / "root23.disk"
    shutil.copytree(net.home / ".ssh", disk / "root/.ssh")
    shutil.copy(config, disk / "root")
    net.boot(23)
    units = disk / "etc/systemd/system"
    (units / "host.target.wants").mkdir(parents=True)
    unit = net.ssh("root@s23", f"{COMMAND} systemd-unit units.yaml")
    (units / "robot.service").write_text(unit or "")
    (units / "host.target.wants/robot.service").symlink_to("../robot.service")

    def booted() -> dict[str, int]:
        net.boot(23)
        until(
            lambda: net.ssh("root@s23", "systemctl is-active robot", None) is not None, "its start"
        )
        rows = json.loads(net.ssh("root@s23", f"{COMMAND} ps --json") or "")
        assert {row["state"] for row in rows} <= {"loaded", "running"}
        return {row["name"]: row["pid"] for row in rows}

    assert booted() == booted()
    status = net.ssh("root@s23", "systemctl status robot")
    assert "2 of 2 machines running, 4 of 4 up" in (status or "")
    net.ssh("root@s23", "systemctl stop robot")

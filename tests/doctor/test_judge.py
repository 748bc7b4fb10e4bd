"""One changed fact, one finding: its level, and a word of what it says, impact and advises."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from play_launch.doctor.facts import KeySupport, Limit, MachineFacts
from play_launch.doctor.finding import Finding, Level, can_run
from play_launch.doctor.judge import judge
from play_launch.doctor.surroundings import Surroundings
from play_launch.process.cgroups.controllers import Lack

from .machines import (
    CONTAINER,
    GROUPS,
    KERNEL,
    LIMITS,
    MACHINE,
    NETWORK,
    PYTHON,
    RECORDING,
    ROS,
    SHARED_MEMORY,
)

OK, WARN, FAIL = Level.OK, Level.WARN, Level.FAIL


def of(facts: MachineFacts, subject: str) -> Finding:
    (finding,) = (each for each in judge(facts) if each.subject == subject)
    return finding


def test_a_good_machine_has_nothing_to_complain_about() -> None:
    findings = judge(MACHINE)
    assert {each.level for each in findings} == {OK}
    assert all(each.says and not each.impact and not each.fix for each in findings)
    assert can_run(findings)
    assert len({each.subject for each in findings}) == len(findings)


def python(**changes: Any) -> MachineFacts:
    return replace(MACHINE, python=replace(PYTHON, **changes))


def ros(**changes: Any) -> MachineFacts:
    return replace(MACHINE, ros=replace(ROS, **changes))


def container(**changes: Any) -> MachineFacts:
    return replace(MACHINE, container=replace(CONTAINER, **changes))


def kernel(**changes: Any) -> MachineFacts:
    return replace(MACHINE, kernel=replace(KERNEL, **changes))


def groups(**changes: Any) -> MachineFacts:
    return replace(MACHINE, groups=replace(GROUPS, **changes))


def limits(**changes: Any) -> MachineFacts:
    return replace(MACHINE, limits=replace(LIMITS, **changes))


def memory(**changes: Any) -> MachineFacts:
    return replace(MACHINE, shared_memory=replace(SHARED_MEMORY, **changes))


def network(**changes: Any) -> MachineFacts:
    return replace(MACHINE, network=replace(NETWORK, **changes))


def recording(**changes: Any) -> MachineFacts:
    return replace(MACHINE, recording=replace(RECORDING, **changes))


def cyclone(discovery_range: str = "SYSTEM_DEFAULT", **changes: Any) -> MachineFacts:
    rmw = "rmw_cyclonedds_cpp"
    return replace(
        network(discovery_range=discovery_range, **changes),
        ros=replace(ROS, rmw_in_use=rmw, rmw_asked_for=rmw),
    )


SMALL = Limit(soft=1024, hard=4096)
NONE = Limit(soft=0, hard=0)

TAKEN = "not ours; fix: take it"
CONTROLLERS = ("cpu", "cpuset", "io", "memory", "pids")

# What is changed, whom it concerns, how bad it is, and a part of the whole finding.
CASES: list[tuple[MachineFacts, str, Level, str]] = [
    (python(version=(3, 10, 4)), "Python", FAIL, "3.11 or newer"),
    (python(version=(3, 11, 0)), "Python", OK, "3.11.0"),
    (python(version=(3, 13, 9)), "Python", OK, "3.13.9"),
    (python(version=(3, 14, 0)), "Python", WARN, "not been tried"),
    (python(packages={}), "packages", WARN, "pip install ."),
    (ros(problem="there is no ROS 2: source it"), "ROS", FAIL, "there is no ROS 2"),
    (ros(import_errors={"rclpy": "no such file"}), "rclpy", FAIL, "no such file"),
    (ros(import_errors={"play_launch_msgs": "x"}), "play_launch_msgs", FAIL, "pip install ."),
    (
        ros(import_errors={"composition_interfaces": "x"}),
        "composition_interfaces",
        WARN,
        "container_type stock",
    ),
    (ros(rmw_asked_for="rmw_x"), "middleware", FAIL, "rmw_x does not load"),
    (
        ros(rmw_asked_for="rmw_x", middleware_problem="rmw_x is not installed"),
        "middleware",
        FAIL,
        "rmw_x is not installed",
    ),
    (cyclone(), "middleware", OK, "rmw_cyclonedds_cpp"),
    (cyclone(), "shared memory", OK, "rmw_cyclonedds_cpp is in use"),
    (cyclone(""), "discovery", WARN, "MaxAutoParticipantIndex"),
    (cyclone("LOCALHOST"), "discovery", WARN, "after 32 processes"),
    (cyclone(), "discovery", OK, "SYSTEM_DEFAULT"),
    (cyclone("LOCALHOST", cyclone_uri="x"), "discovery", OK, "this machine only"),
    (ros(source="wheels", rmw_asked_for="rmw_fastrtps_cpp"), "middleware", OK, "fastrtps"),
    (ros(stock_container=""), "stock containers", WARN, "rclcpp-components"),
    (ros(ros2_needs="export A=b"), "ros2 command", OK, "after: export A=b"),
    (container(problem="there is none", program=""), "container", FAIL, "there is none"),
    (container(version="0.0.9"), "container", WARN, "the supervisor is 0.1.0"),
    (
        container(backends=("native",)),
        "rclcpp components",
        WARN,
        "not built with rclcpp support; backends: native",
    ),
    (container(backends=()), "rclcpp components", WARN, "backends: none"),
    (
        container(mechanism="process", notes=("Linux is 5.10",)),
        "isolation",
        WARN,
        "by process: Linux is 5.10",
    ),
    (container(notes=("code is missing",)), "isolation", OK, "by pointer; code is missing"),
    (container(allocator=""), "allocator", WARN, "cmeel-mimalloc"),
    (container(allocator="", allocator_problem="it is a text"), "allocator", WARN, "it is a text"),
    (kernel(has_pidfd=False), "kernel", FAIL, "5.3 or newer"),
    (
        groups(folder="", problem="none; fix: mount it"),
        "control groups",
        OK,
        "groups |  | mount it",
    ),
    (groups(problem=TAKEN), "control groups", OK, "not ours: no limits"),
    (
        groups(problem=TAKEN),
        "control groups",
        OK,
        "take it\nas a system service",
    ),
    (groups(controllers=()), "control groups", OK, "Delegate=cpu cpuset io memory pids"),
    (
        groups(controllers=(), lacks=dict.fromkeys(CONTROLLERS, Lack.IN_VERSION_1)),
        "control groups",
        OK,
        "no limits for groups |  | boot with the kernel's parameter systemd.unified_cgroup",
    ),
    (
        groups(controllers=("cpu", "cpuset", "io", "pids"), lacks={"memory": Lack.SWITCHED_OFF}),
        "control groups",
        OK,
        "without memory |  | boot without the kernel's parameter cgroup_disable=memory",
    ),
    (groups(controllers=("cpu", "pids")), "control groups", OK, "without cpuset, io, memory"),
    (replace(MACHINE, keys=KeySupport.NO_CPU), "protection keys", OK, "no pku"),
    (replace(MACHINE, keys=KeySupport.REFUSED), "protection keys", OK, "is ordinary memory"),
    (replace(MACHINE, keys=KeySupport.NO_KERNEL), "protection keys", OK, "nopku"),
    (replace(MACHINE, keys=KeySupport.REFUSED), "protection keys", OK, "seccomp"),
    (limits(real_time_share=0.0), "real-time", OK, "sysctl kernel.sched_rt_runtime_us"),
    (limits(real_time_share=0.95), "real-time", OK, "up to 99, 95 % of the time"),
    (kernel(proc_problem="/proc is not mounted"), "/proc", FAIL, "mount -t proc"),
    (limits(address_space=Limit(soft=512 << 20, hard=None)), "address space", FAIL, "512 MiB"),
    (limits(address_space=Limit(soft=2 << 30, hard=None)), "address space", WARN, "2.0 GiB"),
    (limits(address_space=Limit(soft=8 << 30, hard=None)), "address space", OK, "8.0 GiB"),
    (limits(nofile=SMALL), "open files", OK, "replay raises its own to 4,096"),
    (limits(nofile=Limit(soft=4096, hard=None)), "open files", OK, "4,096"),
    (limits(nofile=Limit(soft=1024, hard=2048)), "open files", WARN, "1,024 (at most 2,048)"),
    (limits(nofile=Limit(soft=10, hard=20)), "open files", WARN, "LimitNOFILE=65536"),
    # As nearly everywhere.
    (limits(nofile=Limit(soft=1024, hard=2**20)), "open files", OK, "raises its own to 65,536"),
    (limits(nofile=Limit(soft=1024, hard=None)), "open files", OK, "raises its own to 65,536"),
    (limits(nproc=SMALL), "processes", WARN, "1,024 (at most 4,096) |"),
    (limits(nproc=SMALL), "processes", WARN, "ulimit -u 4096"),
    (limits(nproc=Limit(soft=9, hard=9)), "processes", WARN, "LimitNPROC=infinity"),
    (limits(core=NONE), "core dumps", OK, "backtrace"),
    (limits(memlock=Limit(soft=8 << 20, hard=None)), "locked memory", OK, "8 MiB"),
    (limits(memlock=SMALL), "locked memory", OK, '"<user> - memlock unlimited"'),
    (limits(memlock=SMALL, may_lock_memory=True), "locked memory", OK, "CAP_IPC_LOCK"),
    (limits(rtprio=NONE), "real-time", OK, "LimitRTPRIO=99"),
    (limits(rtprio=NONE, may_schedule=True), "real-time", OK, "up to 99 (CAP_SYS_NICE)"),
    (limits(rtprio=Limit(soft=40, hard=40)), "real-time", OK, "up to 40"),
    (limits(nice=NONE), "nice values", OK, "LimitNICE=-20"),
    (limits(nice=Limit(soft=25, hard=25)), "nice values", OK, "down to -5"),
    (limits(nice=NONE, may_schedule=True), "nice values", OK, "down to -20"),
    (memory(is_writable=False), "shared memory", WARN, "cannot be used"),
    (memory(total=None, free=None), "shared memory", WARN, "cannot be used"),
    (memory(total=64 << 20, free=60 << 20), "shared memory", WARN, "--shm-size"),
    (memory(total=64 << 20, free=0), "shared memory", FAIL, "dies of SIGBUS"),
    (memory(segments=9, leftovers=3), "leftovers", WARN, "3 of 9"),
    (memory(segments=9), "leftovers", OK, "9 files"),
    (network(loopback_works=False), "loopback", FAIL, "ip link set lo up"),
    (network(loopback_has_multicast=False), "loopback", OK, "works"),
    (network(discovery_range="LOCALHOST"), "discovery", WARN, "first 32"),
    (network(localhost_only="1"), "discovery", WARN, "first 32"),
    (network(discovery_range="subnet", localhost_only="1"), "discovery", OK, "SUBNET"),
    (network(discovery_range="OFF"), "discovery", WARN, "container_type stock"),
    (network(discovery_range="NEAR"), "discovery", WARN, "does not know"),
    (network(domain_id="233"), "domain", FAIL, "0 to 232"),
    (network(domain_id="five"), "domain", FAIL, "five"),
    (network(domain_id="-1"), "domain", FAIL, "-1"),
    (network(domain_id="101"), "domain", OK, "32650 to 32767"),
    (network(domain_id="102"), "domain", WARN, "ports 32768 to 60999"),
    (network(domain_id="232", ephemeral_ports=None), "domain", OK, "232"),
    (recording(problem="/ cannot be written to"), "recordings", FAIL, "PLAY_LAUNCH_LOG_DIR"),
    (recording(free=5 << 20), "recordings", WARN, "5 MiB free"),
    (recording(free=None), "recordings", OK, "play_launch"),
]


def test_multicast_on_loopback_matters_to_those_who_stay_there() -> None:
    without = network(loopback_has_multicast=False, localhost_only="1")
    assert of(without, "loopback").level is WARN
    assert "multicast on" in of(without, "loopback").fix
    unknown = network(loopback_has_multicast=None, localhost_only="1")
    assert of(unknown, "loopback").level is OK


@pytest.mark.parametrize(
    ("facts", "subject", "level", "word"),
    CASES,
    ids=[f"{subject}-{level}-{word}" for _, subject, level, word in CASES],
)
def test_one_fact_makes_one_finding(
    facts: MachineFacts, subject: str, level: Level, word: str
) -> None:
    finding = of(facts, subject)
    assert finding.level is level
    assert word in f"{finding.says} | {finding.impact} | {finding.fix}"
    assert bool(finding.impact) is (level is not OK)
    assert finding.fix or level is OK
    others = [each for each in judge(facts) if each.subject != subject and each.level is not OK]
    assert not others
    assert can_run(judge(facts)) is (level is not FAIL)


LACKING = replace(
    groups(problem=TAKEN),
    limits=replace(LIMITS, rtprio=NONE, nice=NONE, memlock=SMALL),
)
COMMANDS = {
    Surroundings.SYSTEM_SERVICE: (
        "Delegate=yes",
        "LimitRTPRIO=99",
        "LimitNICE=-20",
        "LimitMEMLOCK",
    ),
    Surroundings.USER_SERVICE: ("Delegate=yes", *["systemctl edit user@.service"] * 3),
    Surroundings.DOCKER: ("writable-cgroups=true", "SYS_NICE --ulimit rtprio", "SYS_NICE", "-1:-1"),
    Surroundings.PODMAN: ("unmask=/sys/fs/cgroup", "podman run --cap-add", "SYS_NICE", "memlock"),
}


@pytest.mark.parametrize("started_by", COMMANDS)
def test_rights_are_had_by_the_command_for_what_started_it(started_by: Surroundings) -> None:
    facts = replace(LACKING, surroundings=started_by)
    subjects = ("control groups", "real-time", "nice values", "locked memory")
    for subject, command in zip(subjects, COMMANDS[started_by], strict=True):
        finding = of(facts, subject)
        assert command in finding.fix
        assert "\n" not in finding.fix, "nothing is said about what it was not started by"
        assert finding.level is OK


def test_a_user_s_manager_is_asked_for_more_controllers() -> None:
    facts = replace(groups(controllers=("cpu",)), surroundings=Surroundings.USER_SERVICE)
    assert "Delegate=cpu cpuset io memory pids" in of(facts, "control groups").fix

"""A machine on which all is well; tests change one thing."""

from __future__ import annotations

from play_launch.doctor.facts import (
    ContainerFacts,
    GroupFacts,
    KernelFacts,
    KeySupport,
    Limit,
    LimitFacts,
    MachineFacts,
    NetworkFacts,
    PythonFacts,
    RecordingFacts,
    RosFacts,
    SharedMemoryFacts,
)

GIBIBYTE = 1024**3
PYTHON = PythonFacts(
    version=(3, 12, 1), executable="/usr/bin/python3", packages={"play-launch-py": "0.1.0"}
)
ROS = RosFacts(
    source="system",
    prefix="/opt/ros/jazzy",
    rmw_in_use="rmw_fastrtps_cpp",
    stock_container="/opt/ros/jazzy/lib/rclcpp_components/component_container",
)
CONTAINER = ContainerFacts(
    program="/opt/x/component_container",
    version="0.1.0",
    backends=("rclcpp", "native"),
    mechanism="shared_memory",
    allocator="/usr/lib/libmimalloc.so.2",
)
KERNEL = KernelFacts(release="6.8.0", has_pidfd=True)
GROUPS = GroupFacts(
    folder="/sys/fs/cgroup/robot",
    controllers=("cpuset", "cpu", "io", "memory", "hugetlb", "pids"),
)
UNLIMITED = Limit(soft=None, hard=None)
LIMITS = LimitFacts(
    nofile=UNLIMITED,
    nproc=UNLIMITED,
    core=UNLIMITED,
    memlock=UNLIMITED,
    address_space=UNLIMITED,
    rtprio=Limit(soft=99, hard=99),
    nice=Limit(soft=40, hard=40),
    may_schedule=False,
    may_lock_memory=False,
)
SHARED_MEMORY = SharedMemoryFacts(total=8 * GIBIBYTE, free=8 * GIBIBYTE, is_writable=True)
NETWORK = NetworkFacts(
    loopback_works=True, loopback_has_multicast=True, ephemeral_ports=(32768, 60999)
)
RECORDING = RecordingFacts(folder="/var/log/play_launch", free=100 * GIBIBYTE)
MACHINE = MachineFacts(
    python=PYTHON,
    ros=ROS,
    container=CONTAINER,
    kernel=KERNEL,
    groups=GROUPS,
    keys=KeySupport.USABLE,
    limits=LIMITS,
    shared_memory=SHARED_MEMORY,
    network=NETWORK,
    recording=RECORDING,
)

"""A reader that dies in the midst of a message does not take its writers with it.

The writer is held up where it makes the difference: it has seen that the reader's queue is in
order, and before it takes the queue's mutex Fast DDS finds that it is not.
"""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from play_launch.container.environment import preloading, with_safe_waits
from play_launch.container.ros import component_container
from play_launch.ros.fastdds.middleware import asks_for_fastdds

PATIENCE = 60.0
HELD_UP = """
#include <dlfcn.h>
#include <pthread.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cstdlib>
#include <ctime>

// Once, and only the first thread, as soon as the file is there: for longer than Fast DDS takes to
// find that nobody reads any more, which is two looks a second or more apart.
extern "C" int pthread_mutex_timedlock(pthread_mutex_t* mutex, const timespec* deadline) noexcept {
  static bool is_over = false;
  if (!is_over && syscall(SYS_gettid) == getpid() && access(std::getenv("HELD_UP"), F_OK) == 0) {
    is_over = true;
    sleep(5);
    timespec later{};
    clock_gettime(CLOCK_REALTIME, &later);
    later.tv_sec += 1;
    auto* const next = reinterpret_cast<int (*)(pthread_mutex_t*, const timespec*)>(
        dlsym(RTLD_NEXT, "pthread_mutex_timedlock"));
    return next(mutex, &later);
  }
  auto* const next = reinterpret_cast<int (*)(pthread_mutex_t*, const timespec*)>(
      dlsym(RTLD_NEXT, "pthread_mutex_timedlock"));
  return next(mutex, deadline);
}
"""
BEST_EFFORT = """
import sys, rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
qos = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
"""
WRITING = (
    BEST_EFFORT
    + """
import time
rclpy.init()
node = rclpy.create_node("writer")
publisher = node.create_publisher(String, sys.argv[1], qos)
readers = [-1]
while readers[1:] != [0, 1, 0]:
    publisher.publish(String(data="x"))
    time.sleep(0.002)
    if readers[-1] != publisher.get_subscription_count():
        readers.append(publisher.get_subscription_count())
        print(readers[-1], flush=True)
"""
)
READING = (
    BEST_EFFORT
    + """
import ctypes, os, signal, threading
from pathlib import Path
rclpy.init()
node = rclpy.create_node("reader")
subscription = node.create_subscription(String, sys.argv[1], print, qos)
rcl = ctypes.CDLL("librcl.so")
callback_type = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_size_t)
received = 0

@callback_type
def on_message(_: int, count: int) -> None:
    global received
    received += count
    # Called by Fast DDS while it reads, or, if there were messages already, right now.
    if threading.get_native_id() != os.getpid() and received > 100:
        Path(sys.argv[2]).touch()
        os.kill(os.getpid(), signal.SIGKILL)

on_new = rcl.rcl_subscription_set_on_new_message_callback
on_new.argtypes = [ctypes.c_void_p, callback_type, ctypes.c_void_p]
with subscription.handle:
    on_new(subscription.handle.pointer, on_message, None)
    signal.pause()
"""
)
LEASE = """<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <participant profile_name="short" is_default_profile="true"><rtps><builtin><discovery_config>
    <leaseDuration><sec>8</sec></leaseDuration><leaseAnnouncement><sec>1</sec></leaseAnnouncement>
  </discovery_config></builtin></rtps></participant>
</profiles>
"""


@pytest.mark.skipif(not asks_for_fastdds(os.environ), reason="the middleware is not Fast DDS")
def test_a_writer_goes_on(tmp_path: Path) -> None:
    source, holding = tmp_path / "held_up.cpp", tmp_path / "held_up.so"
    source.write_text(HELD_UP)
    compiler = os.environ.get("CXX", "c++")
    subprocess.run([compiler, "-shared", "-fPIC", "-o", holding, source, "-ldl"], check=True)
    profile, mark = tmp_path / "lease.xml", tmp_path / "has died"
    profile.write_text(LEASE)
    common = {**os.environ, "FASTRTPS_DEFAULT_PROFILES_FILE": str(profile), "HELD_UP": str(mark)}
    environment = preloading(with_safe_waits(common, component_container()), holding)
    topic = f"/{tmp_path.name}"
    lines: queue.Queue[str] = queue.Queue()
    with subprocess.Popen(
        [sys.executable, "-c", WRITING, topic],
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    ) as writer:
        listener = threading.Thread(target=lambda: [*map(lines.put, writer.stdout or ())])
        listener.start()
        try:
            assert lines.get(timeout=PATIENCE) == "0\n"
            reader = subprocess.run(
                [sys.executable, "-c", READING, topic, mark],
                check=False,
                env=common,
                timeout=PATIENCE,
            )
            assert reader.returncode == -signal.SIGKILL
            assert lines.get(timeout=PATIENCE) == "1\n"
            assert lines.get(timeout=PATIENCE) == "0\n", "the dead reader is not forgotten"
            assert writer.wait(timeout=PATIENCE) == 0
        finally:
            writer.kill()
            listener.join()

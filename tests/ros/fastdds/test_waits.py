"""Fast DDS in a Python process: waits leave others the mutex, and a dead reader holds up none."""

from __future__ import annotations

import errno
import os
import queue
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from play_launch.container.environment import preloading, with_safe_waits
from play_launch.container.ros import RosSource, component_container, ros_installation
from play_launch.ros.fastdds.middleware import asks_for_fastdds

WAITING = """
#include <cerrno>
#include <ctime>
#include <netinet/in.h>
#include <pthread.h>
#include <sys/socket.h>
#include <unistd.h>

// The nanoseconds that a wait until then takes, or minus its error.
extern "C" long wait_until(long seconds) {
  pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
  pthread_cond_t condition = PTHREAD_COND_INITIALIZER;
  timespec begin, end, deadline{seconds, 0};
  pthread_mutex_lock(&mutex);
  clock_gettime(CLOCK_MONOTONIC, &begin);
  const int error = pthread_cond_timedwait(&condition, &mutex, &deadline);
  clock_gettime(CLOCK_MONOTONIC, &end);
  pthread_mutex_unlock(&mutex);
  if (error != ETIMEDOUT) return -error;
  return (end.tv_sec - begin.tv_sec) * 1000000000L + end.tv_nsec - begin.tv_nsec;
}

// Takes a mutex between processes twice; returns the error of the second time.
extern "C" int lock_twice() {
  pthread_mutex_t mutex;
  pthread_mutexattr_t attributes;
  pthread_mutexattr_init(&attributes);
  pthread_mutexattr_setpshared(&attributes, PTHREAD_PROCESS_SHARED);
  pthread_mutex_init(&mutex, &attributes);
  const timespec passed{0, 0};
  if (pthread_mutex_timedlock(&mutex, &passed) != 0) return -1;
  const int error = pthread_mutex_timedlock(&mutex, &passed);
  if (error == 0) pthread_mutex_unlock(&mutex);
  if (pthread_mutex_trylock(&mutex) == 0) return -2;
  pthread_mutex_unlock(&mutex);
  return pthread_mutex_trylock(&mutex) == 0 ? error : -3;
}

// The receive buffer of a socket for datagrams, once it is bound.
extern "C" int receive_buffer() {
  const int fd = socket(AF_INET, SOCK_DGRAM, 0);
  const sockaddr_in loopback{AF_INET, 0, {htonl(INADDR_LOOPBACK)}, {}};
  int size = 0;
  socklen_t length = sizeof size;
  if (bind(fd, reinterpret_cast<const sockaddr*>(&loopback), sizeof loopback) != 0) return -1;
  getsockopt(fd, SOL_SOCKET, SO_RCVBUF, &size, &length);
  close(fd);
  return size;
}
"""
TRYING = """
import ctypes, sys
from play_launch.ros.fastdds.own_participant import end_participants_safely

library = ctypes.CDLL(sys.argv[1])
library.wait_until.argtypes = [ctypes.c_long]
library.wait_until.restype = ctypes.c_long
other = ctypes.CDLL(sys.argv[2])
other.wait_until.argtypes = [ctypes.c_long]
other.wait_until.restype = ctypes.c_long
print(end_participants_safely(("libpeculiar",)))
print(library.wait_until(-1), library.wait_until(1), other.wait_until(-1))
print(library.lock_twice(), other.lock_twice())
print(library.receive_buffer(), other.receive_buffer())
"""
LIMITS = ("default", "max")
PAUSE = 10_000_000
"""ns; not less than this passes in a wait whose deadline has overflowed."""


def python(code: str, *arguments: str | Path) -> list[str]:
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout.split()


@pytest.mark.parametrize("binding", ["-Wl,-z,lazy", "-Wl,-z,now", "-fno-plt"])
def test_the_functions_of_a_library_are_replaced(tmp_path: Path, binding: str) -> None:
    source = tmp_path / "waiting.cpp"
    source.write_text(WAITING)
    libraries = [tmp_path / "libpeculiar.so", tmp_path / "libother.so"]
    for library in libraries:
        options = ["-shared", "-fPIC", "-O1", binding, "-Wl,-z,relro", "-o", str(library)]
        compiler = os.environ.get("CXX", "c++")
        subprocess.run([compiler, *options, str(source)], check=True)
    replaced, overflowed, past, elsewhere, own_lock, other_lock, buffer, other_buffer = map(
        int, python(TRYING, *libraries)
    )
    assert replaced == 1
    assert overflowed >= PAUSE
    assert past >= 0
    assert elsewhere >= 0, "what others wait for is not touched, and goes on working"
    assert (own_lock, other_lock) == (0, errno.ETIMEDOUT)
    default, most = (int(Path(f"/proc/sys/net/core/rmem_{name}").read_text()) for name in LIMITS)
    # The kernel doubles what is asked for.
    assert (buffer, other_buffer) == (max(default, 2 * min(most, 4 << 20)), default)


@pytest.mark.skipif(
    ros_installation().source is not RosSource.WHEELS,
    reason="a Fast DDS that was built for this system may wait in another way",
)
def test_fast_dds_of_the_wheels_gets_it() -> None:
    code = (
        "import rclpy;"
        "from play_launch.ros.fastdds.own_participant import end_participants_safely as end;"
        "rclpy.init(); print(end()); rclpy.shutdown()"
    )
    assert python(code) == ["1"]


@pytest.mark.parametrize(
    "participant",
    [
        "from play_launch.ros.thread import RosThread; own = RosThread('probe'); own.start()",
        "from play_launch.graph_daemon.ros_graph import RosGraph; own = RosGraph(1, print)",
    ],
    ids=["supervisor", "daemon"],
)
def test_a_process_with_a_participant_has_the_library_for_waits(participant: str) -> None:
    loaded = "print('libfastdds_waits.so' in open('/proc/self/maps').read())"
    assert python(f"{participant}; {loaded}; own.close()")[-1] == "True"


TIMEOUT = 60.0
HELD_UP = """
#include <dlfcn.h>
#include <pthread.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cstdlib>
#include <ctime>

// Once, and only the first thread, as soon as the file is there: for longer than Fast DDS takes to
// find that there is no reader, which is two looks a second or more apart.
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
            assert lines.get(timeout=TIMEOUT) == "0\n"
            reader = subprocess.run(
                [sys.executable, "-c", READING, topic, mark],
                check=False,
                env=common,
                timeout=TIMEOUT,
            )
            assert reader.returncode == -signal.SIGKILL
            assert lines.get(timeout=TIMEOUT) == "1\n"
            assert lines.get(timeout=TIMEOUT) == "0\n", "the dead reader is not forgotten"
            assert writer.wait(timeout=TIMEOUT) == 0
        finally:
            writer.kill()
            listener.join()

"""Fast DDS in a Python process: overflowed waits leave others the mutex, none is for itself."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from play_launch.container.ros import RosSource, ros_installation

WAITING = """
#include <cerrno>
#include <ctime>
#include <pthread.h>

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
"""
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
    replaced, overflowed, past, elsewhere, own_lock, other_lock = map(
        int, python(TRYING, *libraries)
    )
    assert replaced == 1
    assert overflowed >= PAUSE
    assert past >= 0
    assert elsewhere >= 0, "what others wait for is not touched, and goes on working"
    assert (own_lock, other_lock) == (0, errno.ETIMEDOUT)


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
def test_who_has_a_participant_has_it(participant: str) -> None:
    loaded = "print('libfastdds_waits.so' in open('/proc/self/maps').read())"
    assert python(f"{participant}; {loaded}; own.close()")[-1] == "True"

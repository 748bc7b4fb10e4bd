#pragma once

#include <pthread.h>
#include <sys/socket.h>

#include <cstddef>
#include <ctime>

/// What Fast DDS waits, sends and receives with, instead of the C library's functions of these
/// names.
namespace play_launch::fastdds {

/// pthread_cond_timedwait() that pauses for 10 ms where the deadline is before 1970.
///
/// Where std::condition_variable waits by the steady clock without limit (time_point::max()),
/// libstdc++ without pthread_cond_clockwait(), which libraries for old systems are built with, as
/// the ROS wheels are, adds the difference of two clocks to it. The sum overflows: a deadline long
/// before 1970. The wait returns at once, finds that the time has not come, and waits again. Fast
/// DDS does so when a participant goes while a discovery callback runs
/// (DomainParticipantImpl::set_listener() of version 2.14), and it keeps the mutex from the very
/// thread that it waits for: containers that were stopped during discovery took a processor for a
/// second or more. The pause is late, as POSIX allows, so that the mutex is free meanwhile.
int timedwait(pthread_cond_t* condition, pthread_mutex_t* mutex, const timespec* deadline);

/// pthread_mutex_timedlock() that gives a thread a plain mutex between processes again which it
/// holds already; the first of the two unlocks then does nothing.
///
/// Where the reader of a queue in shared memory dies, or looks dead, in the midst of a message,
/// each of its writers looks for what it was reading, under the queue's mutex, and takes the same
/// mutex once more to note that it has found it
/// (SharedMemGlobal::Port::get_and_remove_blocked_processing() of Fast DDS, in version 2.14 and
/// since). That waits for itself, for the second that Fast DDS gives each lock, then the note is
/// missing, it finds the same again, without end: the process goes on publishing nothing, and
/// a process that shares the queue waits a second for each of its locks.
int timedlock(pthread_mutex_t* mutex, const timespec* deadline) noexcept;
int unlock(pthread_mutex_t* mutex) noexcept;

/// Besides, where calls are replaced: DataReaderHistory::remove_change_sub() of versions 2.14 and
/// 3.2 that goes on behind a sample which it cannot remove.
///
/// With large messages from several writers a reader's list of samples may keep one that is back in
/// the pool already, and empty. DataReader::take() cannot read it, cannot remove it, as it is not
/// in the history, and begins anew with it, without end, holding the reader's mutex: soon no thread
/// of the participant goes on. Seen with images of 2 MB in standard and isolated containers.

/// sendto() and sendmsg() that send later, and report that they did at once, while the calling
/// thread withholds. Fast DDS 2 sends datagrams by the first, version 3 by the second.
ssize_t sendto(int socket, const void* data, std::size_t size, int flags, const sockaddr* address,
               socklen_t address_size) noexcept;
ssize_t sendmsg(int socket, const msghdr* message, int flags) noexcept;

/// Has what the calling thread sends withheld, or sends it.
///
/// A participant announces itself before its receivers are registered
/// (RTPSParticipantImpl::enable() of version 2.14). What exists already answers once, to that first
/// announcement, and the answer is lost: both meet when the other one announces itself again, every
/// 3 s. So the announcement is sent when the participant is made.
void withhold_datagrams(bool enabled) noexcept;

/// Withholds what the calling thread sends as long as it lives, to make a participant.
class Withholding {
 public:
  Withholding() noexcept { withhold_datagrams(true); }
  ~Withholding() { withhold_datagrams(false); }
  Withholding(const Withholding&) = delete;
  Withholding& operator=(const Withholding&) = delete;
};

/// bind() that gives sockets for datagrams a receive buffer of 4 MiB, or what net.core.rmem_max
/// allows. All participants answer a new one at once, each with a datagram for every endpoint, and
/// what a full buffer drops is repeated a second later.
int bind(int socket, const sockaddr* address, socklen_t address_size) noexcept;

/// Has the loaded libraries whose file names begin so call these functions; returns how many do.
int replace_waits(const char* prefix) noexcept;

/// The same for Fast DDS of all versions; to be called once it is loaded, so after rcl_init().
void replace_waits() noexcept;

}  // namespace play_launch::fastdds

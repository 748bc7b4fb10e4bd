#include "base/core_limit.hpp"

#include <sys/resource.h>

#include <algorithm>
#include <cerrno>

namespace play_launch {

void set_core_dumps(bool dumps) noexcept {
  // A limit of 0 does not hold where the kernel hands cores to a program (kernel.core_pattern
  // begins with "|", as on Ubuntu and Fedora); there 1 means none. Files of less than a page are
  // not written at all.
  constexpr rlim_t kNone = 1;
  const int error = errno;
  rlimit limit{};
  if (::getrlimit(RLIMIT_CORE, &limit) == 0) {
    limit.rlim_cur = dumps ? limit.rlim_max : kNone;
    // Raising a hard limit of 0 needs CAP_SYS_RESOURCE.
    limit.rlim_max = std::max(limit.rlim_max, limit.rlim_cur);
    ::setrlimit(RLIMIT_CORE, &limit);
  }
  errno = error;
}

}  // namespace play_launch

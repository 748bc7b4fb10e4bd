#pragma once

namespace play_launch {

/// The calling process, and what it starts from now on, dumps no core when it dies of a signal; or,
/// with `dumps`, cores of any size that the hard limit of RLIMIT_CORE allows. Ignores errors when
/// that cannot be set. Async-signal-safe, keeps errno.
void set_core_dumps(bool dumps) noexcept;

}  // namespace play_launch

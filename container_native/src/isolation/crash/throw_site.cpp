#include "isolation/crash/throw_site.hpp"

#include <cxxabi.h>
#include <execinfo.h>

#include <algorithm>
#include <cstdlib>

#include "base/next_function.hpp"
#include "isolation/record/child_record.hpp"

namespace play_launch::isolation {
namespace {

const NextFunction<"__cxa_throw", void(void*, std::type_info*, void (*)(void*))> next_throw;

struct Site {
  const void* exception = nullptr;
  std::array<void*, CrashReport::kMaxFrames + 1> frames{};
  int count = 0;
};

thread_local constinit Site last_site;

void note_site(const void* exception) noexcept {
  last_site.exception = exception;
  last_site.count = ::backtrace(last_site.frames.data(), static_cast<int>(last_site.frames.size()));
}

}  // namespace

void prepare_throw_sites() noexcept {
  void* frame = nullptr;
  ::backtrace(&frame, 1);  // loads what it needs
}

std::uint32_t throw_site(const void* exception,
                         std::array<std::uintptr_t, CrashReport::kMaxFrames>& frames) noexcept {
  if (exception == nullptr || last_site.exception != exception) {
    return 0;
  }
  // The first frame is the one that noted them.
  const std::size_t count = static_cast<std::size_t>(std::max(last_site.count - 1, 0));
  for (std::size_t i = 0; i < count; ++i) {
    frames[i] = reinterpret_cast<std::uintptr_t>(last_site.frames[i + 1]);
  }
  return static_cast<std::uint32_t>(count);
}

}  // namespace play_launch::isolation

namespace __cxxabiv1 {

extern "C" [[noreturn, gnu::visibility("default")]] void __cxa_throw(void* exception,
                                                                     std::type_info* type,
                                                                     void (*destroy)(void*)) {
  namespace isolation = play_launch::isolation;
  if (isolation::current_child() != nullptr) {
    isolation::note_site(exception);
  }
  isolation::next_throw.get()(exception, type, destroy);
  std::abort();
}

}  // namespace __cxxabiv1

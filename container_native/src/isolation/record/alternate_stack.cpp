#include "isolation/record/alternate_stack.hpp"

#include <signal.h>
#include <sys/mman.h>

#include <utility>

namespace play_launch::isolation {
namespace {

// The kernel alone stores up to 11 KiB of vector registers; the unwinder needs a few more.
constexpr std::size_t kSize = 128 * 1024;
constexpr std::size_t kGuard = 64 * 1024;  // the largest page

void* bottom_of(void* mapping) { return static_cast<char*>(mapping) + kGuard; }

}  // namespace

AlternateStack::AlternateStack() noexcept {
  void* const mapping = ::mmap(nullptr, kGuard + kSize, PROT_NONE,
                               MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (mapping == MAP_FAILED) {
    return;
  }
  if (::mprotect(bottom_of(mapping), kSize, PROT_READ | PROT_WRITE) != 0) {
    give_back(mapping);
    return;
  }
  mapping_ = mapping;
}

AlternateStack::~AlternateStack() { give_back(mapping_); }

void AlternateStack::use() const noexcept {
  stack_t stack{};
  stack.ss_sp = bottom_of(mapping_);
  stack.ss_size = kSize;
  ::sigaltstack(&stack, nullptr);
}

void AlternateStack::stop_using() noexcept {
  stack_t stack{};
  stack.ss_flags = SS_DISABLE;
  ::sigaltstack(&stack, nullptr);
}

void* AlternateStack::release() noexcept { return std::exchange(mapping_, nullptr); }

void AlternateStack::give_back(void* released) noexcept {
  if (released != nullptr) {
    ::munmap(released, kGuard + kSize);
  }
}

}  // namespace play_launch::isolation

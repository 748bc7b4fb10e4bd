#include "isolation/record/child_record.hpp"

#include <unistd.h>

#include <array>
#include <atomic>

namespace play_launch::isolation {
namespace {

// Readers are children that look for themselves: an entry that is theirs lasts as long as they do.
// Others they only compare by pid, which no two living processes share, and a dead one gives back
// after it has left the table.
struct Entry {
  std::atomic<bool> taken{false};
  std::atomic<pid_t> pid{0};
  std::atomic<ChildRecord*> record{nullptr};
  std::atomic<bool> expendable{false};
};

std::array<Entry, kMaxChildren> entries;
/// Entries from here on were never used.
std::atomic<std::size_t> used{0};

void use(std::size_t index) {
  std::size_t before = used;
  while (before <= index && !used.compare_exchange_weak(before, index + 1)) {
  }
}

}  // namespace

Registration::Registration(ChildRecord& record) noexcept {
  for (; index_ < kMaxChildren; ++index_) {
    if (!entries[index_].taken.exchange(true)) {
      use(index_);
      entries[index_].record = &record;
      entries[index_].expendable = record.options.expendable;
      record.registered_pid = &entries[index_].pid;
      return;
    }
  }
}

Registration::~Registration() {
  if (index_ < kMaxChildren) {
    entries[index_].pid = 0;
    entries[index_].record = nullptr;
    entries[index_].taken = false;
  }
}

std::size_t living_children(std::array<pid_t, kMaxChildren>& pids) noexcept {
  std::size_t count = 0;
  const std::size_t end = used;
  for (std::size_t i = 0; i < end; ++i) {
    const pid_t pid = entries[i].pid;
    if (pid != 0 && !entries[i].expendable) {
      pids[count++] = pid;
    }
  }
  return count;
}

ChildRecord* current_child() noexcept {
  const pid_t self = ::getpid();
  const std::size_t end = used;
  for (std::size_t i = 0; i < end; ++i) {
    if (entries[i].pid == self) {
      return entries[i].record;
    }
  }
  return nullptr;
}

}  // namespace play_launch::isolation

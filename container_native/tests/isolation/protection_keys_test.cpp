// What children with protection keys can do to one another's private memory. Needs them: without,
// it reports that and checks only that nothing is broken.

#include "isolation/memory/protection_keys.hpp"

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/wait.h>

#include <csignal>
#include <cstring>
#include <thread>
#include <vector>

#include "harness.hpp"
#include "isolation/memory/private_memory.hpp"

namespace {

using namespace isolation_test;

/// Private memory with a key of its own, and something in it.
struct Domain {
  int key = new_protection_key();
  PrivateMemory::Owner memory = PrivateMemory::create(key, PrivateMemory::kMinimalReserve);
  int* const value = new (memory->allocate(sizeof(int))) int(42);

  ChildOptions options() const {
    ChildOptions options;
    options.key_rights = rights_of_owner(key);
    options.private_memory = memory.get();
    return options;
  }
};

Domain* mine = nullptr;
Domain* other = nullptr;

void write_to(int* place) { *static_cast<volatile int*>(place) = 666; }

/// In a child with the domain `mine`, with nothing to hold it back.
Outcome& tried(Outcome& outcome, const std::function<void()>& what) {
  run(
      outcome,
      [&](Program&) {
        *mine->value += 1;
        what();
        return 0;
      },
      mine->options());
  CHECK(*other->value == 42);
  return outcome;
}

void dies_of(const char* name, const std::function<void()>& what) {
  Outcome outcome;
  tried(outcome, what);
  std::printf("%s: %s\n", name, outcome.text().c_str());
  CHECK(outcome.end.signal == SIGSEGV);
  CHECK(outcome.slot.report.code == SEGV_PKUERR);
  CHECK(outcome.slot.report.protection_key == other->key);
  CHECK(other->memory->contains(outcome.slot.report.fault_address));
  CHECK(outcome.slot.report.frame_count > 1);
  CHECK(!outcome.slot.report.inside);
}

void lives(const std::function<void()>& what) {
  Outcome outcome;
  tried(outcome, what);
  if (!outcome.end.clean()) {
    std::printf("%s\n%s", outcome.text().c_str(), joined(outcome.slot).c_str());
  }
  CHECK(outcome.end.clean());
}

void on_signal(void (*handler)(int)) {
  struct sigaction action{};
  action.sa_handler = handler;
  CHECK(::sigaction(SIGUSR2, &action, nullptr) == 0);
  std::raise(SIGUSR2);
}

int open_zeros() { return ::open("/dev/zero", O_RDONLY | O_CLOEXEC); }

void strays_are_caught() {
  dies_of("write", [] { write_to(other->value); });
  dies_of("memcpy", [] {
    const int junk = 1;
    std::memcpy(other->value, &junk, sizeof junk);
  });
  dies_of("deallocate", [] { other->memory->deallocate(other->value, sizeof(int)); });
  dies_of("allocate", [] { static_cast<void>(other->memory->allocate(sizeof(int))); });
  dies_of("thread", [] { std::thread([] { write_to(other->value); }).join(); });
  dies_of("read", [] { static_cast<void>(!::read(open_zeros(), other->value, sizeof(int))); });
  dies_of("pread", [] { static_cast<void>(!::pread(open_zeros(), other->value, sizeof(int), 0)); });
  dies_of("recv", [] {
    int ends[2] = {-1, -1};
    CHECK(::socketpair(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0, ends) == 0);
    CHECK(::send(ends[0], "junk", sizeof(int), 0) == sizeof(int));
    static_cast<void>(!::recv(ends[1], other->value, sizeof(int), 0));
  });
  dies_of("signal handler", [] { on_signal([](int) { write_to(other->value); }); });
}

void what_is_right_goes_on() {
  lives([] {
    CHECK(*other->value == 42);
    auto* const place = static_cast<int*>(mine->memory->allocate(sizeof(int)));
    write_to(place);
    mine->memory->deallocate(place, sizeof(int));
  });
  lives([] { std::thread([] { *mine->value += 1; }).join(); });
  // Handlers begin without the right to do so.
  lives([] {
    on_signal([](int) { *mine->value = 7 + *other->value; });
    CHECK(*mine->value == 49);
  });
  lives([] {
    // A process of its own: it affects no other.
    const pid_t pid = ::fork();
    if (pid == 0) {
      *mine->value = 3;
      ::_exit(0);
    }
    int status = 0;
    CHECK(::waitpid(pid, &status, 0) == pid && status == 0);
    CHECK(*mine->value != 3);
  });
  lives([] {
    const int zeros = open_zeros();
    CHECK(::read(zeros, const_cast<char*>("constant"), sizeof(int)) < 0 && errno == EFAULT);
    CHECK(::read(zeros, mine->value, sizeof(int)) == sizeof(int) && *mine->value == 0);
    *mine->value = 5;
    on_signal([](int) {
      const int in_handler = open_zeros();
      CHECK(::read(in_handler, mine->value, sizeof(int)) == sizeof(int));
      ::close(in_handler);
    });
    CHECK(*mine->value == 0);
    ::close(zeros);
  });
}

/// A child that gets signals all the time works in its memory all the same.
void handlers_do_not_change_rights() {
  Outcome outcome;
  run(
      outcome,
      [](Program&) {
        struct sigaction action{};
        action.sa_handler = [](int) { *mine->value += 1; };
        CHECK(::sigaction(SIGUSR2, &action, nullptr) == 0);
        const pid_t pid = ::getpid();
        std::thread sender([pid] {
          for (int i = 0; i < 200; ++i) {
            ::kill(pid, SIGUSR2);
            std::this_thread::yield();
          }
        });
        std::pmr::vector<int> numbers(mine->memory.get());
        for (int i = 0; i < 20'000; ++i) {
          numbers.push_back(i);
        }
        sender.join();
        return 0;
      },
      mine->options());
  CHECK(outcome.end.clean());
}

/// The key can be reused: no memory of the dead node has it.
void keys_are_used_again() {
  const int key = new_protection_key();
  CHECK(key > 0);
  for (int i = 0; i < 50; ++i) {
    auto memory = PrivateMemory::create(key, PrivateMemory::kMinimalReserve);
    auto* const value = new (memory->allocate(sizeof(int))) int(i);
    if (i % 2 == 0) {
      PrivateMemory::keep(std::move(memory));
      Outcome outcome;
      tried(outcome, [value] { write_to(value); });  // it is ordinary memory by now
      CHECK(outcome.end.clean() && *value == 666);
    }
  }
}

}  // namespace

int main() {
  std::setvbuf(stdout, nullptr, _IOLBF, 0);
  allow_all_keys();
  prepare_crash_handling();
  if (!has_protection_keys()) {
    CHECK(new_protection_key() == -1);
    std::puts("no protection keys here: the rest is not tried");
    return 0;
  }
  const Domain one;
  const Domain two;
  mine = const_cast<Domain*>(&one);
  other = const_cast<Domain*>(&two);
  CHECK(one.key > 0 && two.key > 0 && one.key != two.key);
  strays_are_caught();
  what_is_right_goes_on();
  handlers_do_not_change_rights();
  keys_are_used_again();
}

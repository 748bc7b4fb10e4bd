// Private memory as a memory resource, and which domain gets which key: all that needs no
// protection keys.

#include "isolation/memory/private_memory.hpp"

#include <sys/mman.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cstring>
#include <fstream>
#include <map>
#include <play_launch/private_memory.hpp>
#include <random>
#include <set>
#include <string>
#include <thread>
#include <unordered_map>
#include <vector>

#include "harness.hpp"
#include "isolation/memory/protection_keys.hpp"

namespace {

using namespace isolation_test;
using play_launch::private_memory;
using play_launch::PrivateAllocator;

constexpr std::size_t kSmall = PrivateMemory::kMinimalReserve;

std::uintptr_t number(const void* place) { return reinterpret_cast<std::uintptr_t>(place); }

bool is_in_memory(char* page) {
  unsigned char answer = 0;
  CHECK(::mincore(page, 4096, &answer) == 0);
  return (answer & 1) != 0;
}

void gives_what_is_asked_for() {
  const auto memory = PrivateMemory::create(kCommonKey, kSmall);
  for (std::size_t alignment = 1; alignment <= PrivateMemory::kMaxAlignment; alignment *= 2) {
    for (const std::size_t size : {std::size_t{0}, std::size_t{1}, std::size_t{100},
                                   std::size_t{5000}, std::size_t{70'000}}) {
      void* const place = memory->allocate(size, alignment);
      CHECK(number(place) % alignment == 0);
      CHECK(memory->contains(number(place)));
      std::memset(place, 0x5a, size);
      memory->deallocate(place, size, alignment);
    }
  }
  CHECK_THROWS(memory->allocate(1, PrivateMemory::kMaxAlignment * 2), std::bad_alloc);
  CHECK_THROWS(memory->allocate(std::size_t{1} << 62, 8), std::bad_alloc);
  CHECK(!memory->contains(number(&memory)));
  CHECK(!memory->contains(number(memory.get()) - 1));
  CHECK(!memory->contains(number(memory.get()) + kSmall));
}

/// Pieces of all sizes keep what was written into them.
void keeps_pieces_apart() {
  const auto memory = PrivateMemory::create(kCommonKey, kSmall);
  std::mt19937 random(1);
  struct Piece {
    char* begin;
    std::size_t size;
    char content;
  };
  std::vector<Piece> pieces;
  for (int step = 0; step < 20'000; ++step) {
    if (pieces.size() < 100 && random() % 2 == 0) {
      const std::size_t size = std::size_t{1} << (random() % 15);
      const Piece piece{static_cast<char*>(memory->allocate(size)), size,
                        static_cast<char>(random())};
      std::memset(piece.begin, piece.content, size);
      pieces.push_back(piece);
    } else if (!pieces.empty()) {
      const std::size_t which = random() % pieces.size();
      const Piece piece = std::exchange(pieces[which], pieces.back());
      pieces.pop_back();
      for (std::size_t i = 0; i < piece.size; ++i) {
        CHECK(piece.begin[i] == piece.content);
      }
      memory->deallocate(piece.begin, piece.size);
    }
  }
}

/// When all is used there is an exception, and what is given back is there again.
void is_exhausted_and_used_again() {
  const auto memory = PrivateMemory::create(kCommonKey, kSmall);
  constexpr std::size_t kSize = 100'000;
  std::size_t most = 0;
  for (int round = 0; round < 20; ++round) {
    std::vector<void*> pieces;
    CHECK_THROWS(
        [&] {
          while (true) {
            pieces.push_back(memory->allocate(kSize));
          }
        }(),
        std::bad_alloc);
    CHECK(pieces.size() > kSmall / kSize / 2);
    CHECK(round == 0 || pieces.size() == most);
    most = pieces.size();
    for (void* const piece : pieces) {
      memory->deallocate(piece, kSize);
    }
  }
}

void gives_large_pieces_back_to_the_kernel() {
  const auto memory = PrivateMemory::create(kCommonKey, kSmall);
  constexpr std::size_t kSize = 4 << 20;
  auto* const piece = static_cast<char*>(memory->allocate(kSize, 4096));
  std::memset(piece, 1, kSize);
  CHECK(is_in_memory(piece + kSize / 2));
  memory->deallocate(piece, kSize, 4096);
  CHECK(!is_in_memory(piece + kSize / 2));
}

/// Bytes.
std::size_t used_addresses() {
  std::size_t pages = 0;
  CHECK(std::ifstream("/proc/self/statm") >> pages);
  return pages * static_cast<std::size_t>(::sysconf(_SC_PAGESIZE));
}

void takes_what_addresses_there_are() {
  rlimit before{};
  CHECK(::getrlimit(RLIMIT_AS, &before) == 0);
  rlimit limit = before;
  limit.rlim_cur = used_addresses() + (std::size_t{1} << 30);
  CHECK(::setrlimit(RLIMIT_AS, &limit) == 0);
  const auto memory = PrivateMemory::create(kCommonKey);
  CHECK(memory != nullptr);
  memory->deallocate(memory->allocate(1000), 1000);
  limit.rlim_cur = used_addresses();
  CHECK(::setrlimit(RLIMIT_AS, &limit) == 0);
  const bool none = PrivateMemory::create(kCommonKey) == nullptr;
  CHECK(::setrlimit(RLIMIT_AS, &before) == 0);
  CHECK(none);
}

void serves_threads() {
  const auto memory = PrivateMemory::create(kCommonKey);
  std::vector<std::thread> threads;
  for (int i = 0; i < 4; ++i) {
    threads.emplace_back([&memory, i] {
      std::pmr::map<int, std::pmr::string> map(memory.get());
      for (int step = 0; step < 5000; ++step) {
        map[step % 50] = std::to_string(i) + std::string(static_cast<std::size_t>(step % 300), 'x');
        if (step % 7 == 0) {
          map.erase(step % 50);
        }
      }
      for (const auto& [key, text] : map) {
        CHECK(text.front() == '0' + i);
      }
    });
  }
  for (std::thread& thread : threads) {
    thread.join();
  }
}

/// Where a thread died with the lock, in the middle of anything.
void can_be_cleaned_up() {
  const auto memory = PrivateMemory::create(kCommonKey, kSmall);
  auto* const left = new (memory->allocate(sizeof(std::pmr::vector<int>)))
      std::pmr::vector<int>({1, 2, 3}, memory.get());
  Outcome outcome;
  run(outcome, [&](Program&) {
    std::thread([&memory] {
      while (true) {
        memory->deallocate(memory->allocate(100), 100);
      }
    }).detach();
    for (int i = 0; i < 1000; ++i) {
      memory->deallocate(memory->allocate(100), 100);
    }
    ::kill(::getpid(), SIGKILL);
    return 0;
  });
  CHECK(outcome.end.signal == SIGKILL);
  memory->begin_cleanup();
  left->push_back(4);  // as a destructor might
  CHECK(*left == (std::pmr::vector<int>{1, 2, 3, 4}));
  left->~vector();
}

void a_child_finds_its_own() {
  const auto memory = PrivateMemory::create(kCommonKey, kSmall);
  CHECK(private_memory() == std::pmr::new_delete_resource());
  ChildOptions options;
  options.private_memory = memory.get();
  Outcome with;
  run(
      with,
      [&](Program&) {
        CHECK(private_memory() == memory.get());
        std::thread([&] { CHECK(private_memory() == memory.get()); }).join();
        std::map<int, std::string, std::less<>, PrivateAllocator<std::pair<const int, std::string>>>
            map;
        map[3] = "three";
        CHECK(memory->contains(number(&map[3])));
        std::vector<int, PrivateAllocator<int>> numbers(100, 7);
        CHECK(memory->contains(number(numbers.data())));
        return 0;
      },
      options);
  CHECK(with.end.clean());
  Outcome without;
  run(without, [](Program&) {
    CHECK(private_memory() == std::pmr::new_delete_resource());
    return 0;
  });
  CHECK(without.end.clean());
}

void the_allocator_is_one() {
  std::vector<int, PrivateAllocator<int>> one{1, 2, 3};
  const auto copy = one;
  CHECK(copy == one && copy.get_allocator() == one.get_allocator());
  std::unordered_map<std::string, int, std::hash<std::string>, std::equal_to<>,
                     PrivateAllocator<std::pair<const std::string, int>>>
      map{{"a", 1}};
  map["b"] = 2;
  CHECK(map.size() == 2);
  CHECK_THROWS(PrivateAllocator<int>().allocate(~std::size_t{0} / 2), std::bad_array_new_length);
}

/// As many keys as `more` gives are held by one each, then the least held is shared.
void keys_are_shared_evenly() {
  KeyTable table;
  int given = 0;
  const auto more = [&given] { return given < 3 ? ++given : -1; };
  std::multiset<int> taken;
  for (int i = 0; i < 9; ++i) {
    taken.insert(table.take(more, false));
    CHECK(taken.count(*taken.begin()) <= static_cast<std::size_t>(i / 3 + 1));
  }
  for (int key = 1; key <= 3; ++key) {
    CHECK(taken.count(key) == 3 && table.holders(key) == 3);
  }
  CHECK(table.take(more, true) == -1);
  table.give_back(2);
  CHECK(table.take(more, true) == -1);  // two others have it still
  CHECK(table.take(more, false) == 2);
  for (int i = 0; i < 3; ++i) {
    table.give_back(2);
  }
  CHECK(table.take(more, true) == 2);
  CHECK(KeyTable().take([] { return -1; }, false) == -1);
}

void rights_are_what_they_say() {
  for (int own = 1; own < kProtectionKeys; ++own) {
    const KeyRights rights = rights_of_owner(own);
    for (int key = 0; key < kProtectionKeys; ++key) {
      CHECK(is_allowed(rights, key, false));
      CHECK(is_allowed(rights, key, true) == (key == kCommonKey || key == own));
    }
  }
  CHECK(!is_allowed(0x55555554, 1, false) && is_allowed(0x55555554, 0, true));
}

}  // namespace

int main() {
  prepare_crash_handling();
  gives_what_is_asked_for();
  keeps_pieces_apart();
  is_exhausted_and_used_again();
  gives_large_pieces_back_to_the_kernel();
  takes_what_addresses_there_are();
  serves_threads();
  can_be_cleaned_up();
  a_child_finds_its_own();
  the_allocator_is_one();
  keys_are_shared_evenly();
  rights_are_what_they_say();
}

// Looking names up ends in time, however long the tables of symbols are.

#include "isolation/crash/symbolise.hpp"

#include <elf.h>
#include <fcntl.h>
#include <link.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>

#include "base/elf.hpp"
#include "base/unique_fd.hpp"
#include "harness.hpp"

extern "C" void play_launch_test_exported();
void play_launch_test_exported() { __asm__ volatile("nop"); }

namespace {

using namespace isolation_test;
using play_launch::FileSymbols;
using Clock = std::chrono::steady_clock;
using std::chrono_literals::operator""ms;
using std::chrono_literals::operator""us;

[[gnu::noinline]] void unexported() { __asm__ volatile("nop; nop"); }

void test_no_names_after_the_end() {
  CrashSlot slot;
  slot.thread = 1;
  slot.report.frames[0] = reinterpret_cast<std::uintptr_t>(&unexported);
  slot.report.frames[1] = reinterpret_cast<std::uintptr_t>(&play_launch_test_exported) + 1;
  slot.report.frame_count = 2;
  const std::string late = joined(slot, Clock::now());
  CHECK(contains(late, "#0 isolation_symbolise_test+0x"));
  CHECK(contains(late, "#1 isolation_symbolise_test+0x"));
  // That these have none is not remembered; their names are.
  const std::string named = joined(slot);
  CHECK(contains(named, "unexported()+0x0 (isolation_symbolise_test+0x"));
  CHECK(contains(named, "play_launch_test_exported+0x1 (isolation_symbolise_test+0x"));
  CHECK(joined(slot, Clock::now()) == named);
}

/// A file of nothing but symbols, of which the last one is a function.
class LongTable {
 public:
  static constexpr std::uint64_t kCount = 3'000'000;

  LongTable() {
    const play_launch::UniqueFd file(::mkstemp(path_.data()));
    CHECK(file);
    constexpr std::uint64_t kTable = 4096;
    constexpr std::uint64_t kNames = kTable + kCount * sizeof(ElfW(Sym));
    ElfW(Ehdr) header{};
    std::copy_n(ELFMAG, SELFMAG, header.e_ident);
    header.e_shoff = sizeof header;
    header.e_shnum = 2;
    std::array<ElfW(Shdr), 2> sections{};
    sections[0].sh_type = SHT_SYMTAB;
    sections[0].sh_offset = kTable;
    sections[0].sh_size = kNames - kTable;
    sections[0].sh_link = 1;
    sections[1].sh_offset = kNames;
    sections[1].sh_size = sizeof "last";
    ElfW(Sym) last{};
    last.st_info = ELF64_ST_INFO(STB_LOCAL, STT_FUNC);
    last.st_shndx = 1;
    last.st_value = 0x1000;
    last.st_size = 0x10;
    write(file.get(), &header, sizeof header, 0);
    write(file.get(), sections.data(), sizeof sections, sizeof header);
    write(file.get(), &last, sizeof last, kNames - sizeof last);
    write(file.get(), "last", sizeof "last", kNames);
  }
  ~LongTable() { ::unlink(path_.c_str()); }
  LongTable(const LongTable&) = delete;
  LongTable& operator=(const LongTable&) = delete;

  const std::string& path() const { return path_; }

 private:
  static void write(int file, const void* data, std::size_t size, std::uint64_t at) {
    CHECK(::pwrite(file, data, size, static_cast<off_t>(at)) == static_cast<ssize_t>(size));
  }

  std::string path_ = "/tmp/play_launch_symbols_XXXXXX";
};

void test_a_look_up_ends_amid_a_table() {
  const LongTable table;
  const FileSymbols symbols(table.path());
  // No machine reads that many symbols in so short a time.
  CHECK(!symbols.function_at(0x1004, Clock::now() + 100us));
  const auto found = symbols.function_at(0x1004);
  CHECK(found && found->name == "last" && found->offset == 4);
}

void test_many_deaths_share_the_time() {
  LookUpTime time;
  Clock::time_point now = Clock::now();
  CHECK(time.begin(now) == now + 50ms);
  time.end(now += 20ms);
  CHECK(time.begin(now) == now + 30ms);
  time.end(now += 70ms);  // more than it may
  CHECK(time.begin(now) == now);
  time.end(now);
  now += 100ms;
  CHECK(time.begin(now) == now + 10ms);
  time.end(now);
  now += 1000ms;
  CHECK(time.begin(now) == now + 50ms);
}

}  // namespace

int main() {
  prepare_crash_handling();
  test_no_names_after_the_end();
  test_a_look_up_ends_amid_a_table();
  test_many_deaths_share_the_time();
  return 0;
}

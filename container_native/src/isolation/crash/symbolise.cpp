#include "isolation/crash/symbolise.hpp"

#include <signal.h>
#include <string.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <map>
#include <mutex>
#include <optional>
#include <utility>

#include "base/elf.hpp"
#include "isolation/crash/crash_handler.hpp"
#include "isolation/record/own_signals.hpp"

namespace play_launch::isolation {
namespace {

std::string hex(std::uintptr_t value) {
  std::array<char, 2 + 16 + 1> text{};
  std::snprintf(text.data(), text.size(), "0x%lx", static_cast<unsigned long>(value));
  return text.data();
}

std::string base_name(const std::string& path) { return path.substr(path.rfind('/') + 1); }

/// What was looked up before: a node that crashes again mostly does so where it did. Libraries stay
/// loaded, so that an address keeps its meaning.
class Memory {
 public:
  struct Description {
    std::string text;
    bool is_final = false;  // it will not be another one later
  };
  /// In the tables that are in memory, or in those that are in files.
  Description describe(std::uintptr_t address, bool is_return_address, bool in_files,
                       LookUpEnd end);

 private:
  static constexpr std::size_t kMostFrames = 4096;

  std::mutex mutex_;  // guards what follows
  std::map<std::string, FileSymbols> files_;
  std::map<std::pair<std::uintptr_t, bool>, std::string> frames_;

  Description look_up(std::uintptr_t address, bool is_return_address, bool in_files, LookUpEnd end);
};

Memory::Description Memory::describe(std::uintptr_t address, bool is_return_address, bool in_files,
                                     LookUpEnd end) {
  const std::lock_guard lock(mutex_);
  const auto known = frames_.find({address, is_return_address});
  if (known != frames_.end()) {
    return {known->second, true};
  }
  const Description found = look_up(address, is_return_address, in_files, end);
  if (found.is_final && frames_.size() < kMostFrames) {
    frames_.emplace(std::pair(address, is_return_address), found.text);
  }
  return found;
}

Memory::Description Memory::look_up(std::uintptr_t address, bool is_return_address, bool in_files,
                                    LookUpEnd end) {
  // A return address may belong to what follows the call's function.
  const std::uintptr_t inside = is_return_address ? address - 1 : address;
  const link_map* const library = library_at(inside);
  if (library == nullptr) {
    return {hex(address)};  // it may belong to one that is loaded later
  }
  const std::string path = path_of(*library);
  const std::string where = base_name(path) + "+" + hex(address - library->l_addr);
  std::string function;
  std::uintptr_t offset = 0;
  // The library's tables are memory of all nodes, and its file may shrink while it is read.
  const bool is_read = survive([&] {
    if (!in_files) {
      const DynamicSymbols::Function exported = DynamicSymbols(*library).function_at(inside, end);
      if (!exported.name.empty()) {
        function = demangled(exported.name.data());  // ends in a null byte, in the library's table
        offset = address - exported.begin;
      }
      return;
    }
    const FileSymbols& symbols = files_.try_emplace(path, path).first->second;
    if (const auto found = symbols.function_at(inside - library->l_addr, end)) {
      function = demangled(found->name.c_str());
      offset = found->offset + (address - inside);
    }
  });
  if (!is_read || function.empty()) {
    return {where, in_files && is_read && LookUpTime::Clock::now() < end};
  }
  return {function + "+" + hex(offset) + " (" + where + ")", true};
}

struct CodeText {
  int signal;
  int code;
  const char* text;
};

/// SYS_SECCOMP, which not every C library names.
constexpr int kBySeccomp = 1;

constexpr const char* kCpuLimitExceeded = "its limit of processor time is exceeded";

/// What the kernel says about a fault, beside its address.
constexpr std::array kCodes{
    CodeText{SIGSEGV, SEGV_MAPERR, "no memory"},
    CodeText{SIGSEGV, SEGV_ACCERR, "access not allowed"},
    CodeText{SIGBUS, BUS_ADRALN, "misaligned access"},
    CodeText{SIGBUS, BUS_ADRERR, "nothing behind the mapping"},
    CodeText{SIGBUS, BUS_OBJERR, "hardware error"},
    CodeText{SIGFPE, FPE_INTDIV, "integer division by zero"},
    CodeText{SIGFPE, FPE_INTOVF, "integer overflow"},
    CodeText{SIGFPE, FPE_FLTDIV, "floating-point division by zero"},
    CodeText{SIGFPE, FPE_FLTINV, "invalid floating-point operation"},
    CodeText{SIGILL, ILL_ILLOPC, "illegal instruction"},
    CodeText{SIGILL, ILL_ILLOPN, "illegal instruction"},
    CodeText{SIGTRAP, TRAP_BRKPT, "breakpoint"},
    CodeText{SIGSYS, kBySeccomp, "system call that is not allowed"},
};

std::string describe_fault(const CrashSlot& slot) {
  const CrashReport& report = slot.report;
  if (report.code == SI_TIMER && slot.stop_signal != 0) {
    return "it did not leave in time after the signal";
  }
  if (report.code == SI_TIMER && report.signal == SIGALRM) {
    return "its limit of time is exceeded";
  }
  if (report.code == SI_TIMER && report.signal == SIGXCPU) {
    return kCpuLimitExceeded;
  }
  if (report.exception_type[0] != '\0') {
    const std::string text = report.exception_text.data();
    return "uncaught exception " + std::string(report.exception_type.data()) +
           (text.empty() ? "" : ": " + text);
  }
  if (report.code <= 0) {
    return report.signal == SIGABRT ? "abort() was called" : "the node sent it to itself";
  }
  if (report.code == SI_KERNEL) {
    switch (report.signal) {
      case SIGSEGV:
        return "access to an address that no memory can have";
      case SIGTRAP:
        return "breakpoint at address " + hex(report.program_counter);
      case SIGXCPU:
        return kCpuLimitExceeded;
      case SIGXFSZ:
        return "its limit of file size is exceeded";
      default:
        break;
    }
  }
  if (report.protection_key != 0) {
    const std::string owner = report.memory_owner.data();
    return (owner.empty()
                ? "access to memory with protection key " + std::to_string(report.protection_key)
                : "write to the private memory of " + owner) +
           " at address " + hex(report.fault_address);
  }
  if (is_jump_to_no_code(report)) {
    return "jump to address " + hex(report.fault_address) + ", where no code is";
  }
  for (const CodeText& known : kCodes) {
    if (known.signal == report.signal && known.code == report.code) {
      return std::string(known.text) + " at address " + hex(report.fault_address);
    }
  }
  return "code " + std::to_string(report.code) + " at address " + hex(report.fault_address);
}

std::string describe_crash(const CrashSlot& slot) {
  return signal_name(slot.report.signal) + " (" + describe_fault(slot) + ") in thread '" +
         slot.report.thread_name.data() + "'";
}

std::string describe_signal(const ChildEnd& end, const CrashSlot& slot) {
  if (slot.thread != 0 && slot.report.signal == end.signal) {
    return describe_crash(slot);
  }
  std::string text = signal_name(end.signal);
  if (slot.thread != 0) {
    text += "; before that " + describe_crash(slot) +
            (slot.phase == ChildPhase::crashed ? ", whose handler did not come to its end" : "");
  } else if (slot.stop_signal == end.signal) {
    text += " (sent by process " + std::to_string(slot.stop_sender) + ")";
  }
  return text;
}

}  // namespace

std::vector<std::string> symbolise(const CrashSlot& slot, LookUpEnd end) {
  std::vector<std::string> lines;
  if (slot.thread == 0) {
    return lines;
  }
  static Memory memory;
  const SurvivalOfReports survival;
  // How the C++ library gets from a throw to the end of the process is of no interest.
  const std::size_t first = slot.report.thrower;
  std::vector<Memory::Description> found(slot.report.frame_count);
  // What takes little time first.
  for (const bool in_files : {false, true}) {
    for (std::size_t i = first; i < found.size(); ++i) {
      if (!found[i].is_final) {
        found[i] = memory.describe(slot.report.frames[i], i > 0, in_files, end);
      }
    }
  }
  for (std::size_t i = first; i < found.size(); ++i) {
    lines.push_back("#" + std::to_string(i - first) + " " + found[i].text);
  }
  return lines;
}

LookUpTime::Clock::time_point LookUpTime::begin(Clock::time_point now) {
  left_ = std::min(kMost, left_ + (now - since_) / 10);
  since_ = now;
  return now + left_;
}

void LookUpTime::end(Clock::time_point now) {
  left_ -= std::min(left_, now - since_);
  since_ = now;
}

std::vector<std::string> modules_of(const CrashSlot& slot) {
  std::vector<std::string> lines;
  if (slot.thread == 0) {
    return lines;
  }
  const SurvivalOfReports survival;
  std::vector<const link_map*> seen;
  for (std::size_t i = slot.report.thrower; i < slot.report.frame_count; ++i) {
    const std::uintptr_t code = slot.report.frames[i] - (i > 0 ? 1 : 0);
    const link_map* const library = library_at(code);
    if (library == nullptr || std::ranges::find(seen, library) != seen.end()) {
      continue;
    }
    seen.push_back(library);
    const std::string path = path_of(*library);
    std::string id;
    survive([&] { id = build_id_of(*library, code); });
    lines.push_back(base_name(path) + " " + (id.empty() ? "-" : id) + " " + path);
  }
  return lines;
}

std::string signal_name(int signal) {
  const char* const name = ::sigabbrev_np(signal);
  return name != nullptr ? std::string("SIG") + name : "signal " + std::to_string(signal);
}

std::string describe_end(const ChildEnd& end, const CrashSlot& slot) {
  if (end.error != 0) {
    return std::string("no process: ") + ::strerror(end.error);
  }
  std::string text;
  if (end.signal != 0) {
    text = describe_signal(end, slot);
  } else {
    text = "exit status " + std::to_string(end.exit_code);
    if (slot.report.kept_out) {
      text = "the kernel did not let it into its control group, which is required";
    } else if (slot.report.end_call != nullptr && slot.report.other_program[0] == '\0') {
      text += std::string(" (") + slot.report.end_call + " was called)";
    }
  }
  if (slot.report.other_program[0] != '\0') {
    text += ": it replaced itself by " + std::string(slot.report.other_program.data()) +
            " (execve), which ends a node";
  }
  if (slot.report.inside) {
    text += "; it died inside the middleware or the allocator, and may hold a lock there";
  }
  if (slot.report.threads_not_parked > 0) {
    text += "; " + std::to_string(slot.report.threads_not_parked) +
            " of its threads could not be stopped in a harmless place";
  }
  return text;
}

}  // namespace play_launch::isolation

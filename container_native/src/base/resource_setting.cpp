#include "base/resource_setting.hpp"

#include <fcntl.h>
#include <linux/capability.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cstdio>
#include <cstring>
#include <stdexcept>

namespace play_launch {

namespace {

using Kind = ResourceSetting::Kind;

struct Form {
  std::string_view name;
  Kind kind;
  std::size_t numbers;
};

constexpr std::string_view kRequiredGroup = "required_cgroup";
constexpr std::array kForms{
    Form{"rlimit", Kind::rlimit, 3},
    Form{"oom_score_adj", Kind::oom_score_adj, 1},
    Form{"io_priority", Kind::io_priority, 1},
    Form{"cpu_affinity", Kind::cpu_affinity, 0},
    Form{"nice", Kind::nice, 1},
    Form{"scheduler", Kind::scheduler, 2},
    Form{"cgroup", Kind::cgroup, 0},
    Form{kRequiredGroup, Kind::cgroup, 0},
};
constexpr std::size_t kMostDigits = 24;
constexpr int kIoPriorityOfProcess = 1;  // IOPRIO_WHO_PROCESS, which the C library does not define

/// The next word, which is taken off the text.
std::string_view take_word(std::string_view& text) {
  const std::size_t end = std::min(text.find(' '), text.size());
  const std::string_view word = text.substr(0, end);
  text.remove_prefix(std::min(end + 1, text.size()));
  return word;
}

template <class Number>
std::optional<Number> number_in(std::string_view word) {
  Number number{};
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), number);
  const bool whole = error == std::errc() && end == word.data() + word.size();
  return whole ? std::optional(number) : std::nullopt;
}

std::optional<std::uint64_t> any_number_in(std::string_view word) {
  if (word.starts_with('-')) {
    const auto number = number_in<std::int64_t>(word);
    return number ? std::optional(static_cast<std::uint64_t>(*number)) : std::nullopt;
  }
  return number_in<std::uint64_t>(word);
}

bool read_cpus(std::string_view text, cpu_set_t& cpus) {
  CPU_ZERO(&cpus);
  while (!text.empty()) {
    const auto cpu = number_in<unsigned>(take_word(text));
    if (!cpu || *cpu >= CPU_SETSIZE) {
      return false;
    }
    CPU_SET(*cpu, &cpus);
  }
  return CPU_COUNT(&cpus) > 0;
}

int result(long value) noexcept { return value == 0 ? 0 : errno; }

int set_limit(int resource, rlim_t soft, rlim_t hard) noexcept {
  const auto which = static_cast<__rlimit_resource_t>(resource);
  const rlimit wanted{soft, hard};
  if (::setrlimit(which, &wanted) == 0) {
    return 0;
  }
  const int error = errno;
  rlimit nearest{};
  if (::getrlimit(which, &nearest) == 0) {
    nearest.rlim_max = std::min(nearest.rlim_max, hard);
    nearest.rlim_cur = std::min(nearest.rlim_max, soft);
    ::setrlimit(which, &nearest);
  }
  return error;
}

/// `text` into the file that is open as `fd`, which is closed.
int write_all(int fd, std::string_view text) noexcept {
  if (fd < 0) {
    return errno;
  }
  const int error = ::write(fd, text.data(), text.size()) < 0 ? errno : 0;
  ::close(fd);
  return error;
}

int write_number(const char* file, std::int64_t number) noexcept {
  std::array<char, kMostDigits> digits{};
  const auto written = std::to_chars(digits.data(), digits.data() + digits.size(), number);
  const auto size = static_cast<std::size_t>(written.ptr - digits.data());
  return write_all(::open(file, O_WRONLY | O_CLOEXEC), {digits.data(), size});
}

/// The calling process, with all its threads; 0 stands for it.
int enter_group(const char* folder) noexcept {
  const int group = ::open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (group < 0) {
    return errno;
  }
  const int error = write_all(::openat(group, "cgroup.procs", O_WRONLY | O_CLOEXEC), "0");
  ::close(group);
  return error;
}

int ask_kernel(const ResourceSetting& setting) noexcept {
  const auto& numbers = setting.numbers;
  switch (setting.kind) {
    case Kind::rlimit:
      return set_limit(static_cast<int>(numbers[0]), numbers[1], numbers[2]);
    case Kind::oom_score_adj:
      return write_number("/proc/self/oom_score_adj", static_cast<std::int64_t>(numbers[0]));
    case Kind::io_priority:
      return result(::syscall(SYS_ioprio_set, kIoPriorityOfProcess, 0, numbers[0]));
    case Kind::cpu_affinity:
      return result(::sched_setaffinity(0, sizeof setting.cpus, &setting.cpus));
    case Kind::nice:
      return result(::setpriority(PRIO_PROCESS, 0, static_cast<int>(numbers[0])));
    case Kind::scheduler: {
      sched_param parameter{};
      parameter.sched_priority = static_cast<int>(numbers[1]);
      return result(::sched_setscheduler(0, static_cast<int>(numbers[0]), &parameter));
    }
    case Kind::cgroup:
      return enter_group(setting.folder.c_str());
  }
  return EINVAL;
}

bool may_lock_any_memory() noexcept {
  rlimit limit{};
  if (::getrlimit(RLIMIT_MEMLOCK, &limit) == 0 && limit.rlim_cur == RLIM_INFINITY) {
    return true;
  }
  __user_cap_header_struct header{_LINUX_CAPABILITY_VERSION_3, 0};
  std::array<__user_cap_data_struct, _LINUX_CAPABILITY_U32S_3> data{};
  return ::syscall(SYS_capget, &header, data.data()) == 0 &&
         (data[0].effective & (1U << CAP_IPC_LOCK)) != 0;
}

}  // namespace

std::optional<ResourceSetting> parse_resource_setting(std::string_view text) {
  const std::string_view name = take_word(text);
  const auto* const form = std::ranges::find(kForms, name, &Form::name);
  if (form == kForms.end()) {
    return std::nullopt;
  }
  ResourceSetting setting;
  setting.kind = form->kind;
  if (form->kind == Kind::cpu_affinity) {
    return read_cpus(text, setting.cpus) ? std::optional(setting) : std::nullopt;
  }
  if (form->kind == Kind::cgroup) {
    setting.folder = text;
    setting.is_required = name == kRequiredGroup;
    return text.starts_with('/') ? std::optional(setting) : std::nullopt;
  }
  for (std::size_t i = 0; i < form->numbers; ++i) {
    const auto number = any_number_in(take_word(text));
    if (!number) {
      return std::nullopt;
    }
    setting.numbers[i] = *number;
  }
  return text.empty() ? std::optional(setting) : std::nullopt;
}

std::vector<ResourceSetting> parse_resource_settings(const std::vector<std::string>& texts) {
  std::vector<ResourceSetting> settings;
  for (const std::string& text : texts) {
    const auto setting = parse_resource_setting(text);
    if (!setting) {
      throw std::invalid_argument("'" + text + "' is no setting of a process");
    }
    settings.push_back(*setting);
  }
  return settings;
}

bool apply_or_complain(const ResourceSetting& setting) noexcept {
  const int kept = errno;
  const int error = ask_kernel(setting);
  errno = kept;
  if (error == 0 || !setting.is_required) {
    return true;
  }
  ::dprintf(STDERR_FILENO, "cannot enter the required control group %s: %s\n",
            setting.folder.c_str(), ::strerrordesc_np(error));
  return false;
}

int lock_memory() noexcept {
  if (!may_lock_any_memory()) {
    return EPERM;
  }
  // In this order: the first call ends what an earlier one said about memory to come.
  if (::mlockall(MCL_CURRENT) != 0 || ::mlockall(MCL_FUTURE | MCL_ONFAULT) != 0) {
    return errno;
  }
  return 0;
}

}  // namespace play_launch

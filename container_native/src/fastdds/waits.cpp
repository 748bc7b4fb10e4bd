#include "fastdds/waits.hpp"

#include <link.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/uio.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <new>
#include <span>
#include <string_view>
#include <utility>

#include "base/next_function.hpp"

namespace play_launch::fastdds {
namespace {

const auto next_timedwait = next_function<"pthread_cond_timedwait">(&pthread_cond_timedwait);
const auto next_unlock = next_function<"pthread_mutex_unlock">(&pthread_mutex_unlock);

timespec after_pause() noexcept {
  constexpr long kPause = 10'000'000;  // ns
  constexpr long kSecond = 1'000'000'000;
  timespec time{};
  ::clock_gettime(CLOCK_MONOTONIC, &time);
  time.tv_nsec += kPause;
  if (time.tv_nsec >= kSecond) {
    time.tv_nsec -= kSecond;
    ++time.tv_sec;
  }
  return time;
}

// The kind of a mutex in the C library (nptl/pthreadP.h): PTHREAD_MUTEX_PSHARED_BIT, with 0 for the
// type of one that is neither recursive nor checked, robust or with priorities. Above is elision.
constexpr int kKinds = 0xff;
constexpr int kShared = 0x80;

/// The last mutex between processes that this thread has taken here, and how often besides. A
/// thread that died with it may have left it to the next one on its stack, so it holds only for the
/// owner.
struct Held {
  const pthread_mutex_t* mutex = nullptr;
  unsigned again = 0;
};
constinit thread_local Held held;

/// A datagram that is to be sent later; its content follows.
struct Datagram {
  Datagram* next;
  int socket;
  int flags;
  socklen_t address_size;
  sockaddr_storage address;
  std::size_t size;
};
constexpr int kMostDatagrams = 1024;

constinit thread_local bool is_withholding = false;
constinit thread_local int withheld_count = 0;
constinit thread_local Datagram* withheld = nullptr;  // the latest one

}  // namespace

int timedwait(pthread_cond_t* condition, pthread_mutex_t* mutex, const timespec* deadline) {
  if (deadline->tv_sec >= 0) {
    return next_timedwait.get()(condition, mutex, deadline);
  }
  // Names its clock, as the variable's own is not known here.
  const timespec time = after_pause();
  return ::pthread_cond_clockwait(condition, mutex, CLOCK_MONOTONIC, &time);
}

int timedlock(pthread_mutex_t* mutex, const timespec* deadline) noexcept {
  if (held.mutex == mutex && mutex->__data.__owner == ::gettid()) {
    ++held.again;
    return 0;
  }
  const int result = ::pthread_mutex_clocklock(mutex, CLOCK_REALTIME, deadline);
  if (result == 0 && (mutex->__data.__kind & kKinds) == kShared) {
    held = {mutex, 0};
  }
  return result;
}

int unlock(pthread_mutex_t* mutex) noexcept {
  if (held.mutex == mutex) [[unlikely]] {
    if (held.again > 0 && mutex->__data.__owner == ::gettid()) {
      --held.again;
      return 0;
    }
    held = {};
  }
  return next_unlock.get()(mutex);
}

ssize_t sendto(int socket, const void* data, std::size_t size, int flags, const sockaddr* address,
               socklen_t address_size) noexcept {
  if (!is_withholding) {
    return ::sendto(socket, data, size, flags, address, address_size);
  }
  iovec part{const_cast<void*>(data), size};
  msghdr message{};
  message.msg_name = const_cast<sockaddr*>(address);
  message.msg_namelen = address_size;
  message.msg_iov = &part;
  message.msg_iovlen = 1;
  return fastdds::sendmsg(socket, &message, flags);
}

ssize_t sendmsg(int socket, const msghdr* message, int flags) noexcept {
  if (!is_withholding || message->msg_name == nullptr ||
      message->msg_namelen > sizeof(sockaddr_storage)) {
    return ::sendmsg(socket, message, flags);
  }
  const std::span parts(message->msg_iov, message->msg_iovlen);
  std::size_t size = 0;
  for (const iovec& part : parts) {
    size += part.iov_len;
  }
  // One without room is lost, as any datagram may be.
  void* const room =
      withheld_count < kMostDatagrams ? std::malloc(sizeof(Datagram) + size) : nullptr;
  if (room != nullptr) {
    ++withheld_count;
    withheld = new (room) Datagram{withheld, socket, flags, message->msg_namelen, {}, size};
    std::memcpy(&withheld->address, message->msg_name, message->msg_namelen);
    auto* place = reinterpret_cast<std::byte*>(withheld + 1);
    for (const iovec& part : parts) {
      std::memcpy(std::exchange(place, place + part.iov_len), part.iov_base, part.iov_len);
    }
  }
  return static_cast<ssize_t>(size);
}

int bind(int socket, const sockaddr* address, socklen_t address_size) noexcept {
  constexpr int kEnough = 4 << 20;
  int type = 0;
  int size = 0;
  socklen_t length = sizeof(int);
  if (::getsockopt(socket, SOL_SOCKET, SO_TYPE, &type, &length) == 0 && type == SOCK_DGRAM &&
      ::getsockopt(socket, SOL_SOCKET, SO_RCVBUF, &size, &length) == 0 && size < kEnough) {
    ::setsockopt(socket, SOL_SOCKET, SO_RCVBUF, &kEnough, sizeof kEnough);
  }
  return ::bind(socket, address, address_size);
}

void withhold_datagrams(bool enabled) noexcept {
  is_withholding = enabled;
  if (enabled) {
    return;
  }
  Datagram* first = nullptr;
  for (Datagram* each = std::exchange(withheld, nullptr); each != nullptr;) {
    first = std::exchange(each, std::exchange(each->next, first));
  }
  withheld_count = 0;
  while (first != nullptr) {
    const auto* const address = reinterpret_cast<const sockaddr*>(&first->address);
    static_cast<void>(::sendto(first->socket, first + 1, first->size, first->flags, address,
                               first->address_size));
    std::free(std::exchange(first, first->next));
  }
}

namespace {

#if defined(__x86_64__)
constexpr std::array<std::uint32_t, 2> kFunction{R_X86_64_JUMP_SLOT, R_X86_64_GLOB_DAT};
#else
constexpr std::array<std::uint32_t, 2> kFunction{R_AARCH64_JUMP_SLOT, R_AARCH64_GLOB_DAT};
#endif

// Of eprosima::fastdds::dds::detail::DataReaderHistory; found when calls are replaced. Versions
// 2.14 and 3.2 name the namespace of its arguments differently.
constexpr std::string_view kRemove =
    "_ZN8eprosima7fastdds3dds6detail17DataReaderHistory17remove_change_subE";
constexpr std::string_view kAtPlace = "CacheChange_tERN9__gnu_cxx17__normal_iterator";
bool is_remove_sample(std::string_view name) noexcept {
  return name.starts_with(kRemove) && name.find(kAtPlace) != std::string_view::npos;
}
constexpr std::string_view kFindInstance =
    "_ZN8eprosima7fastdds3dds6detail17DataReaderHistory8find_key";
std::atomic<bool (*)(void*, void*, void***)> next_remove_sample{nullptr};
std::atomic<bool (*)(void*, const void*, void*)> find_instance{nullptr};

/// Reads what may not be there; false: it is not.
bool read_safely(std::uintptr_t address, void* target, std::size_t size) noexcept {
  const iovec to{target, size};
  const iovec from{reinterpret_cast<void*>(address), size};
  return ::process_vm_readv(::getpid(), &to, 1, &from, 1, 0) == static_cast<ssize_t>(size);
}

/// Takes an element out of the list of samples of a topic without keys; false: where that list is
/// could not be verified.
bool erase(void* history, void** element) {
  // As in versions 2.14 and 3.2 with libstdc++; a list elsewhere does not hold the element.
  constexpr std::array<char, 32> kNoKey{};
  constexpr std::uintptr_t kInstanceInNode = 0x38;
  constexpr std::uintptr_t kListInInstance = 0x20;
  const auto find = find_instance.load();
  std::uintptr_t node = 0;
  std::uintptr_t instance = 0;
  std::array<void**, 2> list{};
  if (find == nullptr || !find(history, kNoKey.data(), &node) ||
      !read_safely(node + kInstanceInNode, &instance, sizeof instance) ||
      !read_safely(instance + kListInInstance, list.data(), sizeof list) ||
      std::less<>()(element, list[0]) || !std::less<>()(element, list[1])) {
    return false;
  }
  std::memmove(element, element + 1,
               static_cast<std::size_t>(list[1] - element - 1) * sizeof *element);
  *reinterpret_cast<void***>(instance + kListInInstance + sizeof list[0]) = list[1] - 1;
  return true;
}

/// See waits.hpp.
bool remove_sample(void* history, void* sample, void*** place) {
  void** const before = *place;
  if (next_remove_sample.load()(history, sample, place)) {
    return true;
  }
  if (*place == before && *before == sample && !erase(history, before)) {
    ++*place;
  }
  return false;
}

/// What stands instead of a function of that name; 0: nothing.
std::uintptr_t replacement(std::string_view name) noexcept {
  if (next_remove_sample.load() != nullptr && is_remove_sample(name)) {
    return reinterpret_cast<std::uintptr_t>(&remove_sample);
  }
  if (name == "pthread_cond_timedwait") {
    return reinterpret_cast<std::uintptr_t>(&timedwait);
  }
  if (name == "pthread_mutex_timedlock") {
    return reinterpret_cast<std::uintptr_t>(&timedlock);
  }
  if (name == "pthread_mutex_unlock") {
    return reinterpret_cast<std::uintptr_t>(&unlock);
  }
  if (name == "sendto") {
    return reinterpret_cast<std::uintptr_t>(&sendto);
  }
  if (name == "sendmsg") {
    return reinterpret_cast<std::uintptr_t>(&sendmsg);
  }
  return name == "bind" ? reinterpret_cast<std::uintptr_t>(&bind) : 0;
}

void note_original(std::string_view name, std::uintptr_t address) noexcept {
  if (address != 0 && is_remove_sample(name)) {
    next_remove_sample = reinterpret_cast<bool (*)(void*, void*, void***)>(address);
  } else if (address != 0 && name.starts_with(kFindInstance)) {
    find_instance = reinterpret_cast<bool (*)(void*, const void*, void*)>(address);
  }
}

bool is_in_read_only_part(const dl_phdr_info& object, std::uintptr_t address) noexcept {
  for (const ElfW(Phdr) & part : std::span(object.dlpi_phdr, object.dlpi_phnum)) {
    if (part.p_type == PT_GNU_RELRO && address - (object.dlpi_addr + part.p_vaddr) < part.p_memsz) {
      return true;
    }
  }
  return false;
}

/// False when the kernel refuses to have it written.
bool replace(const dl_phdr_info& object, std::uintptr_t slot, std::uintptr_t function) noexcept {
  const auto page_size = static_cast<std::uintptr_t>(::sysconf(_SC_PAGESIZE));
  auto* const page = reinterpret_cast<void*>(slot & ~(page_size - 1));
  // Libraries whose calls were bound when they were loaded have their table protected since.
  const bool is_protected = is_in_read_only_part(object, slot);
  if (is_protected && ::mprotect(page, page_size, PROT_READ | PROT_WRITE) != 0) {
    return false;
  }
  // Other threads may be calling through it.
  std::atomic_ref(*reinterpret_cast<std::uintptr_t*>(slot)).store(function);
  if (is_protected) {
    ::mprotect(page, page_size, PROT_READ);
  }
  return true;
}

/// True when any of its calls was replaced.
bool replace_calls(const dl_phdr_info& object, const ElfW(Dyn) * entry) noexcept {
  const ElfW(Sym)* symbols = nullptr;
  const char* names = nullptr;
  std::array<const ElfW(Rela)*, 2> tables{};  // of calls, and of other addresses
  std::array<std::size_t, 2> sizes{};
  for (; entry->d_tag != DT_NULL; ++entry) {
    const std::uintptr_t address = entry->d_un.d_ptr;
    switch (entry->d_tag) {
      case DT_SYMTAB:
        symbols = reinterpret_cast<const ElfW(Sym)*>(address);
        break;
      case DT_STRTAB:
        names = reinterpret_cast<const char*>(address);
        break;
      case DT_JMPREL:
        tables[0] = reinterpret_cast<const ElfW(Rela)*>(address);
        break;
      case DT_PLTRELSZ:
        sizes[0] = entry->d_un.d_val;
        break;
      case DT_RELA:
        tables[1] = reinterpret_cast<const ElfW(Rela)*>(address);
        break;
      case DT_RELASZ:
        sizes[1] = entry->d_un.d_val;
        break;
      default:
        break;
    }
  }
  bool any = false;
  for (std::size_t table = 0; table < tables.size(); ++table) {
    for (const ElfW(Rela) & each : std::span(tables[table], sizes[table] / sizeof(ElfW(Rela)))) {
      if (ELF64_R_TYPE(each.r_info) != kFunction[table]) {
        continue;
      }
      const ElfW(Sym)& symbol = symbols[ELF64_R_SYM(each.r_info)];
      const char* const name = names + symbol.st_name;
      note_original(name, symbol.st_value == 0 ? 0 : object.dlpi_addr + symbol.st_value);
      const std::uintptr_t function = replacement(name);
      any |= function != 0 && replace(object, object.dlpi_addr + each.r_offset, function);
    }
  }
  return any;
}

struct Search {
  std::string_view prefix;
  int replaced = 0;
};

int visit(dl_phdr_info* object, std::size_t, void* argument) noexcept {
  auto& search = *static_cast<Search*>(argument);
  // Nothing here may need the C++ library, which a process that preloads this may lack.
  std::string_view name = object->dlpi_name;
  name.remove_prefix(name.rfind('/') + 1);
  if (!name.starts_with(search.prefix)) {
    return 0;
  }
  for (const ElfW(Phdr) & part : std::span(object->dlpi_phdr, object->dlpi_phnum)) {
    if (part.p_type == PT_DYNAMIC) {
      const auto* const dynamic =
          reinterpret_cast<const ElfW(Dyn)*>(object->dlpi_addr + part.p_vaddr);
      search.replaced += replace_calls(*object, dynamic) ? 1 : 0;
    }
  }
  return 0;
}

}  // namespace

int replace_waits(const char* prefix) noexcept {
  Search search{prefix};
  ::dl_iterate_phdr(visit, &search);
  return search.replaced;
}

void replace_waits() noexcept {
  replace_waits("libfastrtps.so");  // version 2
  replace_waits("libfastdds.so");
}

}  // namespace play_launch::fastdds

// Without a list of our own, which libraries that find the C library's __cxa_thread_atexit_impl()
// before ours (RTLD_DEEPBIND with a C++ library inside) would bypass: the C library exports what
// runs its own list, and the table of keys that debuggers need. Both are private, so both are tried
// out.

#include "isolation/clone/thread_destructors.hpp"

#include <dlfcn.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>

extern "C" int __cxa_thread_atexit_impl(void (*)(void*), void*, void*) noexcept;
extern "C" void* __dso_handle;

namespace play_launch::isolation {
namespace {

using Destructor = void (*)(void*);

void* private_symbol(const char* name) { return ::dlvsym(RTLD_DEFAULT, name, "GLIBC_PRIVATE"); }

/// The C library's table of keys, as it describes it for debuggers.
class KeyTable {
 public:
  bool find() {
    const auto* const keys = description("_thread_db___pthread_keys");
    const auto* const size = description("_thread_db_sizeof_pthread_key_struct");
    const auto* const use = description("_thread_db_pthread_key_struct_seq");
    const auto* const destructor = description("_thread_db_pthread_key_struct_destr");
    table_ = static_cast<const char*>(private_symbol("__pthread_keys"));
    if (keys == nullptr || size == nullptr || use == nullptr || destructor == nullptr ||
        table_ == nullptr) {
      return false;
    }
    size_ = size[0];
    use_ = use[kOffset];
    destructor_ = destructor[kOffset];
    count_ = std::min<pthread_key_t>(keys[kCount], PTHREAD_KEYS_MAX);
    return true;
  }

  pthread_key_t count() const { return count_; }
  bool in_use(pthread_key_t key) const { return (read<std::uintptr_t>(key, use_) & 1) != 0; }
  Destructor destructor(pthread_key_t key) const { return read<Destructor>(key, destructor_); }

 private:
  // Of a field's description: bits of one element, how many, and where.
  static constexpr std::size_t kCount = 1;
  static constexpr std::size_t kOffset = 2;

  static const std::uint32_t* description(const char* name) {
    return static_cast<const std::uint32_t*>(private_symbol(name));
  }

  template <class Value>
  Value read(pthread_key_t key, std::size_t offset) const {
    return *reinterpret_cast<const volatile Value*>(table_ + key * size_ + offset);
  }

  const char* table_ = nullptr;
  std::size_t size_ = 0;
  std::size_t use_ = 0;
  std::size_t destructor_ = 0;
  pthread_key_t count_ = 0;
};

// Written before the first child.
KeyTable keys;
void (*run_thread_locals)() = nullptr;
bool known = false;

thread_local constinit ThreadDestructors* current = nullptr;

bool try_out_keys() {
  pthread_key_t key{};
  const Destructor destructor = [](void*) {};
  if (::pthread_key_create(&key, destructor) != 0) {
    return false;
  }
  bool right = key < keys.count() && keys.in_use(key) && keys.destructor(key) == destructor;
  ::pthread_key_delete(key);
  right = right && !keys.in_use(key);
  return right;
}

/// On a thread that has no thread_local objects of others.
bool try_out_thread_locals() {
  bool destroyed = false;
  __cxa_thread_atexit_impl([](void* flag) { *static_cast<bool*>(flag) = true; }, &destroyed,
                           &__dso_handle);
  run_thread_locals();
  return destroyed;
}

void* try_out(void*) {
  known = try_out_keys() && try_out_thread_locals();
  return nullptr;
}

}  // namespace

void ThreadDestructors::prepare() {
  run_thread_locals = reinterpret_cast<void (*)()>(private_symbol("__call_tls_dtors"));
  pthread_t thread{};
  if (run_thread_locals != nullptr && keys.find() &&
      ::pthread_create(&thread, nullptr, try_out, nullptr) == 0) {
    ::pthread_join(thread, nullptr);
  }
}

bool ThreadDestructors::can_run() noexcept { return known; }

ThreadDestructors* ThreadDestructors::of_donor() noexcept { return current; }

ThreadDestructors::ThreadDestructors() noexcept {
  current = this;
  for (pthread_key_t key = 0; known && key < keys.count(); ++key) {
    donors_values_[key] = keys.in_use(key) ? ::pthread_getspecific(key) : nullptr;
  }
}

ThreadDestructors::~ThreadDestructors() { current = nullptr; }

void ThreadDestructors::run() noexcept {
  if (!known) {
    return;
  }
  run_thread_locals();
  bool again = true;
  for (int round = 0; again; ++round) {
    again = false;
    const bool drop = round == PTHREAD_DESTRUCTOR_ITERATIONS;
    for (pthread_key_t key = 0; key < keys.count(); ++key) {
      void* const value = keys.in_use(key) ? ::pthread_getspecific(key) : nullptr;
      if (value == nullptr || value == donors_values_[key]) {
        continue;
      }
      const Destructor destructor = keys.destructor(key);
      ::pthread_setspecific(key, nullptr);
      if (destructor != nullptr && !drop) {
        destructor(value);
        again = true;
      }
    }
  }
  // Those that destructors of keys made.
  run_thread_locals();
}

}  // namespace play_launch::isolation

// Defines, for the whole program, the four functions with which the libraries of message types find
// the type support that a middleware asks for. ROS's own look it up in a library each time, with
// the dynamic loader's lock: while the initialisers of one node's library run, no other node could
// make a publisher. These remember what was found; only what was not requested before is looked
// up, by ROS's functions.
//
// Children use the table too, and may be killed anywhere in here: there is no lock, and a place
// that was taken and not filled stays empty.

#include "overrides/type_supports.hpp"

#include <dlfcn.h>

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string_view>

#include "base/elf.hpp"
#include "base/next_function.hpp"

#if __has_include(<rosidl_runtime_c/service_type_support_struct.h>)
#include <rosidl_runtime_c/service_type_support_struct.h>
#else  // the tests of isolation, which need no ROS
struct rosidl_message_type_support_t;
struct rosidl_service_type_support_t;
#endif

namespace {

using play_launch::NextFunction;

/// The answers for what was asked. What no longer fits is looked up each time.
class Answers {
 public:
  /// Null: not known. `identifier` says which type support is wanted.
  const void* find(const void* type, const char* identifier) const noexcept {
    for (std::size_t i = 0; i < kMostTries; ++i) {
      const Entry& entry = entries_[place(type, i)];
      const void* const key = entry.type.load(std::memory_order_acquire);
      if (key == nullptr) {
        return nullptr;
      }
      const void* const answer = entry.answer.load(std::memory_order_acquire);
      if (key == type && answer != nullptr && std::strcmp(entry.identifier, identifier) == 0) {
        return answer;
      }
    }
    return nullptr;
  }

  void add(const void* type, const char* identifier, const void* answer) noexcept {
    for (std::size_t i = 0; i < kMostTries; ++i) {
      Entry& entry = entries_[place(type, i)];
      const void* none = nullptr;
      if (entry.type.compare_exchange_strong(none, type)) {
        entry.identifier = identifier;
        entry.answer.store(answer, std::memory_order_release);
        return;
      }
    }
  }

 private:
  static constexpr std::size_t kEntries = 8192;  // a power of 2
  static constexpr std::size_t kMostTries = 64;

  struct Entry {
    std::atomic<const void*> type{nullptr};
    const char* identifier = nullptr;  // a constant of a library that stays open
    std::atomic<const void*> answer{nullptr};
  };

  static std::size_t place(const void* type, std::size_t attempt) noexcept {
    constexpr std::uint64_t kMix = 0x9e3779b97f4a7c15;
    const auto mixed = reinterpret_cast<std::uintptr_t>(type) * kMix;
    return ((mixed >> 32U) + attempt) % kEntries;
  }

  std::array<Entry, kEntries> entries_{};
};

constinit Answers answers;

/// Identifiers for which there were answers for types of C++: those that the middleware asks for.
class Identifiers {
 public:
  void add(const char* identifier) noexcept {
    for (std::atomic<const char*>& place : places_) {
      const char* there = nullptr;
      if (place.compare_exchange_strong(there, identifier) || std::strcmp(there, identifier) == 0) {
        return;
      }
    }
  }

  template <class Visit>
  void for_each(Visit visit) const {
    for (const std::atomic<const char*>& place : places_) {
      if (const char* const identifier = place) {
        visit(identifier);
      }
    }
  }

 private:
  std::array<std::atomic<const char*>, 4> places_{};
};

constinit Identifiers identifiers;

template <class Type, class Next>
const Type* answer(const Type* type, const char* identifier, const Next& next) {
  if (const void* const known = answers.find(type, identifier)) {
    return static_cast<const Type*>(known);
  }
  const Type* const found = next.get()(type, identifier);
  if (found != nullptr) {
    answers.add(type, identifier, found);
  }
  return found;
}

using Message = rosidl_message_type_support_t;
using Service = rosidl_service_type_support_t;

// The first two are functions of C++, by the names that they have in the library.
const NextFunction<
    "_ZN22rosidl_typesupport_cpp39get_message_typesupport_handle_functionEPK29rosidl_message_type_"
    "support_tPKc",
    const Message*(const Message*, const char*)>
    cpp_message;
const NextFunction<
    "_ZN22rosidl_typesupport_cpp39get_service_typesupport_handle_functionEPK29rosidl_service_type_"
    "support_tPKc",
    const Service*(const Service*, const char*)>
    cpp_service;
const NextFunction<"rosidl_typesupport_c__get_message_typesupport_handle_function",
                   const Message*(const Message*, const char*)>
    c_message;
const NextFunction<"rosidl_typesupport_c__get_service_typesupport_handle_function",
                   const Service*(const Service*, const char*)>
    c_service;

}  // namespace

namespace rosidl_typesupport_cpp {

[[gnu::visibility("default")]] const Message* get_message_typesupport_handle_function(
    const Message* handle, const char* identifier) {
  const Message* const found = answer(handle, identifier, cpp_message);
  if (found != nullptr) {
    identifiers.add(identifier);
  }
  return found;
}

[[gnu::visibility("default")]] const Service* get_service_typesupport_handle_function(
    const Service* handle, const char* identifier) {
  return answer(handle, identifier, cpp_service);
}

}  // namespace rosidl_typesupport_cpp

extern "C" {

[[gnu::visibility("default")]] const Message*
rosidl_typesupport_c__get_message_typesupport_handle_function(const Message* handle,
                                                              const char* identifier) {
  return answer(handle, identifier, c_message);
}

[[gnu::visibility("default")]] const Service*
rosidl_typesupport_c__get_service_typesupport_handle_function(const Service* handle,
                                                              const char* identifier) {
  return answer(handle, identifier, c_service);
}

}  // extern "C"

namespace play_launch::isolation {
namespace {

/// How the functions that give out the type support of one type begin.
constexpr std::string_view kMessageOf =
    "_ZN22rosidl_typesupport_cpp31get_message_type_support_handleI";
constexpr std::string_view kServiceOf =
    "_ZN22rosidl_typesupport_cpp31get_service_type_support_handleI";

template <class Type>
const Type* type_support(void* library, const char* name) {
  const auto function = reinterpret_cast<const Type* (*)()>(::dlsym(library, name));
  return function != nullptr ? function() : nullptr;
}

#if __has_include(<rosidl_runtime_c/service_type_support_struct.h>)
/// What the middleware of Kilted asks for as well.
void look_up_parts_of(const Service* type, const char* identifier) {
  for (const Message* const part : {type->request_typesupport, type->response_typesupport}) {
    if (part != nullptr) {
      rosidl_typesupport_cpp::get_message_typesupport_handle_function(part, identifier);
    }
  }
}
#else
void look_up_parts_of(const Service*, const char*) {}
#endif

}  // namespace

void look_up_type_supports(const char* library) {
  void* const handle = ::dlopen(library, RTLD_LAZY | RTLD_NOLOAD);
  const link_map* map = nullptr;
  if (handle == nullptr || ::dlinfo(handle, RTLD_DI_LINKMAP, &map) != 0) {
    return;
  }
  DynamicSymbols(*map).for_each_undefined([handle](const char* name) {
    const std::string_view text = name;
    if (text.starts_with(kMessageOf)) {
      if (const Message* const type = type_support<Message>(handle, name)) {
        identifiers.for_each([type](const char* identifier) {
          rosidl_typesupport_cpp::get_message_typesupport_handle_function(type, identifier);
        });
      }
    } else if (text.starts_with(kServiceOf)) {
      if (const Service* const type = type_support<Service>(handle, name)) {
        identifiers.for_each([type](const char* identifier) {
          rosidl_typesupport_cpp::get_service_typesupport_handle_function(type, identifier);
          look_up_parts_of(type, identifier);
        });
      }
    }
  });
  ::dlclose(handle);
}

}  // namespace play_launch::isolation

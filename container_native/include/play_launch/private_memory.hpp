#pragma once

/// Memory that the other nodes of the container cannot write to, see docs/components.md. For
/// components of either kind: nothing but the C++ library is included, and nothing is linked.

#include <cstddef>
#include <limits>
#include <memory_resource>
#include <new>

/// Defined by the container; null in programs that have no such function.
extern "C" [[gnu::weak, gnu::visibility("default")]] std::pmr::memory_resource*
play_launch_private_memory() noexcept;

namespace play_launch {

/// The private memory of the node whose process calls this, in any thread of it; the same for as
/// long as the node lives. With `memory_domains`, a write of another node to what comes from it is
/// a fault of that node; reading is allowed. What comes from it ends with the node: others may not
/// be left with pointers to it, and only the node's own process may change or free it.
///
/// Elsewhere this is std::pmr::new_delete_resource(): without `memory_domains`, on machines without
/// protection keys, in containers that are not isolated, in programs without a container, and in
/// the container's own threads, such as those that run a library's static initialisers.
[[nodiscard]] inline std::pmr::memory_resource* private_memory() noexcept {
  return play_launch_private_memory != nullptr ? play_launch_private_memory()
                                               : std::pmr::new_delete_resource();
}

/// An allocator of private_memory(), as of the moment at which it is made by default: for
/// containers that do not take a std::pmr::memory_resource, and for containers of containers, each
/// of which finds it. A copy of a container is allocated by the thread that makes it; what is
/// moved stays where it is.
template <class T>
class PrivateAllocator {
 public:
  using value_type = T;

  PrivateAllocator() noexcept : resource_(private_memory()) {}
  template <class U>
  PrivateAllocator(const PrivateAllocator<U>& other) noexcept : resource_(other.resource()) {}

  /// Throws std::bad_alloc, and std::bad_array_new_length where no memory could be so large.
  [[nodiscard]] T* allocate(std::size_t count) {
    if (count > std::numeric_limits<std::size_t>::max() / sizeof(T)) {
      throw std::bad_array_new_length();
    }
    return static_cast<T*>(resource_->allocate(count * sizeof(T), alignof(T)));
  }
  void deallocate(T* place, std::size_t count) noexcept {
    resource_->deallocate(place, count * sizeof(T), alignof(T));
  }

  [[nodiscard]] PrivateAllocator select_on_container_copy_construction() const noexcept {
    return {};
  }
  [[nodiscard]] std::pmr::memory_resource* resource() const noexcept { return resource_; }

 private:
  std::pmr::memory_resource* resource_;
};

template <class T, class U>
[[nodiscard]] bool operator==(const PrivateAllocator<T>& one,
                              const PrivateAllocator<U>& other) noexcept {
  return *one.resource() == *other.resource();
}

}  // namespace play_launch

#pragma once

#include <cstddef>

#include "base/unique_fd.hpp"

namespace play_launch::topics {

/// A file in memory (memfd), mapped, that grows. Its descriptor can be handed to another process.
class MemoryFile {
 public:
  /// Throws std::system_error.
  MemoryFile();
  MemoryFile(MemoryFile&& other) noexcept;
  MemoryFile& operator=(MemoryFile&& other) noexcept;
  MemoryFile(const MemoryFile&) = delete;
  MemoryFile& operator=(const MemoryFile&) = delete;
  ~MemoryFile();

  [[nodiscard]] int descriptor() const { return file_.get(); }
  /// Moves when it grows.
  [[nodiscard]] std::byte* data() const { return data_; }
  [[nodiscard]] std::size_t capacity() const { return capacity_; }

  /// Makes room for at least so many bytes; false when there is no memory.
  bool reserve(std::size_t size);

 private:
  void close();

  UniqueFd file_;
  std::byte* data_ = nullptr;
  std::size_t capacity_ = 0;
};

}  // namespace play_launch::topics

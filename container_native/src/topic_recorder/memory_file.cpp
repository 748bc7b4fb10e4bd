#include "topic_recorder/memory_file.hpp"

#include <sys/mman.h>
#include <unistd.h>

#include <cerrno>
#include <system_error>
#include <utility>

namespace play_launch::topics {
namespace {

/// What a file grows by.
constexpr std::size_t kStep = 256 << 10;

}  // namespace

MemoryFile::MemoryFile() : file_(::memfd_create("topics", MFD_CLOEXEC)) {
  if (!file_) {
    throw std::system_error(errno, std::generic_category(), "no file in memory");
  }
}

MemoryFile::MemoryFile(MemoryFile&& other) noexcept
    : file_(std::move(other.file_)),
      data_(std::exchange(other.data_, nullptr)),
      capacity_(std::exchange(other.capacity_, 0)) {}

MemoryFile& MemoryFile::operator=(MemoryFile&& other) noexcept {
  if (this != &other) {
    close();
    file_ = std::move(other.file_);
    data_ = std::exchange(other.data_, nullptr);
    capacity_ = std::exchange(other.capacity_, 0);
  }
  return *this;
}

MemoryFile::~MemoryFile() { close(); }

void MemoryFile::close() {
  if (data_ != nullptr) {
    ::munmap(data_, capacity_);
    data_ = nullptr;
    capacity_ = 0;
  }
}

bool MemoryFile::reserve(std::size_t size) {
  if (size <= capacity_) {
    return true;
  }
  const std::size_t capacity = (size + kStep - 1) / kStep * kStep;
  if (::ftruncate(file_.get(), static_cast<off_t>(capacity)) != 0) {
    return false;
  }
  void* const place = data_ == nullptr ? ::mmap(nullptr, capacity, PROT_READ | PROT_WRITE,
                                                MAP_SHARED, file_.get(), 0)
                                       : ::mremap(data_, capacity_, capacity, MREMAP_MAYMOVE);
  if (place == MAP_FAILED) {
    return false;
  }
  data_ = static_cast<std::byte*>(place);
  capacity_ = capacity;
  return true;
}

}  // namespace play_launch::topics

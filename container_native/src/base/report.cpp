#include "base/report.hpp"

#include <sys/uio.h>
#include <unistd.h>

#include <array>

namespace play_launch {
namespace {

iovec piece(std::string_view text) { return {const_cast<char*>(text.data()), text.size()}; }

}  // namespace

void report(std::string_view text) noexcept {
  // Not through stdio: its lock may be held by a thread that will never release it.
  const std::array<iovec, 3> line{piece("component_container: "), piece(text), piece("\n")};
  [[maybe_unused]] const ssize_t written = ::writev(STDERR_FILENO, line.data(), line.size());
}

}  // namespace play_launch

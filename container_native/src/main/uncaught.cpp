#include "main/uncaught.hpp"

#include <cstdlib>
#include <exception>
#include <play_launch/detail/running_node.hpp>

namespace play_launch::container {
namespace {

std::terminate_handler next_handler = nullptr;

[[noreturn]] void on_terminate() {
  detail::RunningNode::log_uncaught_exception();
  if (next_handler != nullptr) {
    next_handler();
  }
  std::abort();
}

}  // namespace

void name_nodes_that_throw() { next_handler = std::set_terminate(on_terminate); }

}  // namespace play_launch::container

#include <algorithm>
#include <exception>
#include <play_launch/detail/running_node.hpp>
#include <play_launch/logging.hpp>

namespace play_launch::detail {
namespace {

constinit thread_local const RunningNode* running = nullptr;

/// The logger's name is the node's with dots, which no name of a node has.
std::string node_name(std::string logger) {
  std::ranges::replace(logger, '.', '/');
  return "/" + logger;
}

std::string logger_name(const std::string& node) {
  std::string name = node.substr(1);
  std::ranges::replace(name, '/', '.');
  return name;
}

/// Of the exception that is being handled.
std::string exception_text() {
  try {
    throw;
  } catch (const std::exception& error) {
    return error.what();
  } catch (...) {
    return "something unknown";
  }
}

}  // namespace

RunningNode::RunningNode(const char* name, const Logger* logger) noexcept
    : name_(name), logger_(logger), before_(running) {
  running = this;
}

RunningNode::~RunningNode() { running = before_; }

std::string RunningNode::name() const {
  if (logger_ != nullptr) return node_name(logger_->name());
  return name_ != nullptr ? name_ : "";
}

std::string RunningNode::full_name() { return running != nullptr ? running->name() : ""; }

void RunningNode::log_uncaught_exception() noexcept {
  if (running == nullptr || !std::current_exception()) return;
  try {
    const std::string name = full_name();
    if (name.empty()) return;
    const Logger logger =
        running->logger_ != nullptr ? *running->logger_ : Logger(logger_name(name));
    PLAY_LAUNCH_FATAL(logger, "a callback of node %s threw: %s", name.c_str(),
                      exception_text().c_str());
  } catch (...) {  // out of memory: the line is lost
  }
}

}  // namespace play_launch::detail

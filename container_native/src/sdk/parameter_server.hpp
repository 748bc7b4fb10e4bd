#pragma once

#include <memory>
#include <vector>

namespace play_launch {

class Node;
class ParameterStore;
class ServiceBase;

/// The six standard parameter services of a node.
class ParameterServer {
 public:
  ParameterServer(Node& node, const std::shared_ptr<ParameterStore>& store);
  ~ParameterServer();
  ParameterServer(const ParameterServer&) = delete;
  ParameterServer& operator=(const ParameterServer&) = delete;

 private:
  std::vector<std::shared_ptr<ServiceBase>> services_;
};

}  // namespace play_launch

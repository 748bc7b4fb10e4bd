#include "parameter_server.hpp"

#include <rmw/qos_profiles.h>

#include <play_launch/node.hpp>
#include <rcl_interfaces/srv/describe_parameters.hpp>
#include <rcl_interfaces/srv/get_parameter_types.hpp>
#include <rcl_interfaces/srv/get_parameters.hpp>
#include <rcl_interfaces/srv/list_parameters.hpp>
#include <rcl_interfaces/srv/set_parameters.hpp>
#include <rcl_interfaces/srv/set_parameters_atomically.hpp>
#include <utility>

#include "parameter_store.hpp"

namespace play_launch {
namespace {

using namespace rcl_interfaces::srv;  // NOLINT(google-build-using-namespace)
using Store = std::shared_ptr<ParameterStore>;

rcl_interfaces::msg::SetParametersResult to_result(SetParametersVerdict verdict) {
  rcl_interfaces::msg::SetParametersResult result;
  result.successful = verdict.ok;
  result.reason = std::move(verdict.reason);
  return result;
}

// The answers have one element per name asked for; "not set" stands for undeclared.

auto describe(const Store& store) {
  return
      [store](const DescribeParameters::Request& request, DescribeParameters::Response& response) {
        for (const auto& name : request.names) {
          auto descriptor = store->describe(name);
          if (!descriptor) descriptor.emplace().name = name;
          response.descriptors.push_back(std::move(*descriptor));
        }
      };
}

auto get(const Store& store) {
  return [store](const GetParameters::Request& request, GetParameters::Response& response) {
    for (const auto& name : request.names) {
      response.values.push_back(to_message(store->get(name).value_or(ParameterValue())));
    }
  };
}

auto get_types(const Store& store) {
  return [store](const GetParameterTypes::Request& request, GetParameterTypes::Response& response) {
    for (const auto& name : request.names) {
      const auto value = store->get(name).value_or(ParameterValue());
      response.types.push_back(static_cast<std::uint8_t>(value.index()));
    }
  };
}

auto list(const Store& store) {
  return [store](const ListParameters::Request& request, ListParameters::Response& response) {
    response.result = store->list(request.prefixes, request.depth);
  };
}

auto set(const Store& store) {
  return [store](const SetParameters::Request& request, SetParameters::Response& response) {
    for (const auto& parameter : request.parameters) {
      response.results.push_back(to_result(store->set({from_message(parameter)})));
    }
  };
}

auto set_atomically(const Store& store) {
  return [store](const SetParametersAtomically::Request& request,
                 SetParametersAtomically::Response& response) {
    response.result = to_result(store->set(from_messages(request.parameters)));
  };
}

}  // namespace

ParameterServer::ParameterServer(Node& node, const std::shared_ptr<ParameterStore>& store) {
  const QoS qos(rmw_qos_profile_parameters);
  services_ = {
      node.create_service<DescribeParameters>("~/describe_parameters", describe(store), nullptr,
                                              qos),
      node.create_service<GetParameterTypes>("~/get_parameter_types", get_types(store), nullptr,
                                             qos),
      node.create_service<GetParameters>("~/get_parameters", get(store), nullptr, qos),
      node.create_service<ListParameters>("~/list_parameters", list(store), nullptr, qos),
      node.create_service<SetParameters>("~/set_parameters", set(store), nullptr, qos),
      node.create_service<SetParametersAtomically>("~/set_parameters_atomically",
                                                   set_atomically(store), nullptr, qos),
  };
}

ParameterServer::~ParameterServer() = default;

}  // namespace play_launch

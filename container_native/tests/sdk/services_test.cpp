// Services that answer at once, later, from another thread, never, or after their end.
#include <std_srvs/srv/set_bool.hpp>

#include "client.hpp"

using namespace play_launch;
using namespace play_launch::testing;
using SetBool = std_srvs::srv::SetBool;
using Pending = std::shared_ptr<PendingRequest<SetBool>>;

namespace {

SetBool::Request ask(bool data) {
  SetBool::Request request;
  request.data = data;
  return request;
}

SetBool::Response answer(const std::string& message) {
  SetBool::Response response;
  response.success = true;
  response.message = message;
  return response;
}

void at_once(const std::shared_ptr<Context>& context, const std::shared_ptr<Context>& elsewhere) {
  auto node = std::make_shared<Node>("server", options_in(context));
  const auto service = node->create_service<SetBool>(
      "~/switch", [](const SetBool::Request& request, SetBool::Response& response) {
        response = answer(request.data ? "on" : "off");
      });
  CHECK(service->service_name() == "/server/switch");
  SingleThreadedExecutor executor;
  executor.add_node(node);
  const Spinner spinner(executor);
  Client<SetBool> client(elsewhere, "/server/switch");
  CHECK(client.call(ask(true)).message == "on");
  CHECK(client.call(ask(false)).message == "off");
}

void later(const std::shared_ptr<Context>& context, const std::shared_ptr<Context>& elsewhere) {
  auto node = std::make_shared<Node>("later", options_in(context));
  Watched<std::vector<Pending>> pending;
  auto service = node->create_service<SetBool>("~/later", [&](Pending request) {
    pending.change([&](auto& all) { all.push_back(std::move(request)); });
  });
  MultiThreadedExecutor executor(2);
  executor.add_node(node);
  const Spinner spinner(executor);
  Client<SetBool> client(elsewhere, "/later/later");
  const auto first = client.send(ask(true));
  const auto second = client.send(ask(false));
  CHECK(pending.reaches([](const auto& all) { return all.size() == 2; }));
  auto requests = pending.get();
  CHECK(requests[0]->request().data && !requests[1]->request().data);

  // The other way round, from another thread.
  CHECK(requests[1]->respond(answer("second")));
  auto received = client.receive();
  CHECK(received && received->first == second && received->second.message == "second");
  std::thread([&] { CHECK(requests[0]->respond(answer("first"))); }).join();
  received = client.receive();
  CHECK(received && received->first == first && received->second.message == "first");
  CHECK_THROWS(requests[0]->respond(answer("again")), std::logic_error);

  // A request may outlive the service; then it gets no response.
  const auto third = client.send(ask(true));
  CHECK(third != second);
  CHECK(pending.reaches([](const auto& all) { return all.size() == 3; }));
  auto orphan = pending.get()[2];
  executor.remove_node(node);
  service.reset();
  CHECK(!orphan->respond(answer("too late")));
}

void many_at_once(const std::shared_ptr<Context>& context,
                  const std::shared_ptr<Context>& elsewhere) {
  auto node = std::make_shared<Node>("many", options_in(context));
  const auto service = node->create_service<SetBool>(
      "~/echo",
      [](const SetBool::Request&, SetBool::Response& response) { response = answer("echo"); });
  SingleThreadedExecutor executor;
  executor.add_node(node);
  const Spinner spinner(executor);
  Client<SetBool> client(elsewhere, "/many/echo");
  for (int round = 0; round < 20; ++round) {
    // As many as the default quality of service keeps.
    for (int i = 0; i < 10; ++i) client.send(ask(true));
    for (int i = 0; i < 10; ++i) CHECK(client.receive());
  }
}

}  // namespace

int main() {
  const auto context = make_context();
  const auto elsewhere = make_context();
  at_once(context, elsewhere);
  later(context, elsewhere);
  many_at_once(context, elsewhere);
  return 0;
}

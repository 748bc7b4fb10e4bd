#include "hosts/isolated/node_life.hpp"

#include <array>

namespace play_launch::container {
namespace {

/// A call is due once, when all of `with` and none of `without` has happened.
struct Row {
  LifeCall call;
  NodeLife with;
  NodeLife without;
};

constexpr auto kNothing = NodeLife::preparing;

/// In the order of the calls. Of the three in the middle exactly one holds when a life has ended or
/// died, as nothing but `finished` follows that.
constexpr std::array kTable{
    Row{LifeCall::constructing, NodeLife::constructing, kNothing},
    Row{LifeCall::loaded, NodeLife::spinning, kNothing},
    Row{LifeCall::load_failed, NodeLife::ended | NodeLife::failed, kNothing},
    Row{LifeCall::gone, NodeLife::ended, NodeLife::failed},
    Row{LifeCall::died, NodeLife::died, kNothing},
    Row{LifeCall::cleaned_up, NodeLife::died | NodeLife::finished, kNothing},
};

}  // namespace

std::optional<LifeCall> LifeCalls::next(NodeLife life) {
  for (const Row& row : kTable) {
    const std::uint32_t bit = 1U << static_cast<std::uint32_t>(row.call);
    if ((made_ & bit) == 0 && has_all(life, row.with) && !has_any(life, row.without)) {
      made_ |= bit;
      return row.call;
    }
  }
  return std::nullopt;
}

}  // namespace play_launch::container

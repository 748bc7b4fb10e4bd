#include <algorithm>
#include <mutex>
#include <play_launch/detail/construction.hpp>
#include <utility>
#include <vector>

namespace play_launch {

struct ConstructionLedger {
  std::mutex mutex;
  std::vector<Discardable*> entries;  // in order of construction
};

namespace {

// Without a destructor, which would not be run when the thread dies.
constinit thread_local const std::shared_ptr<ConstructionLedger>* current_ledger = nullptr;

}  // namespace

Construction::Construction() : ledger_(std::make_shared<ConstructionLedger>()) {}
Construction::~Construction() = default;

Construction::Watch::Watch(Construction& construction) : construction_(construction) {
  current_ledger = &construction_.ledger_;
}

Construction::Watch::~Watch() {
  current_ledger = nullptr;
  const std::lock_guard lock(construction_.ledger_->mutex);
  construction_.ledger_->entries.clear();
}

bool Construction::is_watched() noexcept { return current_ledger != nullptr; }

void Construction::discard() noexcept {
  current_ledger = nullptr;
  std::vector<Discardable*> entries;
  {
    const std::lock_guard lock(ledger_->mutex);
    entries.swap(ledger_->entries);
  }
  // Nodes come before what is made with them.
  for (auto entry = entries.rbegin(); entry != entries.rend(); ++entry) {
    (*entry)->discarded_ = true;
    (*entry)->discard();
  }
}

void Discardable::enter_ledger() {
  if (current_ledger == nullptr) return;
  ledger_ = *current_ledger;
  const std::lock_guard lock(ledger_->mutex);
  ledger_->entries.push_back(this);
}

bool Discardable::leave_ledger() noexcept {
  if (ledger_ != nullptr) {
    const std::lock_guard lock(ledger_->mutex);
    std::erase(ledger_->entries, this);
  }
  return !discarded_;
}

}  // namespace play_launch

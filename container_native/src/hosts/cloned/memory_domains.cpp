#include "hosts/cloned/memory_domains.hpp"

#include <algorithm>
#include <utility>

#include "base/report.hpp"
#include "components/component_options.hpp"
#include "isolation/memory/protection_keys.hpp"

namespace play_launch::container {

using isolation::PrivateMemory;

std::unique_ptr<MemoryDomain> MemoryDomains::make(const std::string& name) {
  const bool is_required = choice_ == DomainChoice::required;
  std::string problem = "no protection key is left";
  {
    const std::lock_guard lock(mutex_);
    domains_.reserve(domains_.size() + 1);  // nothing throws once the domain is there
    if (const int key = take_key(is_required); key > 0) {
      if (PrivateMemory::Owner memory = PrivateMemory::create(key)) {
        auto domain =
            std::make_unique<MemoryDomain>(shared_from_this(), key, std::move(memory), name);
        const std::string sharers = sharers_of(*domain);
        domains_.push_back(domain.get());
        if (!sharers.empty()) {
          report("the private memory of " + name + " has the same protection key as that of " +
                 sharers + ": these nodes are not protected from one another");
        }
        return domain;
      }
      keys_.give_back(key);
      problem = "there are no addresses left for it (ulimit -v)";
    }
  }
  if (is_required) {
    throw LoadError("memory_domains: required, but private memory cannot be protected: " + problem);
  }
  report("private memory of " + name + " is ordinary memory: " + problem);
  return nullptr;
}

int MemoryDomains::take_key(bool alone) {
  int key = keys_.take(isolation::new_protection_key, true);
  // The reload of a node would be refused otherwise, for as long as its remains are there.
  for (MemoryDomain* const domain : domains_) {
    if (key < 0 && domain->has_ended_ && domain->holds_key_) {
      domain->holds_key_ = false;
      keys_.give_back(domain->key_);
      key = keys_.take(isolation::new_protection_key, true);
    }
  }
  return key > 0 || alone ? key : keys_.take(isolation::new_protection_key, false);
}

std::string MemoryDomains::sharers_of(const MemoryDomain& domain) const {
  std::string names;
  for (const MemoryDomain* const other : domains_) {
    if (other->key_ == domain.key_ && !other->has_ended_) {
      names += (names.empty() ? "" : ", ") + other->name_;
    }
  }
  return names;
}

std::string MemoryDomains::owner_of(std::uintptr_t address) const {
  const std::lock_guard lock(mutex_);
  const auto found = std::ranges::find_if(domains_, [address](const MemoryDomain* domain) {
    return domain->memory_->contains(address);
  });
  return found != domains_.end() ? (*found)->name_ : "";
}

MemoryDomain::MemoryDomain(std::shared_ptr<MemoryDomains> all, int key, PrivateMemory::Owner memory,
                           std::string name)
    : all_(std::move(all)), key_(key), memory_(std::move(memory)), name_(std::move(name)) {}

MemoryDomain::~MemoryDomain() {
  const std::lock_guard lock(all_->mutex_);
  std::erase(all_->domains_, this);
  if (keeps_memory_) {
    PrivateMemory::keep(std::move(memory_));
  } else {
    memory_.reset();
  }
  if (holds_key_) {
    all_->keys_.give_back(key_);  // no page has it any more
  }
}

void MemoryDomain::end() {
  const std::lock_guard lock(all_->mutex_);
  has_ended_ = true;
}

void MemoryDomain::set_name(const std::string& name) {
  const std::lock_guard lock(all_->mutex_);
  name_ = name;
}

}  // namespace play_launch::container

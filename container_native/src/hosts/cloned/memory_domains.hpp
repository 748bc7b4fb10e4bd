#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "isolation/memory/private_memory.hpp"
#include "isolation/memory/protection_keys.hpp"

namespace play_launch::container {

/// What was asked for on the command line.
enum class DomainChoice {
  off,
  automatic,  // private memory is protected as far as this machine can
  required,   // a node whose memory could not be protected from all others is not loaded
};

class MemoryDomain;

/// The private memory of a container's nodes, and whose it is. Any thread of the container.
class MemoryDomains : public std::enable_shared_from_this<MemoryDomains> {
 public:
  /// Where there are protection keys. `choice` is not off.
  explicit MemoryDomains(DomainChoice choice) : choice_(choice) {}

  /// For a node of that name. Null: it has none, and that is reported. Throws LoadError where it is
  /// required.
  std::unique_ptr<MemoryDomain> make(const std::string& name);

  /// The node that the address belongs to; empty: none.
  std::string owner_of(std::uintptr_t address) const;

 private:
  friend class MemoryDomain;

  int take_key(bool alone);
  std::string sharers_of(const MemoryDomain& domain) const;

  const DomainChoice choice_;
  mutable std::mutex mutex_;  // guards what follows; no process but the container takes it
  isolation::KeyTable keys_;
  std::vector<MemoryDomain*> domains_;
};

/// That of one node, for as long as any process of the node lives.
class MemoryDomain {
 public:
  MemoryDomain(std::shared_ptr<MemoryDomains> all, int key, isolation::PrivateMemory::Owner memory,
               std::string name);
  MemoryDomain(const MemoryDomain&) = delete;
  MemoryDomain& operator=(const MemoryDomain&) = delete;
  /// The memory goes, and the key is free to be used for another node.
  ~MemoryDomain();

  /// The name is known now.
  void set_name(const std::string& name);
  /// The node has ended: where no key is left, another node may have this one from now on, whatever
  /// is still to be done about the remains of this.
  void end();
  /// Not all that used the memory could be destroyed: it stays, but not under the key.
  void keep_memory() { keeps_memory_ = true; }

  isolation::PrivateMemory& memory() const { return *memory_; }
  /// What the node's processes may do.
  isolation::KeyRights rights() const { return isolation::rights_of_owner(key_); }

 private:
  friend class MemoryDomains;

  const std::shared_ptr<MemoryDomains> all_;
  const int key_;
  isolation::PrivateMemory::Owner memory_;
  bool keeps_memory_ = false;
  // Guarded by the mutex of all:
  bool has_ended_ = false;
  bool holds_key_ = true;
  std::string name_;
};

}  // namespace play_launch::container

#include "residue.hpp"

#include <pthread.h>

#include <memory>
#include <stdexcept>
#include <string>

namespace {

struct Residue {
  Deed deed = Deed::nothing;
  Report report = nullptr;
  std::string ballast;

  void end() const {
    if (report != nullptr) {
      report();
    }
    switch (deed) {
      case Deed::fault:
        *reinterpret_cast<volatile int*>(8) = 1;
        break;
      case Deed::raise:
        throw std::runtime_error("from a destructor");
      case Deed::loop:
        while (true) {
          asm volatile("");
        }
      case Deed::nothing:
      case Deed::another:
        break;
    }
  }
};

struct Object : Residue {
  ~Object() noexcept(false);
};

thread_local Object object;

struct Late : Residue {
  ~Late() { end(); }
};

Late& late() {
  thread_local Late object;
  return object;
}

Object::~Object() noexcept(false) {
  if (deed == Deed::another) {
    late().report = report;
  }
  end();
}

pthread_key_t key;

void end_value(void* value) {
  const std::unique_ptr<Residue> residue(static_cast<Residue*>(value));
  if (residue->deed == Deed::another) {
    ::pthread_setspecific(key, new Residue(*residue));
  }
  residue->end();
}

}  // namespace

extern "C" {

[[gnu::visibility("default")]] void leave_object(Deed deed, Report report) {
  object.deed = deed;
  object.report = report;
  object.ballast.assign(1000, 'x');
}

[[gnu::visibility("default")]] void leave_value(Deed deed, Report report) {
  static const bool made = ::pthread_key_create(&key, end_value) == 0;
  if (made) {
    ::pthread_setspecific(key, new Residue{deed, report, std::string(1000, 'x')});
  }
}
}

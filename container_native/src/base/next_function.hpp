#pragma once

#include <dlfcn.h>

#include <algorithm>
#include <atomic>
#include <cstddef>

namespace play_launch {

/// A text as an argument of a template.
template <std::size_t size>
struct FixedText {
  // NOLINTNEXTLINE: written FixedText("text").
  constexpr FixedText(const char (&text)[size]) { std::copy_n(text, size, characters); }
  char characters[size]{};
};

/// The function of that name in a library, for a function of this program that stands before it.
/// An object of this type at namespace scope finds it when the program starts. From then on get()
/// takes no lock, neither the dynamic loader's nor that of a static variable in a function, which
/// the next one to come would wait for if a node were killed inside.
template <FixedText name, class Function>
class NextFunction {
 public:
  NextFunction() noexcept { find(); }

  /// Also before the object is constructed, for libraries that are initialised before the program.
  static Function* get() noexcept {
    Function* const function = function_.load(std::memory_order_relaxed);
    return function != nullptr ? function : find();
  }

 private:
  static Function* find() noexcept {
    auto* const function = reinterpret_cast<Function*>(::dlsym(RTLD_NEXT, name.characters));
    function_.store(function, std::memory_order_relaxed);
    return function;
  }

  static inline constinit std::atomic<Function*> function_{nullptr};
};

/// The one behind a function that has the same type.
template <FixedText name, class Result, class... Arguments>
NextFunction<name, Result(Arguments...)> next_function(Result (*)(Arguments...)) noexcept {
  return {};
}

}  // namespace play_launch

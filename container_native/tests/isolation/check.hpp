#pragma once

#include <cstdio>
#include <cstdlib>
#include <string>

/// Ends the test program with the place and the expression when a condition does not hold.
#define CHECK(condition)                                                                 \
  do {                                                                                   \
    if (!(condition)) {                                                                  \
      std::fprintf(stderr, "%s:%d: CHECK(%s) failed\n", __FILE__, __LINE__, #condition); \
      std::fflush(stderr);                                                               \
      std::_Exit(1);                                                                     \
    }                                                                                    \
  } while (false)

/// Checks that an expression throws that type, and gives its text.
#define CHECK_THROWS(expression, Type)                  \
  [&]() -> std::string {                                \
    try {                                               \
      static_cast<void>(expression);                    \
    } catch (const Type& error) {                       \
      return error.what();                              \
    }                                                   \
    CHECK(!"expected " #expression " to throw " #Type); \
    return {};                                          \
  }()

/// Whether `text` contains `part`.
inline bool contains(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

#pragma once

/// Computes for a while, in the function that calls it.
[[gnu::always_inline]] inline void busy(long turns) {
  for (long i = 0; i < turns; ++i) {
    asm volatile("");
  }
}

[[gnu::always_inline, noreturn]] inline void busy_for_ever() {
  while (true) {
    asm volatile("");
  }
}

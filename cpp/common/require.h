#pragma once
// For code compiled once, for any x86-64: kernels must not leave inline functions behind (cpp/splat/kernel.h).
#include <stdexcept>

namespace respire {

// Throws where what the Rust side must ensure does not hold, such as tables that fit together; Rust receives `what` as
// the error.
inline void require(bool good, const char* what) {
  if (!good) throw std::invalid_argument(what);
}

}  // namespace respire

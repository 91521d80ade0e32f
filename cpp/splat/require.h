#pragma once
// For code compiled once, for any x86-64: kernels must not leave inline functions behind (kernel.h).
#include <stdexcept>

namespace respire {

// Throws if tables from Rust do not fit together; cxx turns that into an error on the Rust side.
inline void require(bool good, const char* what) {
  if (!good) throw std::invalid_argument(what);
}

}  // namespace respire

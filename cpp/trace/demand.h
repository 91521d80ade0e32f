#pragma once
#include <stdexcept>

namespace respire {

// Throws where a precondition that the Rust side must ensure does not hold; Rust receives `what` as the error.
inline void demand(bool condition, const char* what) {
  if (!condition) throw std::invalid_argument(what);
}

}  // namespace respire

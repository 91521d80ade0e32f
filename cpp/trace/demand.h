#pragma once
#include <stdexcept>

namespace respire {

// What the Rust side must have made sure of; it receives the sentence as an error.
inline void demand(bool condition, const char* what) {
  if (!condition) throw std::invalid_argument(what);
}

}  // namespace respire

#pragma once
#include <immintrin.h>

namespace respire {

// Flush-to-zero and denormals-are-zero as Embree wants them; the caller's mode comes back at the end of the scope.
class FloatMode {
 public:
  FloatMode() : saved_(_mm_getcsr()) { _mm_setcsr(saved_ | 0x8040u); }
  ~FloatMode() { _mm_setcsr(saved_); }
  FloatMode(const FloatMode&) = delete;
  FloatMode& operator=(const FloatMode&) = delete;

 private:
  unsigned saved_;
};

}  // namespace respire

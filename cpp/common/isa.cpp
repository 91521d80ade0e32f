#include "cpp/common/isa.h"

namespace respire {

std::uint8_t widest_isa() {
  static const std::uint8_t widest = [] {
    __builtin_cpu_init();
    const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
    const bool avx512 = avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
                        __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw");
    return static_cast<std::uint8_t>(avx512 ? 2 : avx2 ? 1 : 0);
  }();
  return widest;
}

}  // namespace respire

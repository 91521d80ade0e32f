#include "cpp/trace/coat.h"

namespace respire {

// E(cos_o) as the mean of `mirror_weight` over stratified visible normals.
Coat::Coat(float alpha_low, float alpha_high, float ior)
    : rows_(alpha_high > alpha_low ? kRoughnesses : 1), alpha_low_(alpha_low), ior_(ior) {
  // Strata per axis. A single row can afford more of them than each of several rows.
  const int strata = rows_ == 1 ? 64 : 32;
  rows_per_alpha_ = rows_ > 1 ? static_cast<float>(rows_ - 1) / (alpha_high - alpha_low) : 0.0f;
  for (int row = 0; row < rows_; ++row) {
    float alpha = rows_ > 1 ? alpha_low + static_cast<float>(row) / rows_per_alpha_ : alpha_low;
    for (int c = 0; c < kCosines; ++c) {
      float mu = std::max(static_cast<float>(c) / (kCosines - 1), 1e-3f);
      Vec3 o = {std::sqrt(1.0f - mu * mu), 0.0f, mu};
      double sum = 0.0;
      for (int a = 0; a < strata; ++a)
        for (int b = 0; b < strata; ++b) {
          Vec3 h = visible_normal(o, alpha, (static_cast<float>(a) + 0.5f) / static_cast<float>(strata),
                                  (static_cast<float>(b) + 0.5f) / static_cast<float>(strata));
          Vec3 i = mirror(o, h);
          if (i.z > 0.0f) sum += mirror_weight(o, h, i, alpha, ior);
        }
      table_.push_back(static_cast<float>(sum / (strata * strata)));
    }
  }
}

}  // namespace respire

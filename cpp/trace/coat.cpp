#include "cpp/trace/coat.h"

#include <map>
#include <mutex>
#include <tuple>
#include <vector>

namespace respire {

namespace {

// E(cos_o) as the mean of `mirror_weight` over stratified visible normals, row by row.
std::vector<float> directional_albedo(int rows, int cosines, float alpha_low, float rows_per_alpha, float ior) {
  // Strata per axis. A single row can afford more of them than each of several rows.
  const int strata = rows == 1 ? 64 : 32;
  std::vector<float> table;
  for (int row = 0; row < rows; ++row) {
    float alpha = rows > 1 ? alpha_low + static_cast<float>(row) / rows_per_alpha : alpha_low;
    for (int c = 0; c < cosines; ++c) {
      float mu = std::max(static_cast<float>(c) / static_cast<float>(cosines - 1), 1e-3f);
      Vec3 o = {std::sqrt(1.0f - mu * mu), 0.0f, mu};
      double sum = 0.0;
      for (int a = 0; a < strata; ++a)
        for (int b = 0; b < strata; ++b) {
          Vec3 h = visible_normal(o, alpha, (static_cast<float>(a) + 0.5f) / static_cast<float>(strata),
                                  (static_cast<float>(b) + 0.5f) / static_cast<float>(strata));
          Vec3 i = mirror(o, h);
          if (i.z > 0.0f) sum += mirror_weight(o, h, i, alpha, ior);
        }
      table.push_back(static_cast<float>(sum / (strata * strata)));
    }
  }
  return table;
}

}  // namespace

Coat::Coat(float alpha_low, float alpha_high, float ior)
    : rows_(alpha_high > alpha_low ? ROUGHNESSES : 1), alpha_low_(alpha_low), ior_(ior) {
  rows_per_alpha_ = rows_ > 1 ? static_cast<float>(rows_ - 1) / (alpha_high - alpha_low) : 0.0f;
  // A scene has a tracer per shape, all of one material. Tables are few and small, and live as long as the program.
  static std::mutex mutex;
  static auto& tables = *new std::map<std::tuple<float, float, float>, std::vector<float>>;
  const std::lock_guard<std::mutex> lock(mutex);
  std::vector<float>& table = tables[{alpha_low, alpha_high, ior}];
  if (table.empty()) table = directional_albedo(rows_, COSINES, alpha_low, rows_per_alpha_, ior);
  table_ = table.data();
}

}  // namespace respire

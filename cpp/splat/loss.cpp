#include "cpp/splat/loss.h"

#include <stdexcept>

#include "cpp/common/isa.h"
#include "cpp/splat/loss_kernel.h"
#include "respire-bench/src/ffi/splat/loss.rs.h"

namespace respire {

std::size_t loss_scratch(std::size_t width) { return loss_room(width); }

double loss_band(std::uint8_t isa, const LossImage& image, rust::Slice<const float> rendered, std::size_t y0,
                 rust::Slice<float> gradient, rust::Slice<float> room) {
  const std::size_t w = image.width, h = image.height, n = w * h, line = 3 * w;
  const bool agree = isa <= widest_isa() && w > 0 && rendered.size() == 3 * n && image.target.size() == 3 * n &&
                     image.mean.size() == 3 * n && image.square.size() == 3 * n &&
                     (image.mask.empty() || image.mask.size() == n) && gradient.size() % line == 0 && y0 <= h &&
                     gradient.size() / line <= h - y0 && room.size() >= loss_room(w) && image.window.size() == 6 &&
                     image.norm <= 2;
  if (!agree) throw std::invalid_argument("tables of a loss differ in length");
  const LossBand band{rendered.data(),
                      image.target.data(),
                      image.mean.data(),
                      image.square.data(),
                      image.mask.empty() ? nullptr : image.mask.data(),
                      w,
                      h,
                      y0,
                      y0 + gradient.size() / line,
                      image.ssim_weight,
                      1.0f / (3.0f * static_cast<float>(n)),
                      static_cast<Norm>(image.norm),
                      image.softness,
                      image.window.data(),
                      gradient.data(),
                      room.data()};
  switch (isa) {
    case 2: return avx512::loss(band);
    case 1: return avx2::loss(band);
    default: return baseline::loss(band);
  }
}

}  // namespace respire

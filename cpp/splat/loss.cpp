// The dispatcher of the photometric loss: checks the arguments from Rust and calls the kernel of one instruction set.
#include "cpp/splat/loss.h"

#include "cpp/common/isa.h"
#include "cpp/common/require.h"
#include "cpp/splat/loss_kernel.h"
#include "respire-bench/src/ffi/splat/loss.rs.h"

namespace respire {

std::size_t loss_scratch(std::size_t width) { return loss_scratch_floats(width); }

double loss_band(std::uint8_t isa, const LossImage& image, rust::Slice<const float> rendered, std::size_t first,
                 rust::Slice<float> gradient, rust::Slice<float> scratch) {
  require(isa <= widest_isa(), "this processor lacks the instruction set asked for");
  const std::size_t w = image.width, h = image.height, n = w * h, line = 3 * w;
  require(w > 0 && w <= 1u << 24 && h <= 1u << 24, "no image has such a side");
  require(rendered.size() == 3 * n && image.target.size() == 3 * n && image.mean.size() == 3 * n &&
              image.square.size() == 3 * n && (image.mask.empty() || image.mask.size() == n),
          "images of a loss differ in size");
  require(gradient.size() % line == 0 && first <= h && gradient.size() / line <= h - first &&
              scratch.size() >= loss_scratch_floats(w),
          "tables of a loss differ in length");
  LossBand band;
  band.rendered = rendered.data();
  band.target = image.target.data();
  band.mean = image.mean.data();
  band.square = image.square.data();
  band.mask = image.mask.empty() ? nullptr : image.mask.data();
  band.width = w;
  band.height = h;
  band.y0 = first;
  band.y1 = first + gradient.size() / line;
  band.ssim_weight = image.ssim_weight;
  band.uniform = 1.0f / (3.0f * static_cast<float>(n));
  band.window = image.window.data();
  band.gradient = gradient.data();
  band.scratch = scratch.data();
  switch (isa) {
    case 2: return avx512::loss(band);
    case 1: return avx2::loss(band);
    default: return baseline::loss(band);
  }
}

}  // namespace respire

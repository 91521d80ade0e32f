#pragma once
// The interface between the dispatcher (loss.cpp) and the kernel, which is compiled once per instruction set. Plain
// pointers and no library headers, as in splat_kernel.h.
#include <cstddef>
#include <cstdint>

namespace respire {

// What a difference costs (src/reconstruct/loss/norm.rs).
enum class Norm : unsigned char { L1, CHARBONNIER, HUBER };

// Lines y0..y1 of the loss of one image and its gradient; the twin, which explains the symbols, is
// src/reconstruct/loss/photometric.rs. Images: red, green, blue of each pixel, line by line.
struct LossBand {
  const float* rendered;
  const float *target, *mean, *square;  // the image, its blur, the blur of its square
  const float* mask;                    // weight per pixel, or null
  std::size_t width, height, y0, y1;
  float ssim_weight, uniform;  // `uniform`: weight of a pixel without mask
  Norm norm;                   // in the place of L1, and where it becomes linear
  float softness;
  const float* window;         // 6 taps, the outermost first
  float* gradient;             // out, from line y0 on
  float* room;                 // scratch of loss_room(width) floats
};

// Values kept free on either side of a line.
constexpr int LOSS_MARGIN = 16;
// Three channels, whole vectors, and the lines not a multiple of 4096 bytes apart, which caches take for the same place.
constexpr std::size_t loss_stride(std::size_t width) {
  const std::size_t stride = (3 * width + 15) / 16 * 16 + 2 * LOSS_MARGIN;
  return stride % 256 ? stride : stride + 16;
}
// Two rings of 16 lines of 3 maps, a line of zeros, 12 maps and 8 weights; and room to begin at a cache line.
constexpr std::size_t loss_room(std::size_t width) { return 117 * loss_stride(width) + 16; }

namespace baseline {
double loss(const LossBand&);
}
namespace avx2 {
double loss(const LossBand&);
}
namespace avx512 {
double loss(const LossBand&);
}

}  // namespace respire

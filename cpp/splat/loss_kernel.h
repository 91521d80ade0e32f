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
// Lines that are blurred together, and lines of derivatives that are kept.
constexpr int LOSS_GROUP = 8, LOSS_RING = 26;
// A line of zeros, the ring and a group of 3 maps, two weights for a group; and room to begin at a cache line.
constexpr std::size_t loss_room(std::size_t width) {
  return (1 + 3 * LOSS_RING + 5 * LOSS_GROUP) * loss_stride(width) + 16;
}

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

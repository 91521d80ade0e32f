#pragma once
// The interface between the dispatcher (loss.cpp) and the kernel, which is compiled once per instruction set. Plain
// pointers and no library headers, as in kernel.h.
#include <cstddef>
#include <cstdint>

namespace respire {

// Lines y0..y1 of the loss of one image and its gradient; the twin, which explains the symbols, is
// src/reconstruct/fitting/loss/photometric.rs. Images: red, green, blue of each pixel, line by line.
struct LossBand {
  const float* rendered;
  const float *target, *mean, *square;  // the image, its blur, the blur of its square
  const float* mask;                    // weight per pixel, or null
  std::size_t width, height, y0, y1;
  float ssim_weight, uniform;  // `uniform`: weight of a value (one channel of a pixel) without mask
  const float* window;         // 6 of the 11 taps, the outermost first, the centre last
  float* gradient;             // out, from line y0 on
  float* scratch;              // loss_scratch_floats(width) of them
};

// Zeros on either side of a line, in values: no less than the 5 pixels of the window and than a vector of 16.
constexpr int LOSS_MARGIN = 16;
// From one line of the scratch to the next: three channels and the margins in whole vectors, but no multiple of 4096
// bytes, which would map all lines to the same set of the cache.
constexpr std::size_t loss_stride(std::size_t width) {
  const std::size_t stride = (3 * width + 15) / 16 * 16 + 2 * LOSS_MARGIN;
  return stride % 256 ? stride : stride + 16;
}
// Lines that are blurred together, since neighbours share most of what they load; and lines of derivatives that are
// kept: two groups and the ten lines of the window beyond them.
constexpr int LOSS_GROUP = 8, LOSS_RING = 26;
// A line of zeros, the ring and a group of 3 maps, two weights for a group; and 16 to begin at a cache line.
constexpr std::size_t loss_scratch_floats(std::size_t width) {
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

#pragma once
// The interface between the dispatcher (loss.cpp) and the kernel, which is compiled once per instruction set. Plain
// pointers and no library headers, as in splat_kernel.h.
#include <cstddef>

namespace respire {

// What a difference costs (src/reconstruct/loss/norm.rs).
enum class Norm : unsigned char { L1, CHARBONNIER, HUBER };

// Lines y0..y1 of the loss of one image and its gradient; the twin, which explains the symbols, is
// src/reconstruct/loss/photometric.rs. Planes: red, green, blue one after the other, width * height each.
struct LossBand {
  const float* rendered;  // interleaved
  const float *target, *mean, *square;  // planes of the image, its blur, the blur of its square
  const float* mask;                    // weight per pixel, or null
  std::size_t width, height, y0, y1;
  float ssim_weight, uniform;  // `uniform`: weight of a pixel without mask
  Norm norm;                   // in the place of L1, and where it becomes linear
  float softness;
  const float* window;         // 6 taps, the outermost first
  float* gradient;             // out: interleaved, from line y0 on
  float* room;                 // scratch of loss_room(width) floats
};

constexpr std::size_t loss_stride(std::size_t width) { return (width + 15) / 16 * 16 + 32; }
constexpr std::size_t loss_room(std::size_t width) { return 144 * loss_stride(width); }

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

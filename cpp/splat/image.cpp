// Between the planes of tiles and images in rows, four pixels at a time, for any x86-64. With the sums C of a pixel's
// colours, its depth sum D and its transmittance T:
//
//   color = gain (C + T background),  alpha = 1 - T,  depth = D / alpha (0 where alpha is 0).
//
// Adjoint: the gradients by C and D, and `behind`, the contribution of all splats of the pixel and the background,
// from which the backward kernels subtract splat by splat (src/splat/plain/tile.rs).
#include "cpp/splat/image.h"

#include <emmintrin.h>

#include <algorithm>

#include "cpp/common/require.h"
#include "cpp/splat/kernel.h"
#include "respire-bench/src/ffi/splat/image.rs.h"

namespace respire {
namespace {

constexpr std::size_t SIDE = 16;        // of a tile, in pixels
constexpr std::size_t MOST = 1u << 24;  // pixels of a side: products of two sides do not wrap

// Index in a plane of a tile of its pixels 4 * piece to 4 * piece + 3 of a line, which lie one after the other.
std::size_t index_of(std::size_t piece, std::size_t line) { return 16 * (4 * piece + line / 4) + 4 * (line % 4); }

// Gain and background, each channel in four lanes.
struct Formation {
  __m128 gain[3], background[3];
  explicit Formation(const ImageFormation& of) {
    for (int k = 0; k < 3; ++k) {
      gain[k] = _mm_set1_ps(static_cast<float>(of.gain[k]));
      background[k] = _mm_set1_ps(static_cast<float>(of.background[k]));
    }
  }
};

// r0..r3, g0..g3, b0..b3 to r0 g0 b0 r1 g1 b1 ..
void interleave(__m128 r, __m128 g, __m128 b, float* out) {
  const __m128 low = _mm_unpacklo_ps(r, g), high = _mm_unpackhi_ps(r, g);
  const __m128 b0r1 = _mm_shuffle_ps(b, low, _MM_SHUFFLE(2, 2, 0, 0));
  const __m128 g1b1 = _mm_shuffle_ps(g, b, _MM_SHUFFLE(1, 1, 1, 1));
  const __m128 b2r3 = _mm_shuffle_ps(b, high, _MM_SHUFFLE(2, 2, 2, 2));
  const __m128 g3b3 = _mm_shuffle_ps(high, b, _MM_SHUFFLE(3, 3, 3, 3));
  _mm_storeu_ps(out, _mm_shuffle_ps(low, b0r1, _MM_SHUFFLE(2, 0, 1, 0)));
  _mm_storeu_ps(out + 4, _mm_shuffle_ps(g1b1, high, _MM_SHUFFLE(1, 0, 2, 0)));
  _mm_storeu_ps(out + 8, _mm_shuffle_ps(b2r3, g3b3, _MM_SHUFFLE(2, 0, 2, 0)));
}

// r0 g0 b0 r1 g1 b1 .. to r0..r3, g0..g3, b0..b3.
void separate(const float* in, __m128* rgb) {
  const __m128 x = _mm_loadu_ps(in), y = _mm_loadu_ps(in + 4), z = _mm_loadu_ps(in + 8);
  rgb[0] = _mm_shuffle_ps(x, _mm_shuffle_ps(y, z, _MM_SHUFFLE(1, 1, 2, 2)), _MM_SHUFFLE(2, 0, 3, 0));
  rgb[1] = _mm_shuffle_ps(_mm_shuffle_ps(x, y, _MM_SHUFFLE(0, 0, 1, 1)), _mm_shuffle_ps(y, z, _MM_SHUFFLE(2, 2, 3, 3)),
                          _MM_SHUFFLE(2, 0, 2, 0));
  rgb[2] = _mm_shuffle_ps(_mm_shuffle_ps(x, y, _MM_SHUFFLE(1, 1, 2, 2)), z, _MM_SHUFFLE(3, 0, 2, 0));
}

// Four times N values: 4 - `count` pixels are filled up with 0 where there are not four.
template <int N>
const float* padded(const float* from, std::size_t count, float* room) {
  if (count == 4) return from;
  for (std::size_t i = 0; i < 4 * N; ++i) room[i] = i < N * count ? from[i] : 0.0f;
  return room;
}

}  // namespace

void splat_develop(rust::Slice<const float> state, std::size_t width, const ImageFormation& formation,
                   rust::Slice<float> color, rust::Slice<float> depth, rust::Slice<float> alpha) {
  const std::size_t tiles = (width + SIDE - 1) / SIDE, pixels = alpha.size();
  require(width > 0 && pixels % width == 0 && pixels <= SIDE * width && color.size() == 3 * pixels &&
              (depth.empty() || depth.size() == pixels) && state.size() >= tiles * PLANES * PIXELS,
          "tables of an image differ in length");
  const __m128 one = _mm_set1_ps(1.0f), zero = _mm_setzero_ps();
  const Formation by(formation);
  // A slice asks Rust for its pointer each time.
  const float* const sums = state.data();
  float *const colors = color.data(), *const alphas = alpha.data(),
               *const depths = depth.empty() ? nullptr : depth.data();
  const std::size_t lines = pixels / width;
  for (std::size_t line = 0; line < lines; ++line) {
    for (std::size_t x = 0; x < width; x += 4) {
      const float* s = sums + x / SIDE * PLANES * PIXELS + index_of(x % SIDE / 4, line);
      const __m128 left = _mm_loadu_ps(s + 4 * PIXELS);
      __m128 rgb[3];
      for (int k = 0; k < 3; ++k)
        rgb[k] = _mm_mul_ps(by.gain[k], _mm_add_ps(_mm_loadu_ps(s + k * PIXELS), _mm_mul_ps(left, by.background[k])));
      const __m128 covered = _mm_sub_ps(one, left);
      __m128 deep = zero;
      if (formation.with_depth) {
        deep = _mm_and_ps(_mm_cmpgt_ps(covered, zero), _mm_div_ps(_mm_loadu_ps(s + 3 * PIXELS), covered));
      }
      const std::size_t o = line * width + x, count = std::min<std::size_t>(width - x, 4);
      if (count == 4) {
        interleave(rgb[0], rgb[1], rgb[2], colors + 3 * o);
        _mm_storeu_ps(alphas + o, covered);
        if (depths) _mm_storeu_ps(depths + o, deep);
        continue;
      }
      // The end of a line.
      float last_rgb[12], last_alpha[4], last_depth[4];
      interleave(rgb[0], rgb[1], rgb[2], last_rgb);
      _mm_storeu_ps(last_alpha, covered);
      _mm_storeu_ps(last_depth, deep);
      std::copy_n(last_rgb, 3 * count, colors + 3 * o);
      std::copy_n(last_alpha, count, alphas + o);
      if (depths) std::copy_n(last_depth, count, depths + o);
    }
  }
}

void splat_develop_moving(rust::Slice<const float> moving, std::size_t directions, std::size_t direction,
                          std::size_t width, const ImageFormation& formation, rust::Slice<float> color) {
  const std::size_t tiles = (width + SIDE - 1) / SIDE;
  require(width > 0 && color.size() % (3 * width) == 0 && color.size() <= 3 * SIDE * width && direction < directions &&
              moving.size() >= tiles * directions * MOVING * PIXELS,
          "tables of an image differ in length");
  const std::size_t lines = color.size() / (3 * width);
  const float* const tables = moving.data();
  float* const out = color.data();
  const __m128 zero = _mm_setzero_ps();
  const Formation by(formation);
  for (std::size_t line = 0; line < lines; ++line) {
    for (std::size_t x = 0; x < width; x += 4) {
      const float* s = tables + (x / SIDE * directions + direction) * MOVING * PIXELS + index_of(x % SIDE / 4, line);
      const __m128 left = _mm_loadu_ps(s + 3 * PIXELS);
      __m128 rgb[3];
      for (int c = 0; c < 3; ++c) {
        const __m128 sum = _mm_add_ps(_mm_loadu_ps(s + c * PIXELS), _mm_mul_ps(left, by.background[c]));
        const __m128 v = _mm_mul_ps(by.gain[c], sum);
        // v - v is 0 only where v is finite.
        rgb[c] = _mm_and_ps(v, _mm_cmpeq_ps(_mm_sub_ps(v, v), zero));
      }
      const std::size_t o = line * width + x, count = std::min<std::size_t>(width - x, 4);
      float last[12];
      interleave(rgb[0], rgb[1], rgb[2], count == 4 ? out + 3 * o : last);
      if (count < 4) std::copy_n(last, 3 * count, out + 3 * o);
    }
  }
}

std::array<double, 3> splat_adjoint(rust::Slice<const float> state, const TilePlace& place,
                                    const ImageFormation& formation, const PixelGradients& image,
                                    rust::Slice<float> adjoint) {
  const auto [x0, y0] = place.corner;
  const auto [width, height] = place.size;
  const std::size_t pixels = width * height;
  const auto is_none_or = [](rust::Slice<const float> values, std::size_t size) {
    return values.empty() || values.size() == size;
  };
  require(width <= MOST && height <= MOST && x0 < width && y0 < height, "a tile lies outside the image");
  require(state.size() == PLANES * PIXELS && adjoint.size() == PLANES * PIXELS && is_none_or(image.color, 3 * pixels) &&
              is_none_or(image.depth, pixels) && is_none_or(image.alpha, pixels),
          "tables of an image differ in length");
  const __m128 one = _mm_set1_ps(1.0f), zero = _mm_setzero_ps();
  const Formation by(formation);
  // A slice asks Rust for its pointer each time; null if it is empty.
  const float* const states = state.data();
  const float* const colors = image.color.empty() ? nullptr : image.color.data();
  const float* const depths = image.depth.empty() ? nullptr : image.depth.data();
  const float* const alphas = image.alpha.empty() ? nullptr : image.alpha.data();
  float* const out = adjoint.data();
  __m128d by_gain[3][2];
  for (auto& sum : by_gain) sum[0] = sum[1] = _mm_setzero_pd();
  for (std::size_t line = 0; line < SIDE; ++line) {
    for (std::size_t piece = 0; piece < SIDE / 4; ++piece) {
      const std::size_t p = index_of(piece, line), x = x0 + 4 * piece, y = y0 + line, o = y * width + x;
      float* a = out + p;
      if (x >= width || y >= height) {
        for (int k = 0; k < PLANES; ++k) _mm_storeu_ps(a + k * PIXELS, zero);
        continue;
      }
      const std::size_t count = std::min<std::size_t>(width - x, 4);
      const float* s = states + p;
      float room[12];
      const __m128 left = _mm_loadu_ps(s + 4 * PIXELS);
      __m128 behind = zero, by_left = zero, by_depth = zero;
      // alpha = 1 - T.
      if (alphas) {
        const __m128 v = _mm_loadu_ps(padded<1>(alphas + o, count, room));
        by_left = _mm_sub_ps(zero, v);
      }
      // color = gain (C + T background).
      if (colors) {
        __m128 rgb[3];
        separate(padded<3>(colors + 3 * o, count, room), rgb);
        for (int k = 0; k < 3; ++k) {
          const __m128 v = _mm_mul_ps(rgb[k], by.gain[k]), plain = _mm_loadu_ps(s + k * PIXELS);
          const __m128 before_gain = _mm_add_ps(plain, _mm_mul_ps(left, by.background[k]));
          const __m128 shown = _mm_mul_ps(rgb[k], before_gain);
          by_gain[k][0] = _mm_add_pd(by_gain[k][0], _mm_cvtps_pd(shown));
          by_gain[k][1] = _mm_add_pd(by_gain[k][1], _mm_cvtps_pd(_mm_movehl_ps(shown, shown)));
          _mm_storeu_ps(a + k * PIXELS, v);
          behind = _mm_add_ps(behind, _mm_mul_ps(v, plain));
          by_left = _mm_add_ps(by_left, _mm_mul_ps(v, by.background[k]));
        }
      } else {
        for (int k = 0; k < 3; ++k) _mm_storeu_ps(a + k * PIXELS, zero);
      }
      // depth = D / (1 - T).
      if (depths) {
        const __m128 v = _mm_loadu_ps(padded<1>(depths + o, count, room));
        const __m128 covered = _mm_sub_ps(one, left), there = _mm_cmpgt_ps(covered, zero);
        by_depth = _mm_and_ps(there, _mm_div_ps(v, covered));
        const __m128 sum = _mm_mul_ps(by_depth, _mm_loadu_ps(s + 3 * PIXELS));
        behind = _mm_add_ps(behind, sum);
        by_left = _mm_add_ps(by_left, _mm_and_ps(there, _mm_div_ps(sum, covered)));
      }
      _mm_storeu_ps(a + 3 * PIXELS, by_depth);
      _mm_storeu_ps(a + 4 * PIXELS, _mm_add_ps(behind, _mm_mul_ps(left, by_left)));
    }
  }
  if (colors) {
    // Prefetch what the next tile will read: its lines are too short for the processor to predict them.
    const bool wraps = x0 + SIDE >= width;
    const std::size_t x = wraps ? 0 : x0 + SIDE, top = wraps ? y0 + SIDE : y0, bottom = std::min(height, top + SIDE);
    for (std::size_t y = top; y < bottom; ++y)
      for (std::size_t k = 0; k < 3 * SIDE; k += 16) __builtin_prefetch(colors + 3 * (y * width + x) + k);
  }
  for (int k = 0; k < PLANES * PIXELS; k += 16) __builtin_prefetch(states + PLANES * PIXELS + k);
  std::array<double, 3> sums;
  for (int k = 0; k < 3; ++k) {
    double two[2];
    _mm_storeu_pd(two, _mm_add_pd(by_gain[k][0], by_gain[k][1]));
    sums[k] = two[0] + two[1];
  }
  return sums;
}

}  // namespace respire

// Between the tiles' planes (blocks of 4x4 pixels) and images in rows, four pixels at a time, for any x86-64.
#include "cpp/splat/image.h"

#include <emmintrin.h>

#include <algorithm>
#include <stdexcept>

#include "cpp/splat/kernel.h"

namespace respire {
namespace {

void require(bool good, const char* what) {
  if (!good) throw std::invalid_argument(what);
}

bool is_side(std::size_t side) { return side == 4 || side == 8 || side == 16; }

// Where line `line` of a tile has pixels 4 * piece to 4 * piece + 3.
std::size_t place(std::size_t piece, std::size_t line) { return 16 * (4 * piece + line / 4) + 4 * (line % 4); }

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

// The other way.
void part(const float* in, __m128* rgb) {
  const __m128 x = _mm_loadu_ps(in), y = _mm_loadu_ps(in + 4), z = _mm_loadu_ps(in + 8);
  rgb[0] = _mm_shuffle_ps(x, _mm_shuffle_ps(y, z, _MM_SHUFFLE(1, 1, 2, 2)), _MM_SHUFFLE(2, 0, 3, 0));
  rgb[1] = _mm_shuffle_ps(_mm_shuffle_ps(x, y, _MM_SHUFFLE(0, 0, 1, 1)), _mm_shuffle_ps(y, z, _MM_SHUFFLE(2, 2, 3, 3)),
                          _MM_SHUFFLE(2, 0, 2, 0));
  rgb[2] = _mm_shuffle_ps(_mm_shuffle_ps(x, y, _MM_SHUFFLE(1, 1, 2, 2)), z, _MM_SHUFFLE(3, 0, 2, 0));
}

// `count` values at `from`, the rest 0.
template <int N>
const float* padded(const float* from, std::size_t count, float* room) {
  if (count == 4) return from;
  for (std::size_t i = 0; i < 4 * N; ++i) room[i] = i < N * count ? from[i] : 0.0f;
  return room;
}

}  // namespace

void splat_develop(rust::Slice<const float> state, std::size_t width, std::size_t side,
                   std::array<float, 3> gain, std::array<float, 3> background, bool with_depth, rust::Slice<float> color, rust::Slice<float> depth,
                   rust::Slice<float> alpha) {
  require(is_side(side), "a tile is 4, 8 or 16 pixels wide");
  const std::size_t tiles = (width + side - 1) / side, pixels = alpha.size();
  require(width > 0 && pixels % width == 0 && pixels <= side * width && color.size() == 3 * pixels &&
              (depth.empty() || depth.size() == pixels) && state.size() >= tiles * PLANES * PIXELS,
          "tables of an image differ in length");
  const __m128 one = _mm_set1_ps(1.0f), zero = _mm_setzero_ps();
  // A slice asks Rust for its pointer each time.
  const float* const sums = state.data();
  float *const colors = color.data(), *const alphas = alpha.data(), *const depths = depth.empty() ? nullptr : depth.data();
  const std::size_t lines = pixels / width;
  const int shift = __builtin_ctzll(side);
  for (std::size_t line = 0; line < lines; ++line) {
    for (std::size_t x = 0; x < width; x += 4) {
      const float* s = sums + (x >> shift) * PLANES * PIXELS + place((x & (side - 1)) / 4, line);
      const __m128 left = _mm_loadu_ps(s + 4 * PIXELS);
      __m128 rgb[3];
      for (int k = 0; k < 3; ++k) {
        const __m128 behind = _mm_mul_ps(left, _mm_set1_ps(background[k]));
        rgb[k] = _mm_mul_ps(_mm_set1_ps(gain[k]), _mm_add_ps(_mm_loadu_ps(s + k * PIXELS), behind));
      }
      const __m128 covered = _mm_sub_ps(one, left);
      __m128 deep = zero;
      if (with_depth) {
        deep = _mm_and_ps(_mm_cmpgt_ps(covered, zero), _mm_div_ps(_mm_loadu_ps(s + 3 * PIXELS), covered));
      }
      const std::size_t o = line * width + x, count = width - x < 4 ? width - x : 4;
      if (count == 4) {
        interleave(rgb[0], rgb[1], rgb[2], colors + 3 * o);
        _mm_storeu_ps(alphas + o, covered);
        if (depths) _mm_storeu_ps(depths + o, deep);
        continue;
      }
      float room[20];
      interleave(rgb[0], rgb[1], rgb[2], room);
      _mm_storeu_ps(room + 12, covered);
      _mm_storeu_ps(room + 16, deep);
      for (std::size_t i = 0; i < count; ++i) {
        for (int k = 0; k < 3; ++k) colors[3 * (o + i) + k] = room[3 * i + k];
        alphas[o + i] = room[12 + i];
        if (depths) depths[o + i] = room[16 + i];
      }
    }
  }
}

void splat_develop_moving(rust::Slice<const float> moving, std::size_t directions, std::size_t k, std::size_t width,
                          std::size_t side, std::array<float, 3> gain, std::array<float, 3> background, rust::Slice<float> color) {
  require(is_side(side), "a tile is 4, 8 or 16 pixels wide");
  const std::size_t tiles = (width + side - 1) / side;
  require(width > 0 && color.size() % (3 * width) == 0 && color.size() <= 3 * side * width && k < directions &&
              moving.size() >= tiles * directions * MOVING * PIXELS,
          "tables of an image differ in length");
  const std::size_t lines = color.size() / (3 * width);
  const int shift = __builtin_ctzll(side);
  const float* const tables = moving.data();
  float* const out = color.data();
  const __m128 zero = _mm_setzero_ps();
  for (std::size_t line = 0; line < lines; ++line) {
    for (std::size_t x = 0; x < width; x += 4) {
      const float* s = tables + ((x >> shift) * directions + k) * MOVING * PIXELS + place((x & (side - 1)) / 4, line);
      const __m128 left = _mm_loadu_ps(s + 3 * PIXELS);
      __m128 rgb[3];
      for (int c = 0; c < 3; ++c) {
        const __m128 behind = _mm_mul_ps(left, _mm_set1_ps(background[c]));
        const __m128 v = _mm_mul_ps(_mm_set1_ps(gain[c]), _mm_add_ps(_mm_loadu_ps(s + c * PIXELS), behind));
        rgb[c] = _mm_and_ps(v, _mm_cmpeq_ps(_mm_sub_ps(v, v), zero));
      }
      const std::size_t o = line * width + x, count = width - x < 4 ? width - x : 4;
      float room[12];
      interleave(rgb[0], rgb[1], rgb[2], count == 4 ? out + 3 * o : room);
      if (count < 4) __builtin_memcpy(out + 3 * o, room, 3 * count * sizeof(float));
    }
  }
}

void splat_adjoint(rust::Slice<const float> state, std::size_t x0, std::size_t y0, std::size_t side, std::size_t width,
                   std::size_t height, std::array<float, 3> gain, std::array<float, 3> background,
                   rust::Slice<const float> color, rust::Slice<const float> depth, rust::Slice<const float> alpha,
                   rust::Slice<float> adjoint, std::array<double, 3>& by_gain) {
  const std::size_t pixels = width * height;
  require(is_side(side) && state.size() == PLANES * PIXELS && adjoint.size() == PLANES * PIXELS &&
              (color.empty() || color.size() == 3 * pixels) && (depth.empty() || depth.size() == pixels) &&
              (alpha.empty() || alpha.size() == pixels),
          "tables of an image differ in length");
  const __m128 one = _mm_set1_ps(1.0f), zero = _mm_setzero_ps();
  // A slice asks Rust for its pointer each time; null where there is none.
  const float* const states = state.data();
  const float* const colors = color.empty() ? nullptr : color.data();
  const float* const depths = depth.empty() ? nullptr : depth.data();
  const float* const alphas = alpha.empty() ? nullptr : alpha.data();
  float* const out = adjoint.data();
  __m128d sums[3][2];
  for (auto& sum : sums) sum[0] = sum[1] = _mm_setzero_pd();
  for (std::size_t line = 0; line < side; ++line) {
    for (std::size_t piece = 0; piece < side / 4; ++piece) {
      const std::size_t p = place(piece, line), x = x0 + 4 * piece, y = y0 + line, o = y * width + x;
      float* a = out + p;
      if (x >= width || y >= height) {
        for (int k = 0; k < PLANES; ++k) _mm_storeu_ps(a + k * PIXELS, zero);
        continue;
      }
      const std::size_t count = width - x < 4 ? width - x : 4;
      const float* s = states + p;
      float room[12];
      const __m128 left = _mm_loadu_ps(s + 4 * PIXELS);
      __m128 behind = zero, by_left = zero, by_depth = zero;
      if (alphas) {
        const __m128 v = _mm_loadu_ps(padded<1>(alphas + o, count, room));
        by_left = _mm_sub_ps(zero, v);
      }
      if (colors) {
        __m128 rgb[3];
        part(padded<3>(colors + 3 * o, count, room), rgb);
        for (int k = 0; k < 3; ++k) {
          const __m128 v = _mm_mul_ps(rgb[k], _mm_set1_ps(gain[k])), plain = _mm_loadu_ps(s + k * PIXELS);
          const __m128 back = _mm_set1_ps(background[k]);
          const __m128 shown = _mm_mul_ps(rgb[k], _mm_add_ps(plain, _mm_mul_ps(left, back)));
          sums[k][0] = _mm_add_pd(sums[k][0], _mm_cvtps_pd(shown));
          sums[k][1] = _mm_add_pd(sums[k][1], _mm_cvtps_pd(_mm_movehl_ps(shown, shown)));
          _mm_storeu_ps(a + k * PIXELS, v);
          behind = _mm_add_ps(behind, _mm_mul_ps(v, plain));
          by_left = _mm_add_ps(by_left, _mm_mul_ps(v, back));
        }
      } else {
        for (int k = 0; k < 3; ++k) _mm_storeu_ps(a + k * PIXELS, zero);
      }
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
    // What the next tile will read: its lines are too short for the processor to see them coming.
    const bool wraps = x0 + side >= width;
    const std::size_t x = wraps ? 0 : x0 + side, top = wraps ? y0 + side : y0, bottom = std::min(height, top + side);
    for (std::size_t y = top; y < bottom; ++y)
      for (std::size_t k = 0; k < 3 * side; k += 16) __builtin_prefetch(colors + 3 * (y * width + x) + k);
  }
  for (int k = 0; k < PLANES * PIXELS; k += 16) __builtin_prefetch(states + PLANES * PIXELS + k);
  for (int k = 0; k < 3; ++k) {
    double two[2];
    _mm_storeu_pd(two, _mm_add_pd(sums[k][0], sums[k][1]));
    by_gain[k] += two[0] + two[1];
  }
}

}  // namespace respire

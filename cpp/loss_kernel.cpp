// L1 + SSIM with gradient in one sweep over the lines of an image, all three channels as they lie (red, green, blue by
// turns, so that a neighbour is three values away): lines are blurred across into rings of 16, down from there, turned
// into the derivatives of SSIM, and these blurred again. Four lines at a time: blurred down, they share most of what is
// loaded. The plain twin is src/reconstruct/loss/photometric.rs.
#include "cpp/loss_kernel.h"
#include "cpp/splat_lanes.h"

namespace respire {
namespace RESPIRE_ISA {
namespace {

constexpr int CHANNELS = 3, MAPS = 3, GROUP = 4, TAPS = 11, RADIUS = 5;
constexpr std::ptrdiff_t RING = 16;
constexpr std::size_t AHEAD = 256;  // values
constexpr float SSIM_C1 = 0.01f * 0.01f, SSIM_C2 = 0.03f * 0.03f;
static_assert(LOSS_MARGIN >= CHANNELS * RADIUS && LOSS_MARGIN >= LANES, "a window must not leave its line");
static_assert(GROUP + TAPS - 1 <= RING, "lines must last until they have been used");

// 16 lines of three maps, and the line of zeros beyond the image.
struct Ring {
  float* lines[MAPS][RING];
  const float* zeros;
  std::ptrdiff_t height;
  float* at(int map, std::ptrdiff_t y) const { return lines[map][y % RING]; }
  const float* line(int map, std::ptrdiff_t y) const { return y < 0 || y >= height ? zeros : at(map, y); }
};

// The first `count` values, the rest 0.
inline V load_first(const float* p, std::size_t count) {
  if (count >= static_cast<std::size_t>(LANES)) return load(p);
  V v{};
  __builtin_memcpy(&v, p, count * sizeof(float));
  return v;
}

inline void store_first(float* p, V v, std::size_t count) {
  if (count >= static_cast<std::size_t>(LANES)) return store(p, v);
  __builtin_memcpy(p, &v, count * sizeof(float));
}

#if defined(__AVX512F__)
// Values N.. of two vectors one after the other.
template <int N>
inline V beginning_at(V a, V b) {
  return (V)_mm512_alignr_epi32((__m512i)b, (__m512i)a, N);
}
#endif

struct Sweep {
  const LossBand& b;
  const std::size_t values, stride;  // of a line; of lines in the room
  const std::ptrdiff_t height, y0, y1;
  float* next;
  Ring first{}, second{};
  float *padded[GROUP][MAPS], *weight[GROUP], *l1_weight[GROUP];

  explicit Sweep(const LossBand& band)
      : b(band),
        values(CHANNELS * band.width),
        stride(loss_stride(band.width)),
        height(static_cast<std::ptrdiff_t>(band.height)),
        y0(static_cast<std::ptrdiff_t>(band.y0)),
        y1(static_cast<std::ptrdiff_t>(band.y1)) {
    const std::uintptr_t room = reinterpret_cast<std::uintptr_t>(band.room);
    next = band.room + (64 - room % 64) % 64 / sizeof(float);
    const float* zeros = take();
    Ring* const rings[2] = {&first, &second};
    for (Ring* ring : rings) {
      ring->zeros = zeros, ring->height = height;
      for (auto& map : ring->lines)
        for (float*& line : map) line = take();
    }
    for (auto& lines : padded)
      for (float*& line : lines) line = take();
    for (float*& line : weight) line = take();
    for (float*& line : l1_weight) line = take();
    for (int r = 0; r < GROUP && !b.mask; ++r) weigh(y0, r);
  }

  // A line of zeros, LOSS_MARGIN of them before it.
  float* take() {
    float* line = next + LOSS_MARGIN;
    for (std::size_t i = 0; i < stride; ++i) next[i] = 0;
    next += stride;
    return line;
  }

  // Weights of line `y` for SSIM and for L1, zero beyond the image.
  void weigh(std::ptrdiff_t y, int r) {
    const float ssim = b.ssim_weight, l1 = 1.0f - b.ssim_weight;
    for (std::size_t x = 0; x < b.width; ++x) {
      const float w = b.mask ? b.mask[b.width * y + x] * (1.0f / 3.0f) : b.uniform;
      for (int c = 0; c < CHANNELS; ++c) weight[r][CHANNELS * x + c] = ssim * w, l1_weight[r][CHANNELS * x + c] = l1 * w;
    }
  }

  // The window: a copy, because stores of other numbers might change the original for all that the compiler knows.
  struct Window {
    V weights[RADIUS + 1];
    explicit Window(const LossBand& b) {
      for (int i = 0; i <= RADIUS; ++i) weights[i] = all(b.window[i]);
    }
    template <class Tap>
    V over(Tap tap) const {
      V sum = weights[RADIUS] * tap(RADIUS);
      for (int i = 0; i < RADIUS; ++i) sum = fma(weights[i], tap(i) + tap(TAPS - 1 - i), sum);
      return sum;
    }
  };

  // A line blurred across, from and to all three maps.
  void across(const float* const* in, const Ring& ring, std::ptrdiff_t y) const {
    const Window window(b);
    for (int map = 0; map < MAPS; ++map) {
      const float* const line = in[map];
      float* const out = ring.at(map, y);
#if defined(__AVX512F__)
      // What lies before is put together from registers, what lies behind is loaded: half the work for either unit.
      V before = load(line - LANES), here = load(line);
      for (std::size_t x = 0; x < values; x += LANES) {
        V taps[TAPS] = {beginning_at<1>(before, here), beginning_at<4>(before, here), beginning_at<7>(before, here),
                        beginning_at<10>(before, here), beginning_at<13>(before, here), here};
        for (int i = RADIUS + 1; i < TAPS; ++i) taps[i] = load(line + x + CHANNELS * (i - RADIUS));
        store(out + x, window.over([&](int i) { return taps[i]; }));
        before = here, here = load(line + x + LANES);
      }
#else
      for (std::size_t x = 0; x < values; x += LANES)
        store(out + x, window.over([&](int i) { return load(line + static_cast<std::ptrdiff_t>(x) + CHANNELS * (i - RADIUS)); }));
#endif
    }
  }

  // The lines that GROUP lines from y on are blurred down from: found once per group.
  struct Columns {
    const float* lines[MAPS][GROUP + TAPS - 1];
    Columns(const Ring& ring, std::ptrdiff_t y) {
      for (int map = 0; map < MAPS; ++map)
        for (int i = 0; i < GROUP + TAPS - 1; ++i) lines[map][i] = ring.line(map, y + i - RADIUS);
    }
  };

  static void down(const Window& window, const Columns& columns, int map, std::size_t x, V* out) {
    V in[GROUP + TAPS - 1];
    for (int i = 0; i < GROUP + TAPS - 1; ++i) in[i] = load(columns.lines[map][i] + x);
    for (int r = 0; r < GROUP; ++r) out[r] = window.over([&](int i) { return in[r + i]; });
  }

  static double sum_of(V v) {
    double sum = 0;
    for (int l = 0; l < LANES; ++l) sum += static_cast<double>(v[l]);
    return sum;
  }

  double run() {
    double total = 0;
    if (!(b.ssim_weight > 0)) {
      for (std::ptrdiff_t y = y0; y < y1; y += GROUP) total += finish<false>(y);
      return total;
    }
    const auto least = [](std::ptrdiff_t a, std::ptrdiff_t c) { return a < c ? a : c; };
    const std::ptrdiff_t from = y0 < 2 * RADIUS ? 0 : y0 - 2 * RADIUS;
    for (std::ptrdiff_t y = from; y < y1 + 2 * RADIUS; y += GROUP) {
      for (std::ptrdiff_t line = y; line < least(y + GROUP, least(height, y1 + 2 * RADIUS)); ++line) read(line);
      const std::ptrdiff_t middle = y - RADIUS, last = y - 2 * RADIUS;
      if (middle + GROUP > 0 && middle + GROUP > y0 - RADIUS && middle < least(height, y1 + RADIUS)) total += derive(middle);
      if (last + GROUP > y0 && last < y1) total += finish<true>(last);
    }
    return total;
  }

  // The maps of a line, blurred across.
  void read(std::ptrdiff_t y) {
    const float *source = b.rendered + values * y, *target = b.target + values * y;
    for (std::size_t x = 0; x < values; x += LANES) {
      const V v = load_first(source + x, values - x), t = load_first(target + x, values - x);
      store(padded[0][0] + x, v);
      store(padded[0][1] + x, v * v);
      store(padded[0][2] + x, v * t);
    }
    across(padded[0], first, y);
  }

  // The derivatives of SSIM in the lines from y on, blurred across; returns what of the loss lies in the band.
  double derive(std::ptrdiff_t y) {
    const Columns columns(first, y);
    const Window window(b);
    V sums[GROUP];
    bool there[GROUP];
    for (int r = 0; r < GROUP; ++r) {
      sums[r] = V{};
      there[r] = y + r >= 0 && y + r < height;
      if (b.mask && there[r]) weigh(y + r, r);
    }
    for (std::size_t x = 0; x < values; x += LANES) {
      V mean[GROUP], square[GROUP], cross[GROUP];
      down(window, columns, 0, x, mean), down(window, columns, 1, x, square), down(window, columns, 2, x, cross);
      for (int r = 0; r < GROUP; ++r) {
        if (!there[r]) continue;
        const std::size_t at = values * static_cast<std::size_t>(y + r) + x;
        // Eight lines of numbers side by side are more than the processor follows by itself.
        __builtin_prefetch(b.mean + at + AHEAD), __builtin_prefetch(b.square + at + AHEAD);
        const V my = load_first(b.mean + at, values - x), yy = load_first(b.square + at, values - x);
        sums[r] += derivatives(mean[r], square[r], cross[r], my, yy, load(weight[r] + x), padded[r], x);
      }
    }
    double total = 0;
    for (int r = 0; r < GROUP; ++r) {
      if (!there[r]) continue;
      across(padded[r], second, y + r);
      if (y + r >= y0 && y + r < y1) total += sum_of(sums[r]);
    }
    return total;
  }

  // The weighted 1 - SSIM of LANES values; its derivatives by the three blurs go to `out`.
  static V derivatives(V mx, V xx, V xy, V my, V yy, V weight, float* const* out, std::size_t x) {
    const V w = -weight;
    const V a = 2.0f * mx * my + SSIM_C1, p = 2.0f * (xy - mx * my) + SSIM_C2;
    const V q = mx * mx + my * my + SSIM_C1, d = (xx - mx * mx) + (yy - my * my) + SSIM_C2;
    const V inverse = 1.0f / (q * d), s = a * p * inverse;
    store(out[0] + x, w * 2.0f * (my * (p - a) * inverse + mx * s * (q - d) * inverse));
    store(out[1] + x, -w * s * q * inverse);
    store(out[2] + x, w * 2.0f * a * inverse);
    return w * s - w;
  }

  template <bool WITH_SSIM>
  double finish(std::ptrdiff_t y) {
    switch (b.norm) {
      case Norm::CHARBONNIER: return finish<WITH_SSIM, Norm::CHARBONNIER>(y);
      case Norm::HUBER: return finish<WITH_SSIM, Norm::HUBER>(y);
      default: return finish<WITH_SSIM, Norm::L1>(y);
    }
  }

  // Weighted cost of LANES differences; their weighted slopes go to `slope`.
  template <Norm NORM>
  V cost(V d, V w, V* slope) const {
    const V sign = pick(d > 0.0f, w, pick(d < 0.0f, -w, V{}));
    const V e = all(b.softness);
    if (NORM == Norm::CHARBONNIER) {
      const V root = square_root(d * d + e * e);
      *slope = w * d / root;
      return w * d * d / (root + e);
    }
    if (NORM == Norm::HUBER) {
      const V size = pick(d < 0.0f, -d, d);
      const VI near = size < e;
      *slope = pick(near, w * d / e, sign);
      return w * pick(near, d * d / (e + e), size - 0.5f * e);
    }
    *slope = sign;
    return sign * d;
  }

  // The gradient of those of GROUP lines from y on that lie in the band; returns their L1, or what stands in its place.
  template <bool WITH_SSIM, Norm NORM>
  double finish(std::ptrdiff_t y) {
    const Columns columns(second, y);
    const Window window(b);
    V sums[GROUP];
    bool there[GROUP];
    for (int r = 0; r < GROUP; ++r) {
      sums[r] = V{};
      there[r] = y + r >= y0 && y + r < y1;
      if (b.mask && there[r]) weigh(y + r, r);
    }
    for (std::size_t x = 0; x < values; x += LANES) {
      V by_mean[GROUP], by_square[GROUP], by_cross[GROUP];
      if (WITH_SSIM) {
        down(window, columns, 0, x, by_mean), down(window, columns, 1, x, by_square), down(window, columns, 2, x, by_cross);
      }
      for (int r = 0; r < GROUP; ++r) {
        if (!there[r]) continue;
        const std::size_t at = values * static_cast<std::size_t>(y + r) + x, count = values - x;
        const V s = load_first(b.rendered + at, count), t = load_first(b.target + at, count);
        V g;
        sums[r] += cost<NORM>(s - t, load(l1_weight[r] + x), &g);
        if (WITH_SSIM) g += by_mean[r] + 2.0f * s * by_square[r] + t * by_cross[r];
        store_first(b.gradient + values * static_cast<std::size_t>(y + r - y0) + x, g, count);
      }
    }
    double total = 0;
    for (const V& sum : sums) total += sum_of(sum);
    return total;
  }
};

}  // namespace

double loss(const LossBand& band) { return Sweep(band).run(); }

}  // namespace RESPIRE_ISA
}  // namespace respire

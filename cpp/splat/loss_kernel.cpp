// L1 + SSIM with gradient in one sweep over the lines of an image, all three channels as they lie (red, green, blue by
// turns, so that a neighbour is three values away). A group of lines is blurred down from the image itself, across, turned
// into the derivatives of SSIM; these are kept in a ring of lines until the next group is there, blurred down and across
// the same way, and make the gradient. Two things decide about time: lines are blurred down in groups, which share most of
// what they load, since that comes from the second cache; and what is blurred down is blurred across a strip later, while
// it is in the first. The plain twin is src/reconstruct/loss/photometric.rs.
#include "cpp/splat/loss_kernel.h"
#include "cpp/splat/lanes.h"

namespace respire {
namespace RESPIRE_ISA {
namespace {

constexpr int CHANNELS = 3, MAPS = 3, GROUP = LOSS_GROUP, TAPS = 11, RADIUS = 5, RING = LOSS_RING;
constexpr std::size_t STRIP = 32 * LANES;  // values that are blurred down before they are blurred across
static_assert(STRIP > LOSS_MARGIN, "a strip must be longer than what lies behind");
constexpr float SSIM_C1 = 0.01f * 0.01f, SSIM_C2 = 0.03f * 0.03f;
static_assert(LOSS_MARGIN >= CHANNELS * RADIUS && LOSS_MARGIN >= LANES, "a window must not leave its line");
static_assert(2 * GROUP + TAPS - 1 <= RING, "lines must last until they have been used");

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

// Loops whose numbers must stay in registers.
#define INLINE __attribute__((always_inline)) inline
#define NOT_INLINE __attribute__((noinline))

struct Sweep {
  const LossBand& b;
  const std::size_t values, stride;  // of a line; of lines in the room
  const std::ptrdiff_t height, y0, y1;
  float* next;
  const float* zeros;
  float *ring[MAPS][RING], *padded[MAPS][GROUP], *weight[GROUP], *l1_weight[GROUP];

  explicit Sweep(const LossBand& band)
      : b(band),
        values(CHANNELS * band.width),
        stride(loss_stride(band.width)),
        height(static_cast<std::ptrdiff_t>(band.height)),
        y0(static_cast<std::ptrdiff_t>(band.y0)),
        y1(static_cast<std::ptrdiff_t>(band.y1)) {
    const std::uintptr_t room = reinterpret_cast<std::uintptr_t>(band.scratch);
    next = band.scratch + (64 - room % 64) % 64 / sizeof(float);
    zeros = take_zeros();
    for (auto& map : ring)
      for (float*& line : map) line = take();
    for (auto& map : padded)
      for (float*& line : map) line = take();
    // Without a mask all lines weigh the same.
    for (int r = 0; r < GROUP; ++r) weight[r] = r == 0 || b.mask ? take_zeros() : weight[0];
    for (int r = 0; r < GROUP; ++r) l1_weight[r] = r == 0 || b.mask ? take_zeros() : l1_weight[0];
    if (!b.mask) weigh(y0, 0);
  }

  // A line with zeros on either side.
  float* take() {
    float* const line = next + LOSS_MARGIN;
    next += stride;
    for (float* p = line - LOSS_MARGIN; p < line; ++p) *p = 0;
    for (float* p = line + values; p < next; ++p) *p = 0;
    return line;
  }
  // A line of zeros.
  float* take_zeros() {
    float* const line = take();
    for (std::size_t x = 0; x < values; ++x) line[x] = 0;
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
    INLINE V over(Tap tap) const {
      V sum = weights[RADIUS] * tap(RADIUS);
      for (int i = 0; i < RADIUS; ++i) sum = fma(weights[i], tap(i) + tap(TAPS - 1 - i), sum);
      return sum;
    }
  };

  // The lines that a group from y on is blurred down from: found once per group.
  struct Columns {
    const float* lines[GROUP + TAPS - 1];
    template <class Line>
    Columns(const Sweep& sweep, std::ptrdiff_t y, Line line) {
      for (int i = 0; i < GROUP + TAPS - 1; ++i) {
        const std::ptrdiff_t from = y + i - RADIUS;
        lines[i] = from < 0 || from >= sweep.height ? sweep.zeros : line(from);
      }
    }
  };

  // Values from x on of a group of lines blurred down; `in(i)` is those of line i.
  template <class In>
  INLINE void down(const Window& window, int map, std::size_t x, In in) const {
    V taps[GROUP + TAPS - 1];
#pragma GCC unroll 32
    for (int i = 0; i < GROUP + TAPS - 1; ++i) taps[i] = in(i);
#pragma GCC unroll 32
    for (int r = 0; r < GROUP; ++r) store(padded[map][r] + x, window.over([&](int i) { return taps[r + i]; }));
  }

  // Values `from` to `to` of the group: the three maps of SSIM from the lines of two images, blurred down.
  NOT_INLINE void maps_down(const Columns& source, const Columns& target, std::size_t from, std::size_t to) const {
    const Window window(b);
    for (std::size_t x = from; x < to; x += LANES) {
      const std::size_t left = values - x;
      const auto down_all = [&](auto s, auto t) {
        down(window, 0, x, s);
        down(window, 1, x, [&](int i) { return s(i) * s(i); });
        down(window, 2, x, [&](int i) { return s(i) * t(i); });
      };
      if (left >= static_cast<std::size_t>(LANES)) {
        down_all([&](int i) { return load(source.lines[i] + x); }, [&](int i) { return load(target.lines[i] + x); });
      } else {
        down_all([&](int i) { return load_first(source.lines[i] + x, left); },
                 [&](int i) { return load_first(target.lines[i] + x, left); });
      }
    }
  }

  // The same of the derivatives.
  NOT_INLINE void derivatives_down(const Columns* maps, std::size_t from, std::size_t to) const {
    const Window window(b);
    for (std::size_t x = from; x < to; x += LANES)
      for (int map = 0; map < MAPS; ++map) down(window, map, x, [&](int i) { return load(maps[map].lines[i] + x); });
  }

  // LANES values blurred across.
  INLINE static V across(const Window& window, const float* line) {
#if defined(__AVX512F__)
    // What lies before is put together from registers, what lies behind is loaded: half the work for either unit.
    const V before = load(line - LANES), here = load(line);
    V taps[TAPS] = {beginning_at<1>(before, here), beginning_at<4>(before, here), beginning_at<7>(before, here),
                    beginning_at<10>(before, here), beginning_at<13>(before, here), here};
    for (int i = RADIUS + 1; i < TAPS; ++i) taps[i] = load(line + CHANNELS * (i - RADIUS));
    return window.over([&](int i) { return taps[i]; });
#else
    return window.over([&](int i) { return load(line + CHANNELS * (i - RADIUS)); });
#endif
  }

  // Calls down(from, to) for all values of a line and later across(r, from, to) for those of each of the first `count` lines
  // of the group, strip by strip: what is blurred across lies a little behind, for its neighbours must be there.
  template <class Down, class Across>
  void strips(int count, Down down, Across across) const {
    std::size_t done = 0;
    for (std::size_t x = 0; done < values;) {
      const std::size_t end = x + STRIP < values ? x + STRIP : values;
      down(x, end), x = end;
      const std::size_t ready = end == values ? values : end - LOSS_MARGIN;
      for (int r = 0; r < count; ++r) across(r, done, ready);
      done = ready;
    }
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
    const std::ptrdiff_t needed = y1 + RADIUS < height ? y1 + RADIUS : height;
    std::ptrdiff_t derived = y0 < RADIUS ? 0 : y0 - RADIUS;
    for (std::ptrdiff_t y = y0; y < y1; y += GROUP) {
      for (; derived < needed && derived < y + GROUP + RADIUS; derived += GROUP) total += derive(derived, needed);
      total += finish<true>(y);
    }
    return total;
  }

  // The derivatives of SSIM in a group of lines from y on that ends before `needed`; returns what of the loss lies in the
  // band.
  double derive(std::ptrdiff_t y, std::ptrdiff_t needed) {
    const Columns source(*this, y, [&](std::ptrdiff_t at) { return b.rendered + values * at; });
    const Columns target(*this, y, [&](std::ptrdiff_t at) { return b.target + values * at; });
    const Window window(b);
    const int count = y + GROUP <= needed ? GROUP : static_cast<int>(needed - y);
    V sums[GROUP];
    for (int r = 0; r < GROUP; ++r) sums[r] = V{};
    for (int r = 0; r < count && b.mask; ++r) weigh(y + r, r);
    const auto blur_down = [&](std::size_t from, std::size_t to) { maps_down(source, target, from, to); };
    strips(count, blur_down, [&](int r, std::size_t from, std::size_t to) {
      const std::size_t line = values * static_cast<std::size_t>(y + r), place = static_cast<std::size_t>(y + r) % RING;
      const float *const mean = b.mean + line, *const square = b.square + line, *const weights = weight[r];
      const float* const in[MAPS] = {padded[0][r], padded[1][r], padded[2][r]};
      float* const out[MAPS] = {ring[0][place], ring[1][place], ring[2][place]};
      V sum{};
      for (std::size_t x = from; x < to; x += LANES) {
        __builtin_prefetch(mean + x + STRIP), __builtin_prefetch(square + x + STRIP);
        const V my = load_first(mean + x, values - x), yy = load_first(square + x, values - x);
        const V mx = across(window, in[0] + x), xx = across(window, in[1] + x), xy = across(window, in[2] + x);
        sum += derivatives(mx, xx, xy, my, yy, load(weights + x), out, x);
      }
      sums[r] += sum;
    });
    double total = 0;
    for (int r = 0; r < count; ++r)
      if (y + r >= y0 && y + r < y1) total += sum_of(sums[r]);
    return total;
  }

  // The weighted 1 - SSIM of LANES values; its derivatives by the three blurs go to `out`.
  INLINE static V derivatives(V mx, V xx, V xy, V my, V yy, V weight, float* const* out, std::size_t x) {
    const V w = -weight, w2 = w + w;
    const V product = mx * my, squares = fma(mx, mx, my * my);
    const V a = fma(all(2.0f), product, all(SSIM_C1)), p = fma(all(2.0f), xy - product, all(SSIM_C2));
    const V q = squares + SSIM_C1, d = (xx + yy - squares) + SSIM_C2;
    const V inverse = reciprocal(q * d), ap = a * p, s = ap * inverse, w_inverse = w2 * inverse;
    store(out[0] + x, w_inverse * fma(my, p - a, mx * s * (q - d)));
    store(out[1] + x, -w * s * q * inverse);
    store(out[2] + x, w_inverse * a);
    return fma(w, s, -w);
  }

  // The gradient of those of GROUP lines from y on that lie in the band; returns their weighted L1.
  template <bool WITH_SSIM>
  double finish(std::ptrdiff_t y) {
    const Window window(b);
    const int count = y + GROUP <= y1 ? GROUP : static_cast<int>(y1 - y);
    V sums[GROUP];
    for (int r = 0; r < GROUP; ++r) sums[r] = V{};
    for (int r = 0; r < count && b.mask; ++r) weigh(y + r, r);
    const auto write = [&](int r, std::size_t from, std::size_t to) {
      const std::size_t line = values * static_cast<std::size_t>(y + r);
      const float *const source = b.rendered + line, *const target = b.target + line, *const weights = l1_weight[r];
      const float* const in[MAPS] = {padded[0][r], padded[1][r], padded[2][r]};
      float* const out = b.gradient + values * static_cast<std::size_t>(y + r - y0);
      V sum{};
      for (std::size_t x = from; x < to; x += LANES) {
        const V s = load_first(source + x, values - x), t = load_first(target + x, values - x);
        // w |s - t| and its slope w sign(s - t).
        const V d = s - t, w = load(weights + x), sign = pick(d > 0.0f, w, pick(d < 0.0f, -w, V{}));
        sum += sign * d;
        V g = sign;
        if (WITH_SSIM) {
          const V by_square = across(window, in[1] + x), by_cross = across(window, in[2] + x);
          g += across(window, in[0] + x) + fma(s + s, by_square, t * by_cross);
        }
        store_first(out + x, g, values - x);
      }
      sums[r] += sum;
    };
    if (WITH_SSIM) {
      const Columns maps[MAPS] = {Columns(*this, y, [&](std::ptrdiff_t at) { return ring[0][at % RING]; }),
                                  Columns(*this, y, [&](std::ptrdiff_t at) { return ring[1][at % RING]; }),
                                  Columns(*this, y, [&](std::ptrdiff_t at) { return ring[2][at % RING]; })};
      const auto blur_down = [&](std::size_t from, std::size_t to) { derivatives_down(maps, from, to); };
      strips(count, blur_down, write);
    } else {
      for (int r = 0; r < count; ++r) write(r, 0, values);
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

// L1 + SSIM with gradient: (1 - w) |x - y| + w (1 - S), S after Wang et al. 2004 (Eq. 13). The plain twin, which gives
// the equations, is src/reconstruct/fitting/loss/photometric.rs. Compiled once per instruction set.
//
// One sweep over the lines of an image, with the three channels interleaved (so that a neighbour is three values
// away). A group of lines is blurred down (along columns) from the images themselves, then across (along lines), and
// turned into the derivatives of S by the three blurs. These are kept in a ring of lines until the next group is
// computed, are then blurred down and across in the same way, and give the gradient. Two choices determine the speed:
// lines are blurred down in groups, which share most of their loads from the second-level cache; and a strip that was
// blurred down is blurred across while it is still in the first-level cache.
#include "cpp/splat/loss_kernel.h"
#include "cpp/splat/lanes.h"

namespace respire {
namespace RESPIRE_ISA {
namespace {

constexpr int CHANNELS = 3, MAPS = 3, GROUP = LOSS_GROUP, TAPS = 11, RADIUS = 5, RING = LOSS_RING;
constexpr std::size_t STRIP = 512;  // values that are blurred down before they are blurred across
static_assert(STRIP % 16 == 0 && LOSS_MARGIN % 16 == 0, "strips must begin with the first of sixteen sums");
static_assert(STRIP > LOSS_MARGIN, "what is blurred across lies a margin behind what is blurred down");
// (K1 L)^2 and (K2 L)^2 of Wang et al. with L = 1.
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

// Sixteen sums, of the values x, x + 16, x + 32 and so on of a line: the same for every LANES.
struct Sixteen {
  V parts[PARTS] = {};

  // The sum that the values from `x` on belong to.
  V& at(std::size_t x) { return parts[x / LANES % PARTS]; }
  void operator+=(const Sixteen& other) {
    for (int p = 0; p < PARTS; ++p) parts[p] += other.parts[p];
  }
  double total() const {
    double sum = 0;
    for (const V& v : parts)
      for (int l = 0; l < LANES; ++l) sum += static_cast<double>(v[l]);
    return sum;
  }
};

#if defined(__AVX512F__)
// LANES values from number N on of two vectors one after the other.
template <int N>
inline V beginning_at(V a, V b) {
  return (V)_mm512_alignr_epi32((__m512i)b, (__m512i)a, N);
}
#endif

struct Sweep {
  const LossBand& b;
  const std::size_t values, stride;  // of a line; from line to line in the scratch
  const std::ptrdiff_t height, y0, y1;
  float* next;                 // free scratch
  const float* zeros;          // a line outside the image
  float* ring[MAPS][RING];     // derivatives of S by the three blurs, line y in place y % RING
  float* padded[MAPS][GROUP];  // lines of a group that are blurred down and not yet across
  float *weight[GROUP], *l1_weight[GROUP];

  explicit Sweep(const LossBand& band)
      : b(band),
        values(CHANNELS * band.width),
        stride(loss_stride(band.width)),
        height(static_cast<std::ptrdiff_t>(band.height)),
        y0(static_cast<std::ptrdiff_t>(band.y0)),
        y1(static_cast<std::ptrdiff_t>(band.y1)) {
    // From the next cache line on.
    const std::uintptr_t begin = reinterpret_cast<std::uintptr_t>(band.scratch);
    next = band.scratch + (64 - begin % 64) % 64 / sizeof(float);
    zeros = allocate_zeros();
    for (auto& map : ring)
      for (float*& line : map) line = allocate_line();
    for (auto& map : padded)
      for (float*& line : map) line = allocate_line();
    // Without a mask all lines weigh the same.
    for (int r = 0; r < GROUP; ++r) weight[r] = r == 0 || b.mask ? allocate_zeros() : weight[0];
    for (int r = 0; r < GROUP; ++r) l1_weight[r] = r == 0 || b.mask ? allocate_zeros() : l1_weight[0];
    if (!b.mask) fill_weights(y0, 0);
  }

  // Room for a line, with zeros on either side.
  float* allocate_line() {
    float* const line = next + LOSS_MARGIN;
    next += stride;
    for (float* p = line - LOSS_MARGIN; p < line; ++p) *p = 0;
    for (float* p = line + values; p < next; ++p) *p = 0;
    return line;
  }
  // A line of zeros.
  float* allocate_zeros() {
    float* const line = allocate_line();
    for (std::size_t x = 0; x < values; ++x) line[x] = 0;
    return line;
  }

  // Weights of line `y` for SSIM and for L1, zero beyond the image.
  void fill_weights(std::ptrdiff_t y, int r) {
    const float ssim = b.ssim_weight, l1 = 1.0f - b.ssim_weight;
    for (std::size_t x = 0; x < b.width; ++x) {
      const float w = b.mask ? b.mask[b.width * y + x] * (1.0f / 3.0f) : b.uniform;
      for (int c = 0; c < CHANNELS; ++c)
        weight[r][CHANNELS * x + c] = ssim * w, l1_weight[r][CHANNELS * x + c] = l1 * w;
    }
  }

  // The taps in registers: a copy, because the compiler must assume that stores of other numbers change the original.
  struct Window {
    V weights[RADIUS + 1];
    explicit Window(const LossBand& b) {
      for (int i = 0; i <= RADIUS; ++i) weights[i] = broadcast(b.window[i]);
    }
    template <class Tap>
    [[gnu::always_inline]] inline V over(Tap tap) const {
      V sum = weights[RADIUS] * tap(RADIUS);
      for (int i = 0; i < RADIUS; ++i) sum = fma(weights[i], tap(i) + tap(TAPS - 1 - i), sum);
      return sum;
    }
  };

  // Addresses of the lines that a group from y on is blurred down from.
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

  // Blurs LANES values of a group of lines down; `in(i)` gives those of line i. (Inlined and unrolled, so that the
  // taps stay in registers.)
  template <class In>
  [[gnu::always_inline]] inline void blur_down(const Window& window, int map, std::size_t x, In in) const {
    V taps[GROUP + TAPS - 1];
#pragma GCC unroll 32
    for (int i = 0; i < GROUP + TAPS - 1; ++i) taps[i] = in(i);
#pragma GCC unroll 32
    for (int r = 0; r < GROUP; ++r) store(padded[map][r] + x, window.over([&](int i) { return taps[r + i]; }));
  }

  // Blurs values `from` to `to` of a group down: x, x^2 and x y of the lines of two images.
  [[gnu::noinline]] void blur_maps_down(const Columns& source, const Columns& target, std::size_t from,
                                        std::size_t to) const {
    const Window window(b);
    for (std::size_t x = from; x < to; x += LANES) {
      const std::size_t left = values - x;
      const auto down_all = [&](auto s, auto t) {
        blur_down(window, 0, x, s);
        blur_down(window, 1, x, [&](int i) { return s(i) * s(i); });
        blur_down(window, 2, x, [&](int i) { return s(i) * t(i); });
      };
      if (left >= static_cast<std::size_t>(LANES)) {
        down_all([&](int i) { return load(source.lines[i] + x); }, [&](int i) { return load(target.lines[i] + x); });
      } else {
        down_all([&](int i) { return load_first(source.lines[i] + x, left); },
                 [&](int i) { return load_first(target.lines[i] + x, left); });
      }
    }
  }

  // The same of the three derivatives.
  [[gnu::noinline]] void blur_derivatives_down(const Columns* maps, std::size_t from, std::size_t to) const {
    const Window window(b);
    for (std::size_t x = from; x < to; x += LANES)
      for (int map = 0; map < MAPS; ++map)
        blur_down(window, map, x, [&](int i) { return load(maps[map].lines[i] + x); });
  }

  // LANES values blurred across.
  [[gnu::always_inline]] static inline V blur_across(const Window& window, const float* line) {
#if defined(__AVX512F__)
    // What lies before is put together from registers, what lies behind is loaded: half the work for either unit.
    const V before = load(line - LANES), here = load(line);
    V taps[TAPS] = {beginning_at<1>(before, here),  beginning_at<4>(before, here),  beginning_at<7>(before, here),
                    beginning_at<10>(before, here), beginning_at<13>(before, here), here};
    for (int i = RADIUS + 1; i < TAPS; ++i) taps[i] = load(line + CHANNELS * (i - RADIUS));
    return window.over([&](int i) { return taps[i]; });
#else
    return window.over([&](int i) { return load(line + CHANNELS * (i - RADIUS)); });
#endif
  }

  // Strip by strip, calls down(from, to) for all values of a line and later across(r, from, to) for those of each of
  // the first `count` lines of the group. Blurring across stays a margin behind, since it reads neighbours on both
  // sides.
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

  // Loss of the lines of the band; fills their gradient.
  double run() {
    double total = 0;
    if (!(b.ssim_weight > 0)) {
      for (std::ptrdiff_t y = y0; y < y1; y += GROUP) total += gradient_of_group<false>(y);
      return total;
    }
    // The gradient of a line takes the derivatives of RADIUS lines on either side.
    const std::ptrdiff_t needed = y1 + RADIUS < height ? y1 + RADIUS : height;
    std::ptrdiff_t derived = y0 < RADIUS ? 0 : y0 - RADIUS;
    for (std::ptrdiff_t y = y0; y < y1; y += GROUP) {
      for (; derived < needed && derived < y + GROUP + RADIUS; derived += GROUP)
        total += ssim_of_group(derived, needed);
      total += gradient_of_group<true>(y);
    }
    return total;
  }

  // Puts the derivatives of S for a group of lines from y on, up to `needed`, into the ring; returns the weighted sum
  // of 1 - S over those that lie in the band.
  double ssim_of_group(std::ptrdiff_t y, std::ptrdiff_t needed) {
    const Columns source(*this, y, [&](std::ptrdiff_t at) { return b.rendered + values * at; });
    const Columns target(*this, y, [&](std::ptrdiff_t at) { return b.target + values * at; });
    const Window window(b);
    const int count = y + GROUP <= needed ? GROUP : static_cast<int>(needed - y);
    Sixteen sums[GROUP];
    for (int r = 0; r < count && b.mask; ++r) fill_weights(y + r, r);
    const auto blur = [&](std::size_t from, std::size_t to) { blur_maps_down(source, target, from, to); };
    strips(count, blur, [&](int r, std::size_t from, std::size_t to) {
      const std::size_t line = values * static_cast<std::size_t>(y + r), place = static_cast<std::size_t>(y + r) % RING;
      const float *const mean = b.mean + line, *const square = b.square + line, *const weights = weight[r];
      const float* const in[MAPS] = {padded[0][r], padded[1][r], padded[2][r]};
      float* const out[MAPS] = {ring[0][place], ring[1][place], ring[2][place]};
      Sixteen sum;
      for (std::size_t x = from; x < to; x += LANES) {
        __builtin_prefetch(mean + x + STRIP), __builtin_prefetch(square + x + STRIP);
        const V my = load_first(mean + x, values - x), yy = load_first(square + x, values - x);
        const V mx = blur_across(window, in[0] + x), xx = blur_across(window, in[1] + x),
                xy = blur_across(window, in[2] + x);
        sum.at(x) += ssim_derivatives(mx, xx, xy, my, yy, load(weights + x), out, x);
      }
      sums[r] += sum;
    });
    double total = 0;
    for (int r = 0; r < count; ++r)
      if (y + r >= y0 && y + r < y1) total += sums[r].total();
    return total;
  }

  // Weighted 1 - S of LANES values; its derivatives by mx, xx and xy go to `out`. With a = 2 mx my + C1, p = 2 sxy +
  // C2, q = mx^2 + my^2 + C1, d = sx + sy + C2: S = a p / (q d).
  [[gnu::always_inline]] static inline V ssim_derivatives(V mx, V xx, V xy, V my, V yy, V weight, float* const* out,
                                                          std::size_t x) {
    const V w = -weight, w2 = w + w;  // of S
    const V product = mx * my, squares = fma(mx, mx, my * my);
    const V a = fma(broadcast(2.0f), product, broadcast(SSIM_C1)),
            p = fma(broadcast(2.0f), xy - product, broadcast(SSIM_C2));
    const V q = squares + SSIM_C1, d = (xx + yy - squares) + SSIM_C2;
    const V inverse = reciprocal(q * d), ap = a * p, s = ap * inverse, w_inverse = w2 * inverse;
    store(out[0] + x, w_inverse * fma(my, p - a, mx * s * (q - d)));
    store(out[1] + x, -w * s * q * inverse);
    store(out[2] + x, w_inverse * a);
    return fma(w, s, -w);
  }

  // The gradient of those of GROUP lines from y on that lie in the band; returns their weighted L1.
  template <bool WITH_SSIM>
  double gradient_of_group(std::ptrdiff_t y) {
    const Window window(b);
    const int count = y + GROUP <= y1 ? GROUP : static_cast<int>(y1 - y);
    Sixteen sums[GROUP];
    for (int r = 0; r < count && b.mask; ++r) fill_weights(y + r, r);
    const auto write = [&](int r, std::size_t from, std::size_t to) {
      const std::size_t line = values * static_cast<std::size_t>(y + r);
      const float *const source = b.rendered + line, *const target = b.target + line, *const weights = l1_weight[r];
      const float* const in[MAPS] = {padded[0][r], padded[1][r], padded[2][r]};
      float* const out = b.gradient + values * static_cast<std::size_t>(y + r - y0);
      Sixteen sum;
      for (std::size_t x = from; x < to; x += LANES) {
        const V s = load_first(source + x, values - x), t = load_first(target + x, values - x);
        // w |s - t| and its slope w sign(s - t).
        const V d = s - t, w = load(weights + x), sign = select(d > 0.0f, w, select(d < 0.0f, -w, V{}));
        sum.at(x) += sign * d;
        V g = sign;
        if (WITH_SSIM) {
          const V by_square = blur_across(window, in[1] + x), by_cross = blur_across(window, in[2] + x);
          g += blur_across(window, in[0] + x) + fma(s + s, by_square, t * by_cross);
        }
        store_first(out + x, g, values - x);
      }
      sums[r] += sum;
    };
    if (WITH_SSIM) {
      const Columns maps[MAPS] = {Columns(*this, y, [&](std::ptrdiff_t at) { return ring[0][at % RING]; }),
                                  Columns(*this, y, [&](std::ptrdiff_t at) { return ring[1][at % RING]; }),
                                  Columns(*this, y, [&](std::ptrdiff_t at) { return ring[2][at % RING]; })};
      const auto blur = [&](std::size_t from, std::size_t to) { blur_derivatives_down(maps, from, to); };
      strips(count, blur, write);
    } else {
      for (int r = 0; r < count; ++r) write(r, 0, values);
    }
    double total = 0;
    for (const Sixteen& sum : sums) total += sum.total();
    return total;
  }
};

}  // namespace

double loss(const LossBand& band) { return Sweep(band).run(); }

}  // namespace RESPIRE_ISA
}  // namespace respire

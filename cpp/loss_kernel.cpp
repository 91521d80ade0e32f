// L1 + SSIM with gradient in one sweep over the lines of an image, all three channels: lines are blurred across into
// rings of 16, down from there, turned into the derivatives of SSIM, and these blurred again, so that nothing but the
// images themselves leaves the nearest caches. The plain twin is src/reconstruct/loss/photometric.rs.
#include "cpp/loss_kernel.h"
#include "cpp/splat_lanes.h"

namespace respire {
namespace RESPIRE_ISA {
namespace {

constexpr std::size_t RADIUS = 5, RING = 16;
constexpr float SSIM_C1 = 0.01f * 0.01f, SSIM_C2 = 0.03f * 0.03f;

// 16 lines of three maps, and the line of zeros beyond the image.
struct Ring {
  float* lines[3][RING];
  const float* zeros;
  std::size_t height;
  const float* line(int map, std::ptrdiff_t y) const {
    return y < 0 || y >= static_cast<std::ptrdiff_t>(height) ? zeros : lines[map][y % RING];
  }
};

struct Sweep {
  const LossBand& b;
  std::size_t stride;
  float* next;

  float* take() {
    float* line = next;
    next += stride;
    for (std::size_t i = 0; i < stride; ++i) line[i] = 0;
    return line;
  }

  template <class Tap>
  V window(Tap tap) const {
    V sum = all(b.window[5]) * tap(5);
    for (int i = 0; i < 5; ++i) sum = fma(all(b.window[i]), tap(i) + tap(10 - i), sum);
    return sum;
  }

  // `in` begins RADIUS values before the line.
  void across(const float* in, float* out) const {
    for (std::size_t x = 0; x < b.width; x += LANES) store(out + x, window([&](int i) { return load(in + x + i); }));
  }

  // The eleven lines around y of each map: found once per line.
  struct Column {
    const float* lines[3][11];
    Column(const Ring& ring, std::ptrdiff_t y) {
      for (int map = 0; map < 3; ++map)
        for (int i = 0; i < 11; ++i) lines[map][i] = ring.line(map, y + i - 5);
    }
  };

  V down(const Column& column, int map, std::size_t x) const {
    return window([&](int i) { return load(column.lines[map][i] + x); });
  }

  static double sum_of(V v) {
    double sum = 0;
    for (int l = 0; l < LANES; ++l) sum += static_cast<double>(v[l]);
    return sum;
  }

  double channel(int c) {
    const std::size_t w = b.width, n = w * b.height;
    const std::ptrdiff_t h = static_cast<std::ptrdiff_t>(b.height);
    const std::ptrdiff_t y0 = static_cast<std::ptrdiff_t>(b.y0), y1 = static_cast<std::ptrdiff_t>(b.y1);
    Ring first{}, second{};
    float *source[RING], *target[RING], *padded[3];
    const float* zeros = take();
    Ring* const rings[2] = {&first, &second};
    for (Ring* ring : rings) {
      ring->zeros = zeros, ring->height = b.height;
      for (auto& map : ring->lines)
        for (float*& line : map) line = take();
    }
    for (std::size_t i = 0; i < RING; ++i) source[i] = take(), target[i] = take();
    for (float*& line : padded) line = take();
    float *mean = take(), *square = take(), *weight = take(), *l1_weight = take();
    const bool with_ssim = b.ssim_weight > 0;
    if (!b.mask) weights(y0, b.ssim_weight, weight), weights(y0, 1.0f - b.ssim_weight, l1_weight);
    double total = 0;
    const std::ptrdiff_t from = y0 - 10 < 0 ? 0 : y0 - 10;
    for (std::ptrdiff_t y = from; y < y1 + 10; ++y) {
      if (y < h) {
        float *s = source[y % RING], *t = target[y % RING];
        const float* rgb = b.rendered + 3 * w * y + c;
        for (std::size_t x = 0; x < w; ++x) s[x] = rgb[3 * x];
        __builtin_memcpy(t, b.target + c * n + w * y, w * sizeof(float));
        if (with_ssim) {
          for (std::size_t x = 0; x < w; x += LANES) {
            const V v = load(s + x);
            store(padded[0] + RADIUS + x, v);
            store(padded[1] + RADIUS + x, v * v);
            store(padded[2] + RADIUS + x, v * load(t + x));
          }
          for (int m = 0; m < 3; ++m) across(padded[m], first.lines[m][y % RING]);
        }
      }
      const std::ptrdiff_t middle = y - 5;
      if (with_ssim && middle >= 0 && middle < h && middle >= y0 - 5 && middle < y1 + 5) {
        if (b.mask) weights(middle, b.ssim_weight, weight);
        __builtin_memcpy(mean, b.mean + c * n + w * middle, w * sizeof(float));
        __builtin_memcpy(square, b.square + c * n + w * middle, w * sizeof(float));
        V sum{};
        const Column column(first, middle);
        for (std::size_t x = 0; x < w; x += LANES) sum += derivatives(column, x, mean, square, weight, padded);
        if (middle >= y0 && middle < y1) total += sum_of(sum);
        for (int m = 0; m < 3; ++m) across(padded[m], second.lines[m][middle % RING]);
      }
      const std::ptrdiff_t last = y - 10;
      if (last >= y0 && last < y1) {
        if (b.mask) weights(last, 1.0f - b.ssim_weight, l1_weight);
        const float *s = source[last % RING], *t = target[last % RING];
        total += with_ssim ? finish<true>(second, last, c, s, t, l1_weight) : finish<false>(second, last, c, s, t, l1_weight);
      }
    }
    return total;
  }

  // Weights of a line times `part`, zero beyond the image.
  void weights(std::ptrdiff_t y, float part, float* out) const {
    for (std::size_t x = 0; x < b.width; ++x) {
      out[x] = part * (b.mask ? b.mask[b.width * y + x] * (1.0f / 3.0f) : b.uniform);
    }
  }

  // The weighted 1 - SSIM of LANES pixels; its derivatives by the three blurs go to `out`.
  V derivatives(const Column& column, std::size_t x, const float* mean, const float* square, const float* weight,
                float* const* out) const {
    const V mx = down(column, 0, x), xx = down(column, 1, x), xy = down(column, 2, x);
    const V my = load(mean + x), w = -load(weight + x);
    const V a = 2.0f * mx * my + SSIM_C1, p = 2.0f * (xy - mx * my) + SSIM_C2;
    const V q = mx * mx + my * my + SSIM_C1, d = (xx - mx * mx) + (load(square + x) - my * my) + SSIM_C2;
    const V inverse = 1.0f / (q * d), s = a * p * inverse;
    store(out[0] + RADIUS + x, w * 2.0f * (my * (p - a) * inverse + mx * s * (q - d) * inverse));
    store(out[1] + RADIUS + x, -w * s * q * inverse);
    store(out[2] + RADIUS + x, w * 2.0f * a * inverse);
    return w * s - w;
  }

  template <bool WITH_SSIM>
  double finish(const Ring& ring, std::ptrdiff_t y, int c, const float* source, const float* target, const float* weight) const {
    switch (b.norm) {
      case Norm::CHARBONNIER: return finish<WITH_SSIM, Norm::CHARBONNIER>(ring, y, c, source, target, weight);
      case Norm::HUBER: return finish<WITH_SSIM, Norm::HUBER>(ring, y, c, source, target, weight);
      default: return finish<WITH_SSIM, Norm::L1>(ring, y, c, source, target, weight);
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

  // The gradient of a line; returns its L1, or what stands in its place.
  template <bool WITH_SSIM, Norm NORM>
  double finish(const Ring& ring, std::ptrdiff_t y, int c, const float* source, const float* target, const float* weight) const {
    const Column column(ring, y);
    float* out = b.gradient + 3 * b.width * (y - static_cast<std::ptrdiff_t>(b.y0)) + c;
    V sum{};
    for (std::size_t x = 0; x < b.width; x += LANES) {
      const V s = load(source + x), t = load(target + x), w = load(weight + x), d = s - t;
      V g;
      sum += cost<NORM>(d, w, &g);
      if (WITH_SSIM) g += down(column, 0, x) + 2.0f * s * down(column, 1, x) + t * down(column, 2, x);
      const std::size_t count = b.width - x < LANES ? b.width - x : LANES;
      alignas(64) float lanes[LANES];
      store(lanes, g);
      if (count == LANES) {
        for (std::size_t l = 0; l < LANES; ++l) out[3 * (x + l)] = lanes[l];
      } else {
        for (std::size_t l = 0; l < count; ++l) out[3 * (x + l)] = lanes[l];
      }
    }
    return sum_of(sum);
  }
};

}  // namespace

double loss(const LossBand& band) {
  double total = 0;
  for (int c = 0; c < 3; ++c) {
    Sweep sweep{band, loss_stride(band.width), band.room};
    total += sweep.channel(c);
  }
  return total;
}

}  // namespace RESPIRE_ISA
}  // namespace respire

// Compositing of one tile of exact discs, forward and backward, after 2D Gaussian splatting (Huang et al. 2024, Eqs.
// 8 to 11); compiled once per instruction set. The plain twin is src/splat/plain/disc_tile.rs; src/splat/plain/disc.rs
// explains the symbols:
//
//   s = P.d / N.d,  u = Q.d / N.d,  depth = N.t d_z / N.d,  alpha = min(0.99, o exp(-(s^2 + u^2) / 2))
//
// or, where it is larger, the alpha of a screen filter around the centre. Blocks, lists and the running transmittance
// are those of kernel.cpp. Left out: velocities.
#include "cpp/splat/kernel.h"
#include "cpp/splat/lanes.h"

namespace respire {
namespace RESPIRE_ISA {
namespace {

// The pixels of a tile block by block: centres and rays. Pixels outside the image get a ray straight ahead; what is
// computed for them is never read.
struct Rays {
  alignas(64) float x[PIXELS], y[PIXELS], ray[3][PIXELS];

  explicit Rays(const DiscTile& t) {
    for (int block = 0; block < 16; ++block) {
      for (int i = 0; i < 16; ++i) {
        const int p = 16 * block + i;
        const std::uint32_t column = t.x + 4 * (block >> 2) + i % 4, line = t.y + 4 * (block & 3) + i / 4;
        x[p] = static_cast<float>(column) + 0.5f, y[p] = static_cast<float>(line) + 0.5f;
        const bool inside = column < t.width && line < t.height;
        const float* r = t.rays + 3 * (static_cast<std::size_t>(line) * t.width + column);
        for (int k = 0; k < 3; ++k) ray[k][p] = inside ? r[k] : (k == 2 ? 1.0f : 0.0f);
      }
    }
  }
};

// Half of log2(e): exp(-q / 2) = 2^(-HALF_LOG2_E q).
constexpr float HALF_LOG2_E = 0.72134752044448170f;
// Squared distance in standard deviations of a ray that misses the plane where there is no filter: its alpha is 0.
constexpr float MISSED = 1e9f;

// U vectors of pixels, each with a disc of its own: where the rays meet the disc's plane, and alpha before the clamp
// (`raw`, 0 below ALPHA_MIN). `s`, `u` and `over` = 1 / N.d are 0 where the screen filter replaces the plane.
template <int U>
struct DiscSamples {
  V dx[U], dy[U], tx[U], ty[U], rx[U], ry[U], rz[U], over[U], s[U], u[U], square[U], depth[U], raw[U];
  VI hit[U];

  DiscSamples(const DiscTile& t, const Rays& rays, const std::uint32_t* splats, const int* pixels) {
    const float *q[U], *d[U];
    for (int k = 0; k < U; ++k) {
      q[k] = t.rows + 16 * static_cast<std::size_t>(splats[k]),
      d[k] = t.discs + 16 * static_cast<std::size_t>(splats[k]);
      rx[k] = load(rays.ray[0] + pixels[k]), ry[k] = load(rays.ray[1] + pixels[k]),
      rz[k] = load(rays.ray[2] + pixels[k]);
      dx[k] = load(rays.x + pixels[k]) - broadcast(q[k][X]), dy[k] = load(rays.y + pixels[k]) - broadcast(q[k][Y]);
    }
    // The ray's offset from that of the centre, d - t d_z / t_z, and 1 / N.d.
    for (int k = 0; k < U; ++k) {
      if (t.pinhole) {
        tx[k] = dx[k] * broadcast(t.per_px[0]), ty[k] = dy[k] * broadcast(t.per_px[1]);
      } else {
        tx[k] = fnma(broadcast(d[k][DISC_SLOPE]), rz[k], rx[k]),
        ty[k] = fnma(broadcast(d[k][DISC_SLOPE + 1]), rz[k], ry[k]);
      }
      over[k] = 1.0f / fma(broadcast(d[k][DISC_N]), rx[k],
                           fma(broadcast(d[k][DISC_N + 1]), ry[k], broadcast(d[k][DISC_N + 2]) * rz[k]));
    }
    // Intersection with the plane; the filter counts where it is missed, behind the near plane or farther off.
    for (int k = 0; k < U; ++k) {
      s[k] = fma(broadcast(d[k][DISC_P]), tx[k], broadcast(d[k][DISC_P + 1]) * ty[k]) * over[k];
      u[k] = fma(broadcast(d[k][DISC_Q]), tx[k], broadcast(d[k][DISC_Q + 1]) * ty[k]) * over[k];
      square[k] = fma(s[k], s[k], u[k] * u[k]);
      depth[k] = broadcast(d[k][DISC_HEIGHT]) * rz[k] * over[k];
      hit[k] = (depth[k] >= broadcast(t.near)) & finite(square[k]);
      V distance = broadcast(MISSED);
      if (t.filter > 0.0f) {
        distance = fma(dx[k], dx[k], dy[k] * dy[k]) * broadcast(t.filter);
        hit[k] &= square[k] <= distance;
      }
      distance = select(hit[k], square[k], distance);
      raw[k] = fnma(broadcast(HALF_LOG2_E), distance, broadcast(q[k][LOG2_OPACITY]));
      depth[k] = select(hit[k], depth[k], broadcast(q[k][DEPTH]));
      s[k] = keep(hit[k], s[k]), u[k] = keep(hit[k], u[k]), over[k] = keep(hit[k], over[k]);
      square[k] = keep(hit[k], square[k]);
    }
    exp2<U>(raw);
    for (int k = 0; k < U; ++k) raw[k] = keep_ge(raw[k], broadcast(ALPHA_MIN), raw[k]);
  }
};

// The blocks of the tile that have pixel centres in the disc's box: those whose middle is no further from it than 1.5
// px, the distance of the outermost pixel centres.
inline std::uint32_t blocks_of(const DiscTile& t, const float* d) {
  std::uint32_t columns = 0, lines = 0;
  for (int b = 0; b < 4; ++b) {
    const float x = static_cast<float>(t.x + 4 * b + 2), y = static_cast<float>(t.y + 4 * b + 2);
    columns |= static_cast<std::uint32_t>(x >= d[DISC_LOW] - 1.5f && x <= d[DISC_HIGH] + 1.5f) << (4 * b);
    lines |= static_cast<std::uint32_t>(y >= d[DISC_LOW + 1] - 1.5f && y <= d[DISC_HIGH + 1] + 1.5f) << b;
  }
  return columns * lines;
}

// LANES pixels of a block; see `PixelLanes` of kernel.cpp.
struct PixelLanes {
  V sums[4], transmittance, running;

  void blend(const float* q, V raw, V depth) {
    const V a = min(raw, broadcast(ALPHA_MAX)), next = fnma(a, running, running), stop = broadcast(STOP);
    const V weight = keep_gt(next, stop, a * running);
    transmittance = select_gt(next, stop, next, transmittance);
    running = next;
    for (int c = 0; c < 3; ++c) sums[c] = fma(weight, broadcast(q[RED + c]), sums[c]);
    sums[3] = fma(weight, depth, sums[3]);
  }
};

// Vectors of pixels whose alphas are evaluated side by side: fewer than in kernel.cpp, since each has a dozen
// values.
constexpr int INTERLEAVED = PARTS > 2 ? PARTS : 2;

// Blends E entries over one block.
template <int E>
void blend_entries(const DiscTile& t, const Rays& rays, int block, const std::uint32_t* entries, PixelLanes* pixels) {
  constexpr int U = E * PARTS;
  std::uint32_t splats[U];
  int places[U];
  for (int k = 0; k < U; ++k) splats[k] = entries[k / PARTS], places[k] = 16 * block + LANES * (k % PARTS);
  const DiscSamples<U> samples(t, rays, splats, places);
  for (int k = 0; k < U; ++k)
    pixels[k % PARTS].blend(t.rows + 16 * static_cast<std::size_t>(splats[k]), samples.raw[k], samples.depth[k]);
}

// Composites one block over one list; false once all its pixels have stopped.
bool composite(const DiscTile& t, const Rays& rays, int block, const std::uint32_t* list, int count,
               PixelLanes* pixels) {
  constexpr int E = INTERLEAVED / PARTS;
  static_assert(8 % E == 0, "every eight entries it is tested whether all pixels have stopped");
  PixelLanes own[PARTS];
  for (int k = 0; k < PARTS; ++k) own[k] = pixels[k];
  const auto alive = [&own] {
    bool goes_on = false;
    for (const PixelLanes& p : own) goes_on |= any(keep_gt(p.running, broadcast(STOP), p.running));
    return goes_on;
  };
  bool goes_on = true;
  int j = 0;
  for (; goes_on && j + E <= count; j += E) {
    blend_entries<E>(t, rays, block, list + j, own);
    if ((j + E) % 8 == 0) goes_on = alive();
  }
  for (; goes_on && j < count; ++j) blend_entries<1>(t, rays, block, list + j, own);
  for (int k = 0; k < PARTS; ++k) pixels[k] = own[k];
  return alive();
}

// As in kernel.cpp up to v = dL/d log(alpha); from there (src/splat/plain/disc_tile.rs), where the plane is hit,
//
//   p = P.d:  dL/dp = -v s / w,   q = Q.d:  dL/dq = -v u / w
//   w = N.d:  dL/dw = v (s^2 + u^2) / w - (dL/d depth) depth / w
//
// summed over the pixels with their rays, and where the filter counts v dx, v dy.
template <bool WITH_GEOMETRY, bool WITH_COLOR, bool WITH_Z>
void backward_tile(const DiscTile& t, const float* adjoint, float* out) {
  constexpr int ROOM = (DISC_SUMS + 3) / 4 * 4;
  const Rays rays(t);
  alignas(64) float running[PIXELS], behind[PIXELS];
  for (float& v : running) v = 1;
  __builtin_memcpy(behind, adjoint + 4 * PIXELS, sizeof behind);
  const float *vr = adjoint, *vg = vr + PIXELS, *vb = vg + PIXELS, *vz = vb + PIXELS;
  const V stop = broadcast(STOP);
  std::uint32_t alive = ALL_BLOCKS;
  for (std::size_t e = 0; e < t.count; ++e) {
    const std::uint32_t splat = t.entries[e];
    const float* q = t.rows + 16 * static_cast<std::size_t>(splat);
    const float* d = t.discs + 16 * static_cast<std::size_t>(splat);
    // Part by part, so that they are taken in the same order for every LANES.
    V all[PARTS][ROOM] = {};
    for (std::uint32_t todo = blocks_of(t, d) & alive; todo; todo &= todo - 1) {
      const int block = __builtin_ctz(todo);
      std::uint32_t splats[PARTS];
      int places[PARTS];
      for (int k = 0; k < PARTS; ++k) splats[k] = splat, places[k] = 16 * block + LANES * k;
      const DiscSamples<PARTS> o(t, rays, splats, places);
      bool goes_on = false;
      for (int k = 0; k < PARTS; ++k) {
        V* const sums = all[k];
        // The forward pass again.
        const int p = places[k];
        const V a = min(o.raw[k], broadcast(ALPHA_MAX)), now = load(running + p), next = fnma(a, now, now);
        const V weight = keep_gt(next, stop, a * now);
        const V still_running = keep_gt(next, stop, next);
        store(running + p, still_running);
        goes_on |= any(still_running);
        const V r = load(vr + p), g = load(vg + p), b = load(vb + p);
        if (WITH_COLOR) {
          sums[SUM_RED] = fma(weight, r, sums[SUM_RED]);
          sums[SUM_RED + 1] = fma(weight, g, sums[SUM_RED + 1]);
          sums[SUM_RED + 2] = fma(weight, b, sums[SUM_RED + 2]);
        }
        V by_w{};
        if (WITH_Z) {
          const V by_depth = weight * load(vz + p), by_point = keep(o.hit[k], by_depth) * o.over[k];
          sums[SUM_DEPTH] += keep(~o.hit[k], by_depth);
          sums[SUM_HEIGHT] = fma(by_point, o.rz[k], sums[SUM_HEIGHT]);
          by_w = -(by_point * o.depth[k]);
        }
        if (WITH_GEOMETRY) {
          V value = fma(broadcast(q[RED]), r, fma(broadcast(q[GREEN]), g, broadcast(q[BLUE]) * b));
          if (WITH_Z) value = fma(o.depth[k], load(vz + p), value);
          const V rest = fnma(weight, value, load(behind + p));
          store(behind + p, rest);
          // dL/d alpha, then dL/d log(alpha); 0 where alpha is clamped or the pixel has stopped.
          const V by_alpha = fnma(rest, reciprocal(broadcast(1) - a), now * value);
          V v = keep_gt(next, stop, a * by_alpha);
          v = keep_ge(broadcast(ALPHA_MAX), o.raw[k], v);
          sums[SUM_S] += v;
          const V filtered = keep(~o.hit[k], v), scaled = v * o.over[k];
          sums[SUM_FILTER] = fma(filtered, o.dx[k], sums[SUM_FILTER]);
          sums[SUM_FILTER + 1] = fma(filtered, o.dy[k], sums[SUM_FILTER + 1]);
          const V by_p = scaled * o.s[k], by_q = scaled * o.u[k];
          by_w = fma(scaled, o.square[k], by_w);
          sums[SUM_P] = fnma(by_p, o.tx[k], sums[SUM_P]);
          sums[SUM_P + 1] = fnma(by_p, o.ty[k], sums[SUM_P + 1]);
          sums[SUM_Q] = fnma(by_q, o.tx[k], sums[SUM_Q]);
          sums[SUM_Q + 1] = fnma(by_q, o.ty[k], sums[SUM_Q + 1]);
          sums[SUM_P_ALONG] = fnma(by_p, o.rz[k], sums[SUM_P_ALONG]);
          sums[SUM_Q_ALONG] = fnma(by_q, o.rz[k], sums[SUM_Q_ALONG]);
        }
        if (WITH_GEOMETRY || WITH_Z) {
          sums[SUM_N] = fma(by_w, o.rx[k], sums[SUM_N]);
          sums[SUM_N + 1] = fma(by_w, o.ry[k], sums[SUM_N + 1]);
          sums[SUM_N + 2] = fma(by_w, o.rz[k], sums[SUM_N + 2]);
        }
      }
      if (!goes_on) alive &= ~(1u << block);
    }
    float total[ROOM];
    for (int k = 0; k < ROOM; k += 4) {
      V groups[PARTS];
      for (int p = 0; p < PARTS; ++p)
        groups[p] = sums_of_groups(all[p][k], all[p][k + 1], all[p][k + 2], all[p][k + 3]);
      _mm_storeu_ps(total + k, sum_of_sixteen(groups));
    }
    __builtin_memcpy(out + DISC_SUMS * e, total, DISC_SUMS * sizeof(float));
  }
}

}  // namespace

void disc_forward(const DiscTile& t, bool with_depth, float* state) {
  constexpr std::size_t CHUNK = 192;
  const Rays rays(t);
  std::uint32_t lists[16][CHUNK];
  int sizes[16];
  PixelLanes pixels[16][PARTS];
  for (auto& block : pixels)
    for (PixelLanes& p : block) p = {{}, broadcast(1), broadcast(1)};
  std::uint32_t alive = ALL_BLOCKS;
  for (std::size_t i = 0; i < t.count && alive; i += CHUNK) {
    const std::size_t end = i + CHUNK < t.count ? i + CHUNK : t.count;
    for (int& size : sizes) size = 0;
    for (std::size_t e = i; e < end; ++e) {
      const float* d = t.discs + 16 * static_cast<std::size_t>(t.entries[e]);
      for (std::uint32_t mask = blocks_of(t, d) & alive; mask; mask &= mask - 1) {
        const int s = __builtin_ctz(mask);
        lists[s][sizes[s]++] = t.entries[e];
      }
    }
    for (std::uint32_t todo = alive; todo; todo &= todo - 1) {
      const int s = __builtin_ctz(todo);
      if (!composite(t, rays, s, lists[s], sizes[s], pixels[s])) alive &= ~(1u << s);
    }
  }
  for (int s = 0; s < 16; ++s) {
    for (int k = 0; k < PARTS; ++k) {
      float* out = state + 16 * s + LANES * k;
      for (int c = 0; c < 3; ++c) store(out + c * PIXELS, pixels[s][k].sums[c]);
      store(out + 3 * PIXELS, with_depth ? pixels[s][k].sums[3] : V{});
      store(out + 4 * PIXELS, pixels[s][k].transmittance);
    }
  }
}

void disc_backward(const DiscTile& t, const float* adjoint, std::uint32_t parts, float* sums) {
  switch (parts & (GEOMETRY | COLOR | WITH_DEPTH)) {
    case GEOMETRY: return backward_tile<true, false, false>(t, adjoint, sums);
    case COLOR: return backward_tile<false, true, false>(t, adjoint, sums);
    case GEOMETRY | COLOR: return backward_tile<true, true, false>(t, adjoint, sums);
    case GEOMETRY | WITH_DEPTH: return backward_tile<true, false, true>(t, adjoint, sums);
    case GEOMETRY | COLOR | WITH_DEPTH: return backward_tile<true, true, true>(t, adjoint, sums);
    default: return backward_tile<false, false, false>(t, adjoint, sums);
  }
}

}  // namespace RESPIRE_ISA
}  // namespace respire

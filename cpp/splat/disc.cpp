// Compositing of one tile of exact discs, forward and backward; compiled once per instruction set. The plain twin is
// src/splat/disc_tile.rs; src/splat/disc_mode.rs explains the symbols. Blocks, lists and the running transmittance are
// those of splat_kernel.cpp.
#include "cpp/splat/kernel.h"
#include "cpp/splat/lanes.h"

namespace respire {
namespace RESPIRE_ISA {
namespace {

// The pixels of a tile block by block: centres and rays. Those outside the image look straight ahead and show nothing to
// anybody.
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

// What U vectors of pixels see, each of a disc of its own. `raw` is 0 below ALPHA_MIN; `s`, `u` and `over` are 0 where the
// screen filter counts and not the plane.
template <int U>
struct Look {
  V dx[U], dy[U], tx[U], ty[U], rx[U], ry[U], rz[U], over[U], s[U], u[U], square[U], depth[U], raw[U];
  VI met[U];

  Look(const DiscTile& t, const Rays& rays, const std::uint32_t* splats, const int* pixels) {
    const float *q[U], *d[U];
    for (int k = 0; k < U; ++k) {
      q[k] = t.rows + 16 * static_cast<std::size_t>(splats[k]), d[k] = t.discs + 16 * static_cast<std::size_t>(splats[k]);
      rx[k] = load(rays.ray[0] + pixels[k]), ry[k] = load(rays.ray[1] + pixels[k]), rz[k] = load(rays.ray[2] + pixels[k]);
      dx[k] = load(rays.x + pixels[k]) - all(q[k][X]), dy[k] = load(rays.y + pixels[k]) - all(q[k][Y]);
    }
    for (int k = 0; k < U; ++k) {
      if (t.pinhole) {
        tx[k] = dx[k] * all(t.per_px[0]), ty[k] = dy[k] * all(t.per_px[1]);
      } else {
        tx[k] = fnma(all(d[k][DISC_SLOPE]), rz[k], rx[k]), ty[k] = fnma(all(d[k][DISC_SLOPE + 1]), rz[k], ry[k]);
      }
      over[k] = 1.0f / fma(all(d[k][DISC_N]), rx[k], fma(all(d[k][DISC_N + 1]), ry[k], all(d[k][DISC_N + 2]) * rz[k]));
    }
    for (int k = 0; k < U; ++k) {
      s[k] = fma(all(d[k][DISC_P]), tx[k], all(d[k][DISC_P + 1]) * ty[k]) * over[k];
      u[k] = fma(all(d[k][DISC_Q]), tx[k], all(d[k][DISC_Q + 1]) * ty[k]) * over[k];
      square[k] = fma(s[k], s[k], u[k] * u[k]);
      depth[k] = all(d[k][DISC_HEIGHT]) * rz[k] * over[k];
      met[k] = (depth[k] >= all(t.near)) & finite(square[k]);
      V distance = all(1e9f);
      if (t.filter > 0.0f) {
        distance = fma(dx[k], dx[k], dy[k] * dy[k]) * all(t.filter);
        met[k] &= square[k] <= distance;
      }
      distance = pick(met[k], square[k], distance);
      raw[k] = fnma(all(HALF_LOG2_E), distance, all(q[k][LOG2_OPACITY]));
      depth[k] = pick(met[k], depth[k], all(q[k][DEPTH]));
      s[k] = keep(met[k], s[k]), u[k] = keep(met[k], u[k]), over[k] = keep(met[k], over[k]);
      square[k] = keep(met[k], square[k]);
    }
    exp2<U>(raw);
    for (int k = 0; k < U; ++k) raw[k] = keep_ge(raw[k], all(ALPHA_MIN), raw[k]);
  }

  static constexpr float HALF_LOG2_E = 0.72134752044448170f;
};

// The blocks of the tile that have pixel centres in the disc's box: those whose middle is no further from it than 1.5 px.
inline std::uint32_t blocks_of(const DiscTile& t, const float* d) {
  std::uint32_t columns = 0, lines = 0;
  for (int b = 0; b < 4; ++b) {
    const float x = static_cast<float>(t.x + 4 * b + 2), y = static_cast<float>(t.y + 4 * b + 2);
    columns |= static_cast<std::uint32_t>(x >= d[DISC_LOW] - 1.5f && x <= d[DISC_HIGH] + 1.5f) << (4 * b);
    lines |= static_cast<std::uint32_t>(y >= d[DISC_LOW + 1] - 1.5f && y <= d[DISC_HIGH + 1] + 1.5f) << b;
  }
  return columns * lines;
}

// Some pixels of a block; see `Pixels` of splat_kernel.cpp.
struct Pixels {
  V sums[4], kept, left;

  void blend(const float* q, V raw, V depth) {
    const V a = least(raw, all(ALPHA_MAX)), next = fnma(a, left, left), stop = all(STOP);
    const V weight = keep_gt(next, stop, a * left);
    kept = pick_gt(next, stop, next, kept);
    left = next;
    for (int c = 0; c < 3; ++c) sums[c] = fma(weight, all(q[RED + c]), sums[c]);
    sums[3] = fma(weight, depth, sums[3]);
  }
};

// Vectors looked at side by side.
constexpr int ABREAST = PARTS > 2 ? PARTS : 2;

// E entries over one block.
template <int E>
void add(const DiscTile& t, const Rays& rays, int block, const std::uint32_t* entries, Pixels* pixels) {
  constexpr int U = E * PARTS;
  std::uint32_t splats[U];
  int places[U];
  for (int k = 0; k < U; ++k) splats[k] = entries[k / PARTS], places[k] = 16 * block + LANES * (k % PARTS);
  const Look<U> look(t, rays, splats, places);
  for (int k = 0; k < U; ++k)
    pixels[k % PARTS].blend(t.rows + 16 * static_cast<std::size_t>(splats[k]), look.raw[k], look.depth[k]);
}

// One block over one list; false once all its pixels have stopped.
bool composite(const DiscTile& t, const Rays& rays, int block, const std::uint32_t* list, int count, Pixels* pixels) {
  constexpr int E = ABREAST / PARTS;
  static_assert(8 % E == 0, "a look after every eight entries");
  Pixels own[PARTS];
  for (int k = 0; k < PARTS; ++k) own[k] = pixels[k];
  const auto alive = [&own] {
    bool goes_on = false;
    for (const Pixels& p : own) goes_on |= any(keep_gt(p.left, all(STOP), p.left));
    return goes_on;
  };
  bool goes_on = true;
  int j = 0;
  for (; goes_on && j + E <= count; j += E) {
    add<E>(t, rays, block, list + j, own);
    if ((j + E) % 8 == 0) goes_on = alive();
  }
  for (; goes_on && j < count; ++j) add<1>(t, rays, block, list + j, own);
  for (int k = 0; k < PARTS; ++k) pixels[k] = own[k];
  return alive();
}

inline float total(V v) {
  const V4 four = fold(v);
  return (four[0] + four[2]) + (four[1] + four[3]);
}

template <bool WITH_GEOMETRY, bool WITH_COLOR, bool WITH_Z>
void backward_tile(const DiscTile& t, const float* adjoint, float* out) {
  const Rays rays(t);
  alignas(64) float left[PIXELS], behind[PIXELS];
  for (float& v : left) v = 1;
  __builtin_memcpy(behind, adjoint + 4 * PIXELS, sizeof behind);
  const float *vr = adjoint, *vg = vr + PIXELS, *vb = vg + PIXELS, *vz = vb + PIXELS;
  const V stop = all(STOP);
  std::uint32_t alive = ALL_BLOCKS;
  for (std::size_t e = 0; e < t.count; ++e) {
    const std::uint32_t splat = t.entries[e];
    const float* q = t.rows + 16 * static_cast<std::size_t>(splat);
    const float* d = t.discs + 16 * static_cast<std::size_t>(splat);
    V sums[DISC_SUMS] = {};
    for (std::uint32_t todo = blocks_of(t, d) & alive; todo; todo &= todo - 1) {
      const int block = __builtin_ctz(todo);
      std::uint32_t splats[PARTS];
      int places[PARTS];
      for (int k = 0; k < PARTS; ++k) splats[k] = splat, places[k] = 16 * block + LANES * k;
      const Look<PARTS> o(t, rays, splats, places);
      bool goes_on = false;
      for (int k = 0; k < PARTS; ++k) {
        const int p = places[k];
        const V a = least(o.raw[k], all(ALPHA_MAX)), now = load(left + p), next = fnma(a, now, now);
        const V weight = keep_gt(next, stop, a * now);
        const V rest_of_light = keep_gt(next, stop, next);
        store(left + p, rest_of_light);
        goes_on |= any(rest_of_light);
        const V r = load(vr + p), g = load(vg + p), b = load(vb + p);
        if (WITH_COLOR) {
          sums[SUM_RED] = fma(weight, r, sums[SUM_RED]);
          sums[SUM_RED + 1] = fma(weight, g, sums[SUM_RED + 1]);
          sums[SUM_RED + 2] = fma(weight, b, sums[SUM_RED + 2]);
        }
        V by_w{};
        if (WITH_Z) {
          const V by_depth = weight * load(vz + p), by_point = keep(o.met[k], by_depth) * o.over[k];
          sums[SUM_DEPTH] += keep(~o.met[k], by_depth);
          sums[SUM_HEIGHT] = fma(by_point, o.rz[k], sums[SUM_HEIGHT]);
          by_w = -(by_point * o.depth[k]);
        }
        if (WITH_GEOMETRY) {
          V value = fma(all(q[RED]), r, fma(all(q[GREEN]), g, all(q[BLUE]) * b));
          if (WITH_Z) value = fma(o.depth[k], load(vz + p), value);
          const V rest = fnma(weight, value, load(behind + p));
          store(behind + p, rest);
          // d loss / d alpha, then d loss / d log(alpha); none where alpha is clamped or the pixel has stopped.
          const V by_alpha = fnma(rest, reciprocal(all(1) - a), now * value);
          V v = keep_gt(next, stop, a * by_alpha);
          v = keep_ge(all(ALPHA_MAX), o.raw[k], v);
          sums[SUM_S] += v;
          const V filtered = keep(~o.met[k], v), scaled = v * o.over[k];
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
    for (int k = 0; k < DISC_SUMS; ++k) out[DISC_SUMS * e + k] = total(sums[k]);
  }
}

}  // namespace

void disc_forward(const DiscTile& t, bool with_depth, float* state) {
  constexpr std::size_t CHUNK = 192;
  const Rays rays(t);
  std::uint32_t lists[16][CHUNK];
  int sizes[16];
  Pixels pixels[16][PARTS];
  for (auto& block : pixels)
    for (Pixels& p : block) p = {{}, all(1), all(1)};
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
      store(out + 4 * PIXELS, pixels[s][k].kept);
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

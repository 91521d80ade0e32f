// Compositing of one tile, forward and backward, in GCC vector extensions; compiled once per instruction set with
// -DRESPIRE_ISA=<namespace>. After 3DGS (Kerbl et al. 2023, Eq. 3: C = sum c_i a_i prod_j<i (1 - a_j)); the backward
// pass goes front to back after FastGS and Brush. The plain twin is src/splat/plain/tile.rs, which also explains the
// symbols.
//
//   alpha = min(0.99, 2^(l - A dx^2 - B dx dy - C dy^2)), 0 below 1/255;  weight = alpha T;  T' = T (1 - alpha)
//
// A tile is 16 blocks of 4x4 pixels. For each entry (splat in tile) a mask says which blocks the ellipse alpha >=
// 1/255 can touch. Forward: entries are distributed to the lists of their blocks, and a block is composited with its
// state in registers. Backward: entry by entry, replaying the forward decisions, so that the sums of an entry are
// reduced once per tile. A pixel that has stopped is one whose running transmittance is 0.
//
// Left out: exact discs (disc.cpp), and the velocity of opacities.
#include "cpp/splat/kernel.h"
#include "cpp/splat/lanes.h"
#include "cpp/splat/lists.h"

namespace respire {
namespace RESPIRE_ISA {
namespace {

// Vectors of pixels whose alphas are evaluated side by side. Each is one long chain of dependent operations; four of
// them in turn hide the latency, which the processor's reorder window (little more than one chain) does not.
constexpr int INTERLEAVED = 4;

// Offsets (dx, dy) of the pixels (px[u], py[u]) from the splats q[u], and `raw` = 2^exponent there, not yet clamped:
// exponent = l - (A dx + B dy) dx - C dy^2.
template <int U>
struct AlphaSamples {
  V dx[U], dy[U], raw[U];
  AlphaSamples(const float* const* q, const V* px, const V* py) {
    V part[U];
    for (int u = 0; u < U; ++u) dx[u] = (px[u] - broadcast(q[u][X])) - broadcast(q[u][X_REST]);
    for (int u = 0; u < U; ++u) dy[u] = (py[u] - broadcast(q[u][Y])) - broadcast(q[u][Y_REST]);
    for (int u = 0; u < U; ++u) part[u] = broadcast(q[u][B]) * dy[u], raw[u] = broadcast(q[u][C]) * dy[u];
    for (int u = 0; u < U; ++u) {
      part[u] = fma(broadcast(q[u][A]), dx[u], part[u]);
      raw[u] = fnma(raw[u], dy[u], broadcast(q[u][LOG2_OPACITY]));
    }
    for (int u = 0; u < U; ++u) raw[u] = fnma(part[u], dx[u], raw[u]);
    exp2<U>(raw);
  }
};

// Pixel centres of a block relative to its corner.
alignas(64) const float COLUMN[16] = {.5, 1.5, 2.5, 3.5, .5, 1.5, 2.5, 3.5, .5, 1.5, 2.5, 3.5, .5, 1.5, 2.5, 3.5};
alignas(64) const float LINE[16] = {.5, .5, .5, .5, 1.5, 1.5, 1.5, 1.5, 2.5, 2.5, 2.5, 2.5, 3.5, 3.5, 3.5, 3.5};

// The state of LANES pixels of a block: the sums; the transmittance that the image gets; the running transmittance,
// which is no more than `stop` once a pixel has stopped; the velocities of sums and transmittance along K directions.
template <bool WITH_Z, int K>
struct PixelLanes {
  V px, py, stop, sums[4], transmittance, running, moving[K + 1][MOVING];

  // Blends one splat.
  void blend(const ForwardTile& t, std::size_t splat, V dx, V dy, V raw) {
    const float* q = t.rows + 16 * splat;
    // weight = alpha T, where the pixel does not stop at this splat.
    const V a = clip(raw, broadcast(ALPHA_MIN), broadcast(ALPHA_MAX));
    const V next = fnma(a, running, running);
    const V weight = keep_gt(next, stop, a * running);
    // Velocities: d log(alpha) first, from the splat's velocity.
    for (int d = 0; d < K; ++d) {
      const float* v = t.velocities[d] + 8 * splat;
      V* m = moving[d];
      const V p = fma(broadcast(v[VXX]), dx, fma(broadcast(v[VXY]), dy, broadcast(v[VX])));
      const V by_log = fma(p, dx, fma(broadcast(v[VYY]), dy, broadcast(v[VY])) * dy);
      // d weight = d alpha T + alpha dT; d alpha is 0 where alpha is clamped, all is 0 where the pixel has stopped.
      const V by_alpha = keep_ge(broadcast(ALPHA_MAX), raw, by_log * weight);
      const V by_weight = keep_gt(next, stop, fma(a, m[3], by_alpha));
      m[0] = fma(by_weight, broadcast(q[RED]), fma(weight, broadcast(v[VRED]), m[0]));
      m[1] = fma(by_weight, broadcast(q[GREEN]), fma(weight, broadcast(v[VGREEN]), m[1]));
      m[2] = fma(by_weight, broadcast(q[BLUE]), fma(weight, broadcast(v[VBLUE]), m[2]));
      m[3] -= by_weight;
    }
    transmittance = select_gt(next, stop, next, transmittance);
    // T' = T (1 - alpha) never grows: where a pixel has stopped, nothing later is blended.
    running = next;
    for (int c = 0; c < (WITH_Z ? 4 : 3); ++c) sums[c] = fma(weight, broadcast(q[RED + c]), sums[c]);
  }

  // Sets the running transmittance of stopped pixels to 0; false when all have stopped.
  bool drop_stopped() {
    running = keep_gt(running, stop, running);
    return any(running);
  }
};

// The 16 pixels of a block.
template <bool WITH_Z, int K>
struct Block {
  PixelLanes<WITH_Z, K> parts[PARTS];

  // Blends U splats, whose alphas are evaluated side by side.
  template <int U>
  void blend_entries(const ForwardTile& t, const std::uint32_t* splats) {
    constexpr int N = U * PARTS;
    const float* q[N];
    V x[N], y[N];
    for (int n = 0; n < N; ++n) {
      q[n] = t.rows + 16 * static_cast<std::size_t>(splats[n / PARTS]);
      x[n] = parts[n % PARTS].px, y[n] = parts[n % PARTS].py;
    }
    const AlphaSamples<N> samples(q, x, y);
    for (int n = 0; n < N; ++n)
      parts[n % PARTS].blend(t, splats[n / PARTS], samples.dx[n], samples.dy[n], samples.raw[n]);
  }

  bool drop_stopped() {
    bool alive = false;
    for (PixelLanes<WITH_Z, K>& p : parts) alive |= p.drop_stopped();
    return alive;
  }
};

// Composites one block over one list of splats; false once all its pixels have stopped. `state`: PLANES planes, then
// the running transmittance (0 where a pixel has stopped); `moving`: MOVING planes for each of the K directions of
// `t`.
template <bool WITH_Z, int K>
bool composite(const ForwardTile& t, const std::uint32_t* list, int count, float x, float y, float* state,
               float* moving) {
  static_assert(DEPTH == RED + 3, "the depth is summed like a fourth colour");
  constexpr int SUMS = WITH_Z ? 4 : 3, U = INTERLEAVED / PARTS;
  static_assert(8 % U == 0, "every eight entries it is tested whether all pixels have stopped");
  // Load the state into registers.
  Block<WITH_Z, K> block;
  for (int k = 0; k < PARTS; ++k) {
    PixelLanes<WITH_Z, K>& p = block.parts[k];
    const float *s = state + LANES * k, *m = moving + LANES * k;
    p.px = load(COLUMN + LANES * k) + broadcast(x), p.py = load(LINE + LANES * k) + broadcast(y),
    p.stop = broadcast(t.stop);
    for (int c = 0; c < SUMS; ++c) p.sums[c] = load(s + c * PIXELS);
    p.transmittance = load(s + 4 * PIXELS), p.running = load(s + 5 * PIXELS);
    for (int d = 0; d < K; ++d)
      for (int c = 0; c < MOVING; ++c) p.moving[d][c] = load(m + (d * MOVING + c) * PIXELS);
  }
  // Blend the splats, front to back.
  bool goes_on = true;
  int j = 0;
  for (; goes_on && j + U <= count; j += U) {
    block.template blend_entries<U>(t, list + j);
    if ((j + U) % 8 == 0) goes_on = block.drop_stopped();
  }
  for (; goes_on && j < count; ++j) block.template blend_entries<1>(t, list + j);
  const bool alive = block.drop_stopped();
  // Store the state.
  for (int k = 0; k < PARTS; ++k) {
    const PixelLanes<WITH_Z, K>& p = block.parts[k];
    float *s = state + LANES * k, *m = moving + LANES * k;
    for (int c = 0; c < SUMS; ++c) store(s + c * PIXELS, p.sums[c]);
    store(s + 4 * PIXELS, p.transmittance);
    store(s + 5 * PIXELS, p.running);
    for (int d = 0; d < K; ++d)
      for (int c = 0; c < MOVING; ++c) store(m + (d * MOVING + c) * PIXELS, p.moving[d][c]);
  }
  return alive;
}

// Composites a tile, CHUNK entries at a time: their lists stay in the first-level cache, and few entries are
// distributed in vain once all pixels have stopped.
template <bool WITH_Z, int K, bool KNOWN>
void forward_tile(const ForwardTile& t) {
  constexpr std::size_t CHUNK = 192, ROOM = CHUNK + 16;  // `distribute` writes sixteen at a time
  std::uint32_t lists[16][ROOM];
  int sizes[16];
  alignas(64) float state[6 * PIXELS];
  for (int i = 0; i < 6 * PIXELS; ++i) state[i] = i < 4 * PIXELS ? 0 : 1;
  for (int i = 0; i < K * MOVING * PIXELS; ++i) t.moving[i] = 0;
  std::uint32_t alive = ALL_BLOCKS;  // blocks with pixels that have not stopped
  std::size_t i = 0;
  while (i < t.count && alive) {
    const std::size_t end = i + CHUNK < t.count ? i + CHUNK : t.count;
    for (int& size : sizes) size = 0;
    for (int d = 0; d < K; ++d)
      for (std::size_t k = i; k < end; ++k)
        __builtin_prefetch(t.velocities[d] + 8 * static_cast<std::size_t>(t.entries[k]));
    distribute<KNOWN>(t, i, end, alive, lists, sizes);
    i = end;
    for (std::uint32_t todo = alive; todo; todo &= todo - 1) {
      const int s = __builtin_ctz(todo);
      if (!sizes[s]) continue;
      const float x = t.x + 4.0f * (s >> 2), y = t.y + 4.0f * (s & 3);
      if (!composite<WITH_Z, K>(t, lists[s], sizes[s], x, y, state + 16 * s, t.moving + 16 * s)) alive &= ~(1u << s);
    }
  }
  for (; i < t.count; ++i) t.masks[i] = 0;
  __builtin_memcpy(t.state, state, PLANES * PIXELS * sizeof(float));
}

// Entries of the backward pass whose alphas are evaluated before their sums: 16, so that a batch (16 KB) stays in the
// first-level cache.
constexpr int BATCH = 16;

// The pairs of an entry of a batch and a block that it may touch, entry after entry, with 2^exponent of their pixels (0
// below ALPHA_MIN). All alphas of a batch are evaluated first, since they do not depend on each other.
struct EntryBlocks {
  alignas(64) float raw[16 * BATCH][16];
  std::uint8_t owners[16 * BATCH + 16], blocks[16 * BATCH + 16];
  int starts[BATCH + 1];

  // Lists the pairs of the entries first..first + count and the blocks in `alive`.
  void collect(const BackwardTile& t, std::size_t first, int count, std::uint32_t alive) {
    int end = 0;
    for (int k = 0; k < count; ++k) {
      starts[k] = end;
      const std::uint32_t mask = t.masks[first + k] & alive;
#if defined(__AVX512F__)
      const __m512i numbers = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
      const __m512i found = _mm512_maskz_compress_epi32(static_cast<__mmask16>(mask), numbers);
      _mm_storeu_si128(reinterpret_cast<__m128i*>(blocks + end), _mm512_cvtepi32_epi8(found));
      _mm_storeu_si128(reinterpret_cast<__m128i*>(owners + end), _mm_set1_epi8(static_cast<char>(k)));
      end += __builtin_popcount(mask);
#else
      for (std::uint32_t todo = mask; todo; todo &= todo - 1) {
        blocks[end] = static_cast<std::uint8_t>(__builtin_ctz(todo));
        owners[end++] = static_cast<std::uint8_t>(k);
      }
#endif
    }
    starts[count] = end;
    // Padding to whole groups; its alphas are evaluated and never read.
    for (int k = 0; k < INTERLEAVED; ++k) owners[end + k] = blocks[end + k] = 0;
  }

  // `columns` and `lines`: pixel centres of the four columns and the four lines of blocks.
  void evaluate_alphas(const BackwardTile& t, std::size_t first, int count, const float (*columns)[16],
                       const float (*lines)[16]) {
    constexpr int U = INTERLEAVED, AT_ONCE = U / PARTS;
    for (int p = 0; p < starts[count]; p += AT_ONCE) {
      const float* q[U];
      V x[U], y[U];
      for (int u = 0; u < U; ++u) {
        const int pair = p + u / PARTS, part = LANES * (u % PARTS);
        q[u] = t.rows + 16 * static_cast<std::size_t>(t.entries[first + owners[pair]]);
        x[u] = load(columns[blocks[pair] >> 2] + part), y[u] = load(lines[blocks[pair] & 3] + part);
      }
      const AlphaSamples<U> samples(q, x, y);
      for (int u = 0; u < U; ++u)
        store(raw[p + u / PARTS] + LANES * (u % PARTS), keep_ge(samples.raw[u], broadcast(ALPHA_MIN), samples.raw[u]));
    }
  }
};

// With v = (dL/d red, green, blue, depth sum) of a pixel and `behind` the contribution of the splats behind the current
// one:
//
//   value = v . (red, green, blue, depth);  behind' = behind - weight value
//   dL/d log(alpha) = alpha (T value - behind' / (1 - alpha))
//
// The moments of an entry are the sums of the latter over its pixels, times 1, dx, dy, dx^2, dx dy and dy^2.
template <bool WITH_GEOMETRY, bool WITH_COLOR, bool WITH_Z>
void backward_tile(const BackwardTile& t) {
  alignas(64) float running[PIXELS], behind[PIXELS], columns[4][16], lines[4][16];
  for (int i = 0; i < PIXELS; ++i) running[i] = 1;
  __builtin_memcpy(behind, t.adjoint + 4 * PIXELS, sizeof behind);
  for (int b = 0; b < 4; ++b)
    for (int i = 0; i < 16; ++i) columns[b][i] = COLUMN[i] + (t.x + 4.0f * b), lines[b][i] = LINE[i] + (t.y + 4.0f * b);
  const float *vr = t.adjoint, *vg = vr + PIXELS, *vb = vg + PIXELS, *vz = vb + PIXELS;
  EntryBlocks pairs;
  const V stop = broadcast(t.stop);
  const float* const rows = t.rows;
  float* const slots = t.slots;
  bool* const live = t.live;
  const std::uint32_t *const entries = t.entries, *const targets = t.targets;
  std::uint32_t alive = ALL_BLOCKS;
  for (std::size_t first = 0; first < t.count && alive; first += BATCH) {
    const int count = t.count - first < BATCH ? static_cast<int>(t.count - first) : BATCH;
    // Rows and slots of the next batch.
    const std::size_t next = first + BATCH, end = next + BATCH < t.count ? next + BATCH : t.count;
    for (std::size_t i = next; i < end; ++i) {
      if (!(t.masks[i] & alive)) continue;
      __builtin_prefetch(rows + 16 * static_cast<std::size_t>(entries[i]));
      __builtin_prefetch(slots + 16 * static_cast<std::size_t>(targets[i]), 1);
    }
    pairs.collect(t, first, count, alive);
    pairs.evaluate_alphas(t, first, count, columns, lines);
    for (int e = 0; e < count; ++e) {
      // No block: one entry in eleven of the timing scene (src/splat/check/tube.rs), nine in ten of many layers. Most lie
      // behind blocks that have stopped, some in corners of boxes that the ellipse does not reach.
      if (pairs.starts[e] == pairs.starts[e + 1]) continue;
      const std::size_t target = targets[first + e];
      const float* q = rows + 16 * static_cast<std::size_t>(entries[first + e]);
      // Sums over each four lanes, three times four of them: the moments. Part after part, so that the sums of one fit
      // into the registers and are taken in the same order for every LANES.
      V moments[3][PARTS];
      for (int k = 0; k < PARTS; ++k) {
        V s{}, sx{}, sy{}, sxx{}, sxy{}, syy{}, sr{}, sg{}, sb{}, sz{};
        for (int pair = pairs.starts[e]; pair < pairs.starts[e + 1]; ++pair) {
          const int block = pairs.blocks[pair];
          const int p = 16 * block + LANES * k;
          // The forward pass again.
          const V raw = load(pairs.raw[pair] + LANES * k);
          const V a = min(raw, broadcast(ALPHA_MAX));
          const V now = load(running + p);
          const V next = fnma(a, now, now);
          const V weight = keep_gt(next, stop, a * now);
          store(running + p, keep_gt(next, stop, next));
          const V r = load(vr + p), g = load(vg + p), b = load(vb + p);
          if (WITH_GEOMETRY) {
            const V dx = (load(columns[block >> 2] + LANES * k) - broadcast(q[X])) - broadcast(q[X_REST]);
            const V dy = (load(lines[block & 3] + LANES * k) - broadcast(q[Y])) - broadcast(q[Y_REST]);
            V value = fma(broadcast(q[RED]), r, fma(broadcast(q[GREEN]), g, broadcast(q[BLUE]) * b));
            if (WITH_Z) value = fma(broadcast(q[DEPTH]), load(vz + p), value);
            const V own = weight * value, rest = load(behind + p) - own;
            store(behind + p, rest);
            // dL/d log(alpha); 0 where alpha is clamped or the pixel has stopped.
            V v = keep_gt(next, stop, fnma(rest, a * reciprocal(broadcast(1) - a), own));
            v = keep_ge(broadcast(ALPHA_MAX), raw, v);
            const V mx = v * dx, my = v * dy;
            s += v;
            sx += mx;
            sy += my;
            sxx = fma(mx, dx, sxx);
            sxy = fma(mx, dy, sxy);
            syy = fma(my, dy, syy);
          }
          if (WITH_COLOR) {
            sr = fma(weight, r, sr);
            sg = fma(weight, g, sg);
            sb = fma(weight, b, sb);
          }
          if (WITH_Z) sz = fma(weight, load(vz + p), sz);
        }
        moments[0][k] = sums_of_groups(s, sx, sy, sxx);
        moments[1][k] = sums_of_groups(sxy, syy, sz, V{});
        moments[2][k] = sums_of_groups(sr, sg, sb, V{});
      }
      const __m128 sums[3] = {sum_of_sixteen(moments[0]), sum_of_sixteen(moments[1]), sum_of_sixteen(moments[2])};
      const auto is_not_zero = [](__m128 v) { return _mm_cmpneq_ps(v, _mm_setzero_ps()); };
      if (!_mm_movemask_ps(_mm_or_ps(_mm_or_ps(is_not_zero(sums[0]), is_not_zero(sums[1])), is_not_zero(sums[2]))))
        continue;
      float* slot = slots + 16 * target;
      live[target] = true;
      for (int m = 0; m < 3; ++m) _mm_storeu_ps(slot + 4 * m, sums[m]);
      _mm_storeu_ps(slot + 12, _mm_setzero_ps());
    }
    // Drop blocks whose pixels have all stopped.
    for (std::uint32_t todo = alive; todo; todo &= todo - 1) {
      const int block = __builtin_ctz(todo);
      bool goes_on = false;
      for (int k = 0; k < PARTS; ++k) goes_on |= any(load(running + 16 * block + LANES * k));
      if (!goes_on) alive &= ~(1u << block);
    }
  }
}

}  // namespace

void forward(const ForwardTile& t, std::uint32_t parts) {
  constexpr int D = WITH_DIRECTIONS;
  switch (t.directions) {
    case 1: return forward_tile<false, 1 * D, false>(t);
    case 2: return forward_tile<false, 2 * D, false>(t);
    case 3: return forward_tile<false, 3 * D, false>(t);
    case 4: return forward_tile<false, 4 * D, false>(t);
    default: break;
  }
  const bool known = parts & KNOWN_MASKS;
  if (parts & WITH_DEPTH) {
    known ? forward_tile<true, 0, true>(t) : forward_tile<true, 0, false>(t);
  } else {
    known ? forward_tile<false, 0, true>(t) : forward_tile<false, 0, false>(t);
  }
}

void backward(const BackwardTile& t, std::uint32_t parts) {
  switch (parts & (GEOMETRY | COLOR | WITH_DEPTH)) {
    case GEOMETRY: return backward_tile<true, false, false>(t);
    case COLOR: return backward_tile<false, true, false>(t);
    case GEOMETRY | COLOR: return backward_tile<true, true, false>(t);
    case GEOMETRY | WITH_DEPTH: return backward_tile<true, false, true>(t);
    case GEOMETRY | COLOR | WITH_DEPTH: return backward_tile<true, true, true>(t);
    default: return;
  }
}

const Kernels KERNELS = {project, recolor, velocities, chain, forward, backward, disc_forward, disc_backward};

}  // namespace RESPIRE_ISA
}  // namespace respire

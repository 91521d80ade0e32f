#pragma once
// Which entries of a tile touch which of its blocks of 4x4 pixels: a mask per entry, and a list of entries per block.
// The plain twin is `block_mask` of src/splat/plain/tile.rs.
//
// A block is touched when one of its pixel centres can lie in the ellipse alpha >= 1/255. With the offset y from the
// centre of the splat, the ellipse reaches in x from (-B y - root) / 2A to (-B y + root) / 2A, root^2 = (B^2 - 4 A C)
// y^2 + reach. Its x-extent over a band of four lines of pixels is that at the y of the band where it is widest, and
// is compared with the four columns of blocks. The four bands of an entry lie side by side in one vector.
#include "cpp/splat/kernel.h"
#include "cpp/splat/lanes.h"

namespace respire {
namespace RESPIRE_ISA {
namespace {

// Against rounding the ellipse is made larger by 1e-3 px and 1e-5 of its half sizes.
constexpr float SLACK_PX = 1e-3f, SLACK_SHARE = 1e-5f;

#if defined(__AVX512F__)

// The masks of the sixteen entries `e` (those beyond `count` repeat another; their masks are 0), four entries side by
// side.
inline __m512i block_masks(const float* rows, const std::uint32_t* e, int count, float tile_x, float tile_y) {
  const __m512i band = _mm512_set4_epi32(3, 2, 1, 0);
  const __m512 line = _mm512_add_ps(_mm512_set1_ps(tile_y), _mm512_set4_ps(12.5f, 8.5f, 4.5f, 0.5f));
  const __m512 zero = _mm512_setzero_ps();
  // Bit c of the index to bit 4 c of the value.
  const __m512i spread_bits = _mm512_setr_epi32(0, 0x1, 0x10, 0x11, 0x100, 0x101, 0x110, 0x111, 0x1000, 0x1001, 0x1010,
                                                0x1011, 0x1100, 0x1101, 0x1110, 0x1111);
  __m512i masks = _mm512_setzero_si512();
  for (int g = 0; 4 * g < count; ++g) {
    const float* q[4];
    for (int l = 0; l < 4; ++l) q[l] = rows + 16 * static_cast<std::size_t>(e[4 * g + l]);
    auto four = [&](int at) {
      __m512 v = _mm512_castps128_ps512(_mm_loadu_ps(q[0] + at));
      v = _mm512_insertf32x4(v, _mm_loadu_ps(q[1] + at), 1);
      v = _mm512_insertf32x4(v, _mm_loadu_ps(q[2] + at), 2);
      return _mm512_insertf32x4(v, _mm_loadu_ps(q[3] + at), 3);
    };
    static_assert(X == 0 && Y == 1 && A == 2 && B == 3 && HALF_WIDTH == 10 && HALF_HEIGHT == 11 && DISCRIMINANT == 12 &&
                      WIDEST == 13,
                  "the columns as they are picked below");
    const __m512 q0 = four(0), q2 = four(8), q3 = four(12);
    const __m512 b = _mm512_permute_ps(q0, 0xff), half_height = _mm512_permute_ps(q2, 0xff);
    const __m512 slack = _mm512_fmadd_ps(
        _mm512_set1_ps(SLACK_SHARE), _mm512_add_ps(_mm512_permute_ps(q2, 0xaa), half_height), _mm512_set1_ps(SLACK_PX));
    const __m512 limit = _mm512_add_ps(half_height, slack), below = _mm512_sub_ps(zero, limit);
    const __m512 y0 = _mm512_sub_ps(line, _mm512_permute_ps(q0, 0x55)), y1 = _mm512_add_ps(y0, _mm512_set1_ps(3.0f));
    const __m512 lo = _mm512_max_ps(y0, below), hi = _mm512_min_ps(y1, limit);
    const __m512 widest = _mm512_permute_ps(q3, 0x55);
    // The ellipse is widest to the right at y = -B half_width / (2 C), to the left at the opposite point.
    const __m512 y_right = _mm512_min_ps(_mm512_max_ps(widest, lo), hi);
    const __m512 y_left = _mm512_min_ps(_mm512_max_ps(_mm512_sub_ps(zero, widest), lo), hi);
    const __m512 d = _mm512_permute_ps(q3, 0x00), scale = (__m512)(0.5f * reciprocal((V)_mm512_permute_ps(q0, 0xaa)));
    const __m512 reach = _mm512_fnmadd_ps(_mm512_mul_ps(d, half_height), half_height, zero);
    auto root = [&](__m512 y) {
      return _mm512_sqrt_ps(_mm512_max_ps(_mm512_fmadd_ps(_mm512_mul_ps(d, y), y, reach), zero));
    };
    const __m512 offset = _mm512_sub_ps(_mm512_permute_ps(q0, 0x00), _mm512_set1_ps(tile_x + 0.5f));
    const __m512 right =
        _mm512_fmadd_ps(scale, _mm512_fnmadd_ps(b, y_right, root(y_right)), _mm512_add_ps(offset, slack));
    const __m512 left = _mm512_fnmadd_ps(scale, _mm512_fmadd_ps(b, y_left, root(y_left)), _mm512_sub_ps(offset, slack));
    // Columns of blocks c with left <= 4 c + 3 and right >= 4 c: from first to before last.
    const __m512 quarter = _mm512_set1_ps(0.25f);
    const __m512 first = _mm512_mul_ps(_mm512_sub_ps(left, _mm512_set1_ps(3.0f)), quarter);
    const __m512 last = _mm512_fmadd_ps(right, quarter, _mm512_set1_ps(1.0f));
    const __m512 most = _mm512_set1_ps(4.0f);
    const __m512i c0 = _mm512_cvt_roundps_epi32(_mm512_min_ps(_mm512_max_ps(first, zero), most),
                                                _MM_FROUND_TO_POS_INF | _MM_FROUND_NO_EXC);
    const __m512i c1 = _mm512_cvt_roundps_epi32(_mm512_min_ps(_mm512_max_ps(last, zero), most),
                                                _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC);
    const __mmask16 inside = _mm512_mask_cmplt_epi32_mask(_mm512_cmp_ps_mask(lo, hi, _CMP_LE_OQ), c0, c1);
    const __m512i one = _mm512_set1_epi32(1);
    const __m512i columns = _mm512_maskz_sub_epi32(inside, _mm512_sllv_epi32(one, c1), _mm512_sllv_epi32(one, c0));
    __m512i m = _mm512_sllv_epi32(_mm512_permutexvar_epi32(columns, spread_bits), band);
    m = _mm512_or_si512(m, _mm512_shuffle_epi32(m, _MM_PERM_BADC));
    m = _mm512_or_si512(m, _mm512_shuffle_epi32(m, _MM_PERM_CDAB));
    // All four lanes of an entry are alike: one of each goes to lanes 4 g to 4 g + 3.
    const __m512i pick = _mm512_set4_epi32(12, 8, 4, 0);
    masks = _mm512_mask_permutexvar_epi32(masks, static_cast<__mmask16>(0xf << (4 * g)), pick, m);
  }
  return _mm512_maskz_mov_epi32(static_cast<__mmask16>((1u << count) - 1), masks);
}

// Masks of the entries i..end, and their splats appended to the lists of the blocks in `alive` that they touch. Sixteen
// entries at a time; for each block those that touch it are compressed, so that no branch depends on a mask.
template <bool KNOWN, std::size_t ROOM>
void distribute(const ForwardTile& t, std::size_t i, std::size_t end, std::uint32_t alive, std::uint32_t (*lists)[ROOM],
                int* sizes) {
  for (; i < end; i += 16) {
    const int count = end - i < 16 ? static_cast<int>(end - i) : 16;
    const __mmask16 there = static_cast<__mmask16>((1u << count) - 1);
    alignas(64) std::uint32_t e[16];
    const __m512i splats =
        _mm512_mask_loadu_epi32(_mm512_set1_epi32(static_cast<int>(t.entries[i])), there, t.entries + i);
    _mm512_store_si512(e, splats);
    const std::size_t ahead = i + 16 < t.count ? (t.count - i - 16 < 16 ? t.count - i - 16 : 16) : 0;
    for (std::size_t k = 0; k < ahead; ++k)
      __builtin_prefetch(t.rows + 16 * static_cast<std::size_t>(t.entries[i + 16 + k]));
    __m512i masks;
    if (KNOWN) {
      masks = _mm512_cvtepu16_epi32(_mm256_maskz_loadu_epi16(there, t.masks + i));
    } else {
      masks = _mm512_and_si512(block_masks(t.rows, e, count, t.x, t.y), _mm512_set1_epi32(static_cast<int>(alive)));
      _mm256_mask_storeu_epi16(t.masks + i, there, _mm512_cvtepi32_epi16(masks));
    }
    for (std::uint32_t todo = alive; todo; todo &= todo - 1) {
      const int s = __builtin_ctz(todo);
      const __mmask16 hit = _mm512_test_epi32_mask(masks, _mm512_set1_epi32(1 << s));
      _mm512_storeu_si512(lists[s] + sizes[s], _mm512_maskz_compress_epi32(hit, splats));
      sizes[s] += __builtin_popcount(hit);
    }
  }
}

#else

constexpr int ENTRIES = LANES / 4;

// The masks of the splats q.
inline void block_masks(const float* const* q, float tile_x, float tile_y, std::uint32_t* masks) {
  auto four = [&](int at) {
    __m128 parts[ENTRIES];
    for (int e = 0; e < ENTRIES; ++e) parts[e] = _mm_loadu_ps(q[e] + at);
    return join(parts);
  };
  static_assert(X == 0 && Y == 1 && A == 2 && B == 3 && HALF_WIDTH == 10 && HALF_HEIGHT == 11 && DISCRIMINANT == 12 &&
                    WIDEST == 13,
                "the columns as they are picked below");
  const V q0 = four(0), q2 = four(8), q3 = four(12), zero{};
  const V half_height = broadcast_field<3>(q2), slack = SLACK_SHARE * (broadcast_field<2>(q2) + half_height) + SLACK_PX,
          limit = half_height + slack;
  V line;
  for (int l = 0; l < LANES; ++l) line[l] = 4.0f * (l % 4) + 0.5f;
  const V y0 = line + (tile_y - broadcast_field<1>(q0)), lo = max(y0, -limit), hi = min(y0 + 3.0f, limit);
  // The ellipse is widest to the right at y = -B half_width / (2 C), to the left at the opposite point.
  const V widest = broadcast_field<1>(q3), y_right = min(max(widest, lo), hi), y_left = min(max(-widest, lo), hi);
  const V d = broadcast_field<0>(q3), b = broadcast_field<3>(q0), scale = 0.5f / broadcast_field<2>(q0),
          reach = -(d * half_height * half_height);
  auto root = [&](V y) { return square_root(max(d * y * y + reach, zero)); };
  const V offset = broadcast_field<0>(q0) - (tile_x + 0.5f);
  const V right = scale * (root(y_right) - b * y_right) + (offset + slack);
  const V left = (offset - slack) - scale * (root(y_left) + b * y_left);
  for (int e = 0; e < ENTRIES; ++e) masks[e] = 0;
  for (int column = 0; column < 4; ++column) {
    const int hit = bits_of((lo <= hi) & (left <= 4.0f * column + 3.0f) & (right >= 4.0f * column));
    for (int e = 0; e < ENTRIES; ++e) masks[e] |= static_cast<std::uint32_t>(hit >> (4 * e) & 0xf) << (4 * column);
  }
}

// As with AVX-512, ENTRIES at a time.
template <bool KNOWN, std::size_t ROOM>
void distribute(const ForwardTile& t, std::size_t i, std::size_t end, std::uint32_t alive, std::uint32_t (*lists)[ROOM],
                int* sizes) {
  for (; i < end; i += ENTRIES) {
    const float* q[ENTRIES];
    std::uint32_t masks[ENTRIES];
    for (std::size_t e = 0; e < ENTRIES; ++e) {
      if (i + e + 6 < end) __builtin_prefetch(t.rows + 16 * static_cast<std::size_t>(t.entries[i + e + 6]));
      q[e] = t.rows + 16 * static_cast<std::size_t>(t.entries[i + e < end ? i + e : i]);
    }
    if (!KNOWN) block_masks(q, t.x, t.y, masks);
    for (std::size_t e = 0; e < ENTRIES && i + e < end; ++e) {
      if (!KNOWN) t.masks[i + e] = static_cast<std::uint16_t>(masks[e] & alive);
      for (std::uint32_t mask = t.masks[i + e]; mask; mask &= mask - 1) {
        const int s = __builtin_ctz(mask);
        lists[s][sizes[s]++] = t.entries[i + e];
      }
    }
  }
}

#endif

}  // namespace
}  // namespace RESPIRE_ISA
}  // namespace respire

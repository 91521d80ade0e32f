#pragma once
// The interface between the dispatcher (rasterize.cpp) and the kernels (project.cpp, chain.cpp, kernel.cpp,
// disc.cpp), whose sources are compiled once per instruction set. Plain pointers and no library headers: code
// compiled for a wider instruction set must not leave inline functions behind that the linker could pick for
// other code.
#include <cstddef>
#include <cstdint>

namespace respire {

// Columns of a splat's row; `at` in src/splat/types/table.rs explains them.
enum RowColumn {
  X,
  Y,
  A,
  B,
  C,
  LOG2_OPACITY,
  RED,
  GREEN,
  BLUE,
  DEPTH,
  HALF_WIDTH,
  HALF_HEIGHT,
  DISCRIMINANT,
  WIDEST,
  X_REST,
  Y_REST
};
// Moments of an entry (a splat in a tile); `moment` in src/splat/types/table.rs explains them.
enum MomentColumn { S, SX, SY, SXX, SXY, SYY, SDEPTH, SPAD, SRED, SGREEN, SBLUE };
// Velocity of a splat along a direction, times ln 2: d log(alpha) = (VX + VXX dx + VXY dy) dx + (VY + VYY dy) dy.
enum VelocityColumn { VX, VY, VXX, VXY, VYY, VRED, VGREEN, VBLUE };

constexpr int PIXELS = 256;  // of a tile of 16x16: sixteen blocks of 4x4, numbered down the columns, pixel by pixel
constexpr int PLANES = 5;    // of a tile's state: red, green, blue and depth sums, transmittance
constexpr int MOVING = 4;    // planes of a tile's velocity: red, green and blue sums, transmittance
constexpr int MAX_DIRECTIONS = 4;             // that one pass carries; each takes MOVING registers
constexpr std::uint32_t ALL_BLOCKS = 0xffff;  // of a tile, a bit each
// Whether the kernels compute velocities. Only methods ask for them (the feature `methods`, build.rs); to compile them
// takes as long as half of all else.
#if defined(RESPIRE_DIRECTIONS)
constexpr bool WITH_DIRECTIONS = true;
#else
constexpr bool WITH_DIRECTIONS = false;
#endif
constexpr float TILES_PER_PX = 1.0f / 16.0f;
// The three thresholds of 3DGS (Kerbl et al. 2023, its public rasteriser): nothing is blended below ALPHA_MIN, no
// alpha is larger than ALPHA_MAX, and a pixel stops at the splat that would leave no more than STOP of the light.
constexpr float ALPHA_MIN = 1.0f / 255.0f, ALPHA_MAX = 0.99f, STOP = 1e-4f;

// The camera; rasterize.cpp fills it from `SplatCamera` (src/ffi/splat/rasterize.rs), which gives the units.
struct View {
  float rotation[9], eye[3], focal[2], center[2], low[2], high[2], size[2], near, dilation;
  float by_opacity;                          // 1: extents depend on the opacity; 0: they do not
  bool skip_beside;                          // groups beside the image are skipped before their covariance is known
  bool compensate;                           // opacities are multiplied by sqrt(det / det dilated)
  bool fisheye;                              // or else a pinhole
  float lens[4];                             // distortion of a fisheye
  float cone_cosine, cone_sine, cone_reach;  // cone of a fisheye's field of view, and how far beyond it splats reach
};

// The same in double precision, for centres.
struct ExactView {
  double rotation[9], eye[3], focal[2], center[2], lens[4];
};

// Gaussians as they lie in memory. `shape`: 6 floats (two axes) a disc, a quaternion an ellipsoid. `scales` is null for
// discs, `active` where all Gaussians take part.
struct Scene {
  View view;
  ExactView exact;
  const float *positions, *shape, *scales, *opacities, *sh;
  std::uint32_t sh_degree;
  const std::uint32_t* active;
};

// Velocities of the splats of a chunk along one direction.
struct TangentChunk {
  std::size_t first, count;  // numbers in `active`
  const bool* visible;
  const float *positions, *shape, *colors;  // velocities, one per Gaussian; null for none
  const float* pose;                        // six numbers instead, or null
  float* rows;                              // out, 8 floats each, where visible
};

struct ProjectChunk {
  std::size_t first, count;  // numbers in `active`
  std::uint32_t tiles_x, tiles_y;
  float* rows;                 // out, 16 floats each, where visible
  std::uint32_t* boxes;        // out, two words each: x0 | y0 << 16, x1 | y1 << 16, where visible
  std::uint32_t* keys;         // out, bits of the z-depth rounded from double, where visible
  bool* visible;               // out
  const TangentChunk* motion;  // the direction along which velocities are wanted too, or null
};

struct RecolorChunk {
  std::size_t first, count;
  const bool* visible;
  float* rows;  // in and out: the colours are written, where visible
};

// Groups of parameters whose gradients are wanted; the bits of `Wanted` (src/splat/types/).
enum ParameterGroup : std::uint32_t { POSITIONS = 1, SHAPES = 2, OPACITIES = 4, HARMONICS = 8, POSE = 16, LENS = 64 };

// Gaussians that share a flag which says whether any of them has a gradient; `GROUP` in src/splat/types/gradients.rs.
constexpr std::size_t GROUP = 16;

struct ChainChunk {
  std::size_t first, count;
  const std::uint32_t* starts;  // slots of number k are starts[k]..starts[k + 1]
  const float* slots;
  const bool* live;  // of each slot: whether it was written; the others hold what is left of other passes
  std::uint32_t wanted;
  float *positions, *shape, *scales, *opacities, *sh;  // out, those that are wanted
  double *pose, *intrinsics;                           // out, 6 and 4 sums; 0 where not wanted
  // Per GROUP Gaussians: whether any of their tables' rows may differ from 0 now; whether any may afterwards (out; 0
  // when it comes).
  const bool* written;
  bool* heard;
};

struct ForwardTile {
  const float* rows;             // 16 floats per splat
  const std::uint32_t* entries;  // splats of this tile, front to back
  std::uint16_t*
      masks;  // out (in with KNOWN_MASKS): blocks that an entry may touch; 0 for entries behind the last that was read
  std::size_t count;
  float x, y;                // upper left corner in pixels
  float stop;                // a pixel stops at the splat that would leave no more than this of the light
  float* state;              // out: PLANES planes of PIXELS
  std::uint32_t directions;  // 0 to MAX_DIRECTIONS
  const float* velocities[MAX_DIRECTIONS];  // 8 floats per splat and direction
  float* moving;                            // out: MOVING planes of PIXELS per direction
};

struct BackwardTile {
  const float* rows;
  const std::uint32_t* entries;
  const std::uint16_t* masks;
  std::size_t count;
  float x, y, stop;
  const float* adjoint;          // dL/d red, green, blue, depth sums; then the loss still to come behind (PIXELS each)
  const std::uint32_t* targets;  // slot of each entry
  float* slots;                  // out: 16 moments in the slot of each entry that has any but zeros
  bool* live;                    // out: set for the slots that were written; false when it comes
};

// Columns of an exact disc (`Disc::pack` of src/splat/plain/disc.rs, which explains the symbols).
enum DiscColumn {
  DISC_P,
  DISC_Q = DISC_P + 3,
  DISC_N = DISC_Q + 3,
  DISC_HEIGHT = DISC_N + 3,
  DISC_SLOPE,
  DISC_LOW = DISC_SLOPE + 2,
  DISC_HIGH = DISC_LOW + 2
};
// Columns of the sums of an entry (`disc_sum` in src/splat/types/table.rs).
enum DiscSum {
  SUM_S,
  SUM_RED,
  SUM_FILTER = SUM_RED + 3,
  SUM_DEPTH = SUM_FILTER + 2,
  SUM_HEIGHT,
  SUM_P,
  SUM_Q = SUM_P + 3,
  SUM_P_ALONG = SUM_Q + 3,
  SUM_Q_ALONG,
  SUM_N,
  DISC_SUMS = SUM_N + 3
};

struct DiscTile {
  const float *rows, *discs;     // 16 floats per splat each
  const std::uint32_t* entries;  // front to back
  std::size_t count;
  std::uint32_t x, y, width, height;  // upper left corner, size of the image
  const float* rays;                  // of the image, row by row, 3 floats each
  bool pinhole;
  float per_px[2], near, filter;  // 1 / focal length; nearest depth; 1 / variance of the screen filter, 0 for none
};

// What a compositing kernel computes beyond colour; the bits of `Parts` (src/splat/plain/tile.rs).
enum Part : std::uint32_t {
  GEOMETRY = 1,
  COLOR = 2,
  WITH_DEPTH = 4,
  KNOWN_MASKS = 8,  // the masks are those of a forward pass before, of the same splats
  ENDLESS = 16,     // pixels do not stop
};

// The kernels of one instruction set.
struct Kernels {
  void (*project)(const Scene&, const ProjectChunk&);
  bool (*recolor)(const Scene&, const RecolorChunk&);  // false when a visible colour is not finite
  void (*velocities)(const Scene&, const TangentChunk&);
  void (*chain)(const Scene&, const ChainChunk&);
  void (*forward)(const ForwardTile&, std::uint32_t parts);
  void (*backward)(const BackwardTile&, std::uint32_t parts);
  void (*disc_forward)(const DiscTile&, bool with_depth, float* state);
  void (*disc_backward)(const DiscTile&, const float* adjoint, std::uint32_t parts, float* sums);
};
namespace baseline {
extern const Kernels KERNELS;
}
namespace avx2 {
extern const Kernels KERNELS;
}
namespace avx512 {
extern const Kernels KERNELS;
}

#if defined(RESPIRE_ISA)
// Each of them stands in the file that its name suggests; kernel.cpp puts them into the table.
namespace RESPIRE_ISA {
void project(const Scene&, const ProjectChunk&);
bool recolor(const Scene&, const RecolorChunk&);
void velocities(const Scene&, const TangentChunk&);
void chain(const Scene&, const ChainChunk&);
void forward(const ForwardTile&, std::uint32_t parts);
void backward(const BackwardTile&, std::uint32_t parts);
void disc_forward(const DiscTile&, bool with_depth, float* state);
void disc_backward(const DiscTile&, const float* adjoint, std::uint32_t parts, float* sums);
}  // namespace RESPIRE_ISA
#endif

}  // namespace respire

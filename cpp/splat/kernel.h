#pragma once
// The interface between the dispatcher (splat.cpp) and the kernels, which are one source (splat_kernel.cpp) compiled
// once per instruction set. Plain pointers and no library headers: code compiled for a wider instruction set must not
// leave inline functions behind that the linker could pick for everybody.
#include <cstddef>
#include <cstdint>

namespace respire {

// Columns of the tables; the same as in src/splat/project.rs and src/splat/kernel.rs.
enum Row { X, Y, A, B, C, LOG2_OPACITY, RED, GREEN, BLUE, DEPTH, HALF_WIDTH, HALF_HEIGHT, DISCRIMINANT,
           WIDEST, X_REST, Y_REST };
enum Moment { S, SX, SY, SXX, SXY, SYY, SDEPTH, SPAD, SRED, SGREEN, SBLUE };

// Velocity of a splat along a direction, times ln 2: d log(alpha) = (VX + VXX dx + VXY dy) dx + (VY + VYY dy) dy.
enum Velocity { VX, VY, VXX, VXY, VYY, VRED, VGREEN, VBLUE };

constexpr int PIXELS = 256;  // of the largest tile, 16x16, block by block: 4x4 blocks, numbered down the columns
constexpr int PLANES = 5;    // of a tile's state: red, green, blue, depth sums and transmittance
constexpr int MOVING = 4;    // planes of a tile's velocity: red, green, blue sums and transmittance
constexpr float ALPHA_MIN = 1.0f / 255.0f;  // below it nothing is blended
constexpr float ALPHA_MAX = 0.99f;          // no alpha is larger
constexpr float STOP = 1e-4f;  // what a pixel stops at; with ENDLESS none does
constexpr int TOGETHER = 4;  // directions that one pass can carry

// The camera; the same order as in `Projector::numbers` (src/splat/project.rs).
struct View {
  float rotation[9], eye[3], focal[2], center[2], limit[2], size[2], near, dilation;
  float by_opacity, beside;  // 1 or 0: extents depend on the opacity; what is beside the image is left early
  float lens[4], cone[3];    // a fisheye's distortion; cosine and sine of the cone that it sees, and how far beyond it splats reach
  float fisheye;             // 1, or 0 for a pinhole
  float compensate;          // 1: opacities are multiplied by the root of det / det dilated; 0: they stay
};

// Gaussians as they lie in memory. `shape`: 6 floats (two axes) of discs, whose `scales` are null; quaternions of
// ellipsoids. `active` may be null: all.
struct Scene {
  const View* view;
  const float *positions, *shape, *scales, *opacities, *sh;
  std::uint32_t sh_degree;
  const std::uint32_t* active;
  const double* camera;  // in double: rotation (9), eye (3), focal (2), center (2), lens (4)
};

struct TangentChunk {
  std::size_t first, count;
  const bool* visible;
  const float *positions, *shape, *colors;  // velocities, one per Gaussian; null for none
  const float* pose;                        // six numbers instead, or null
  float* rows;                              // out, 8 floats each, where visible
};

struct ProjectChunk {
  std::size_t first, count;  // numbers in `active`
  std::uint32_t tiles_x, tiles_y;
  float tiles_per_px;
  float* rows;           // out, 16 floats each, where visible
  std::uint32_t* boxes;  // out, two words each: x0 | y0 << 16, x1 | y1 << 16, where visible
  std::uint32_t* keys;   // out, bits of the z-depth rounded from double, where visible
  bool* visible;         // out
  const TangentChunk* motion;  // what its splats' velocities are wanted along, or null
};

struct RecolorChunk {
  std::size_t first, count;
  const bool* visible;
  float* rows;   // in and out: the colours are written, where visible
  bool* finite;  // set to false when one is not
};

enum Group : std::uint32_t { POSITIONS = 1, SHAPES = 2, OPACITIES = 4, HARMONICS = 8, POSE = 16, LENS = 64 };

struct ChainChunk {
  std::size_t first, count;
  const std::uint32_t* starts;  // slots of number k are starts[k]..starts[k + 1]
  const float* slots;
  std::uint32_t wanted;
  float *positions, *shape, *scales, *opacities, *sh;  // out, those that are wanted
  double* camera;                                      // out, 6 of the pose and 4 of the intrinsics
};

struct ForwardTile {
  const float* rows;             // 16 floats per splat
  const std::uint32_t* entries;  // splats of this tile, front to back
  std::uint16_t* masks;          // out (in with KNOWN_MASKS): blocks that an entry may touch; 0 once nobody looks any more
  std::size_t count;
  float x, y;                    // upper left corner in pixels
  std::uint32_t blocks;          // those that the tile has: a smaller tile than 16x16 has not all; not 0
  float stop;                    // a pixel stops at the splat that would leave no more than this of the light
  float* state;                  // out: PLANES planes of PIXELS
  std::uint32_t directions;      // 0 to TOGETHER
  const float* velocities[TOGETHER];  // 8 floats per splat and direction
  float* moving;                      // out: MOVING planes of PIXELS per direction
};

struct BackwardTile {
  const float* rows;
  const std::uint32_t* entries;
  const std::uint16_t* masks;
  std::size_t count;
  float x, y, stop;
  const float* adjoint;  // dL/d red, green, blue, depth sums; then the loss still to come behind (PIXELS each)
  const std::uint32_t* targets;  // slot of each entry
  float* slots;          // out: 16 moments in the slot of each entry
};

// Columns of an exact disc (`Disc::pack` of src/splat/disc_mode.rs, which explains the symbols).
enum DiscColumn { DISC_P, DISC_Q = DISC_P + 3, DISC_N = DISC_Q + 3, DISC_HEIGHT = DISC_N + 3, DISC_SLOPE,
                  DISC_LOW = DISC_SLOPE + 2, DISC_HIGH = DISC_LOW + 2 };
// Columns of the sums of an entry (`sum` of src/splat/disc_tile.rs).
enum DiscSum { SUM_S, SUM_RED, SUM_FILTER = SUM_RED + 3, SUM_DEPTH = SUM_FILTER + 2, SUM_HEIGHT, SUM_P, SUM_Q = SUM_P + 3,
               SUM_P_ALONG = SUM_Q + 3, SUM_Q_ALONG, SUM_N, DISC_SUMS = SUM_N + 3 };

struct DiscTile {
  const float *rows, *discs;     // 16 floats per splat each
  const std::uint32_t* entries;  // front to back
  std::size_t count;
  std::uint32_t x, y, width, height;  // upper left corner, size of the image
  std::uint32_t blocks;
  const float* rays;  // of the image, row by row, 3 floats each
  bool pinhole;
  float per_px[2], near, filter;  // 1 / focal length; 1 / variance of the screen filter, 0 for none
};

enum Part : std::uint32_t { GEOMETRY = 1, COLOR = 2, WITH_DEPTH = 4, KNOWN_MASKS = 8, ENDLESS = 16 };

#define RESPIRE_KERNELS(ISA)                             \
  namespace ISA {                                        \
  void project(const Scene&, const ProjectChunk&);       \
  void recolor(const Scene&, const RecolorChunk&);       \
  void velocities(const Scene&, const TangentChunk&);    \
  void chain(const Scene&, const ChainChunk&);           \
  void forward(const ForwardTile&, std::uint32_t parts); \
  void backward(const BackwardTile&, std::uint32_t parts); \
  void disc_forward(const DiscTile&, bool with_depth, float* state); \
  void disc_backward(const DiscTile&, const float* adjoint, std::uint32_t parts, float* sums); \
  }
RESPIRE_KERNELS(baseline)
RESPIRE_KERNELS(avx2)
RESPIRE_KERNELS(avx512)
#undef RESPIRE_KERNELS

}  // namespace respire

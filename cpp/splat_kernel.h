#pragma once
// The interface between the dispatcher (splat.cpp) and the kernels, which are one source (splat_kernel.cpp) compiled
// once per instruction set. Plain pointers and no library headers: code compiled for a wider instruction set must not
// leave inline functions behind that the linker could pick for everybody.
#include <cstddef>
#include <cstdint>

namespace respire {

// Columns of the tables; the same as in src/splat/project.rs and src/splat/kernel.rs.
enum Row { X, Y, A, B, C, LOG2_OPACITY, RED, GREEN, BLUE, DEPTH, HALF_WIDTH, HALF_HEIGHT, DISCRIMINANT };
enum Moment { S, SX, SY, SXX, SXY, SYY, SDEPTH, SPAD, SRED, SGREEN, SBLUE };

constexpr int PIXELS = 256;  // 16x16, block by block: 4x4 blocks, numbered down the columns of the tile

struct ForwardTile {
  const float* rows;              // 16 floats per splat
  const std::uint32_t* entries;   // splats of this tile, front to back
  std::uint16_t* masks;           // out: blocks that an entry may touch; 0 once nobody looks any more
  std::size_t count;
  float x, y;                     // upper left corner in pixels
  float* state;                   // out: red, green, blue, depth sums and transmittance, PIXELS each
};

struct BackwardTile {
  const float* rows;
  const std::uint32_t* entries;
  const std::uint16_t* masks;
  std::size_t count;
  float x, y;
  const float* adjoint;  // dL/d red, green, blue, depth sums; then the loss still to come behind (PIXELS each)
  float* slots;          // out: 16 moments per entry whose mask is not 0
};

enum Part : std::uint32_t { GEOMETRY = 1, COLOR = 2, WITH_DEPTH = 4 };

namespace baseline {
void forward(const ForwardTile&, std::uint32_t parts);
void backward(const BackwardTile&, std::uint32_t parts);
}  // namespace baseline
namespace avx2 {
void forward(const ForwardTile&, std::uint32_t parts);
void backward(const BackwardTile&, std::uint32_t parts);
}  // namespace avx2
namespace avx512 {
void forward(const ForwardTile&, std::uint32_t parts);
void backward(const BackwardTile&, std::uint32_t parts);
}  // namespace avx512

}  // namespace respire

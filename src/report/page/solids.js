"use strict";
// Small vectors and matrices, and the tubes and balls that are drawn anew whenever something moves. Matrices are
// column-major.

// --- small vectors ---------------------------------------------------------------------------------------------
const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const madd = (a, b, s) => [a[0] + b[0] * s, a[1] + b[1] * s, a[2] + b[2] * s];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = a => { const l = Math.hypot(...a) || 1; return [a[0] / l, a[1] / l, a[2] / l]; };
const mix3 = (a, b, t) => [0, 1, 2].map(k => a[k] + (b[k] - a[k]) * t);

function multiply(a, b) {
  const out = new Float32Array(16);
  for (let c = 0; c < 4; c++) for (let r = 0; r < 4; r++)
    for (let k = 0; k < 4; k++) out[4 * c + r] += a[4 * k + r] * b[4 * c + k];
  return out;
}
function perspective(tanHalf, aspect, near, far) {
  const f = 1 / tanHalf, d = near - far;
  return new Float32Array([f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / d, -1, 0, 0, 2 * far * near / d, 0]);
}
// A view from `eye` with axes right, up and back (unit vectors).
const viewOf = (eye, x, y, z) => new Float32Array([
  x[0], y[0], z[0], 0, x[1], y[1], z[1], 0, x[2], y[2], z[2], 0, -dot(x, eye), -dot(y, eye), -dot(z, eye), 1]);

// --- geometry that changes with the cursor -----------------------------------------------------------------------
class Solids {
  constructor() { this.data = []; }
  vertex(p, n, color, alpha) { this.data.push(p[0], p[1], p[2], n[0], n[1], n[2], color[0], color[1], color[2], alpha); }
  // A tube with one radius and one colour per point; sides flow into each other. Points may stand where the one before is.
  tube(points, radii, colors, alpha = 1, sides = 8) {
    const apart = (a, b) => Math.hypot(...sub(a, b)) > 1e-6, second = points.find(p => apart(p, points[0]));
    if (!second) return;
    let along = unit(sub(second, points[0]));
    let side = unit(cross(along, Math.abs(along[2]) > 1e-3 ? [1, 0.2, 0] : [0, 0, 1]));
    const rings = points.map((p, i) => {
      const before = points[Math.max(i - 1, 0)], after = points[Math.min(i + 1, points.length - 1)];
      if (apart(before, after)) along = unit(sub(after, before));
      side = unit(madd(side, along, -dot(side, along)));
      const other = cross(along, side);
      return Array.from({ length: sides + 1 }, (_, k) => {
        const a = 2 * Math.PI * k / sides;
        const n = madd(side.map(v => v * Math.cos(a)), other, Math.sin(a));
        return [madd(p, n, radii[i]), n];
      });
    });
    for (let i = 0; i + 1 < rings.length; i++) for (let k = 0; k < sides; k++) {
      for (const [r, s] of [[i, k], [i + 1, k], [i, k + 1], [i, k + 1], [i + 1, k], [i + 1, k + 1]])
        this.vertex(...rings[r][s], colors[r], alpha);
    }
  }
  sphere(centre, radius, color, alpha = 1) { this.ellipsoid(centre, [[radius, 0, 0], [0, radius, 0], [0, 0, radius]], color, alpha); }
  // The points `centre` + n0 axes[0] + n1 axes[1] + n2 axes[2] of unit vectors n; the axes need not be at right angles.
  ellipsoid(centre, axes, color, alpha = 1, steps = 10) {
    // Normals go by the inverse transpose: the cross products of the axes, up to their length.
    const across = [cross(axes[1], axes[2]), cross(axes[2], axes[0]), cross(axes[0], axes[1])];
    const mixed = (vectors, n) => [0, 1, 2].map(k => vectors[0][k] * n[0] + vectors[1][k] * n[1] + vectors[2][k] * n[2]);
    const at = (i, k) => {
      const t = Math.PI * i / steps, u = 2 * Math.PI * k / (2 * steps);
      const n = [Math.sin(t) * Math.cos(u), Math.sin(t) * Math.sin(u), Math.cos(t)], place = mixed(axes, n);
      return [[centre[0] + place[0], centre[1] + place[1], centre[2] + place[2]], unit(mixed(across, n))];
    };
    for (let i = 0; i < steps; i++) for (let k = 0; k < 2 * steps; k++)
      for (const [r, s] of [[i, k], [i + 1, k], [i, k + 1], [i, k + 1], [i + 1, k], [i + 1, k + 1]])
        this.vertex(...at(r, s), color, alpha);
  }
}

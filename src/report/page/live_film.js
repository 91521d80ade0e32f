"use strict";
// The lines of a run as the scene and the curves ask for them.

// Answers that are kept: eleven minutes at 25 a second. Where more come, every second one is left.
const MOST_ANSWERS = 1 << 14;
const STATES = ["tracking", "unsure", "lost"];

// The largest deviation of a symmetric 3x3 covariance in any direction: powers of the matrix turn a vector towards it.
function widestDeviation(covariance) {
  let v = [1, 0.7, 0.4], length = 0;
  for (let k = 0; k < 24; k++) {
    v = covariance.map(row => dot(row, v));
    length = Math.hypot(...v);
    if (!(length > 0)) return 0;
    v = v.map(x => x / length);
  }
  return Math.sqrt(length);
}

// Columns of L in C = L L^T (Cholesky). A direction in which nothing is uncertain gets 0.15 mm, so that it can be seen.
function halfAxes(C) {
  const L = [[0, 0, 0], [0, 0, 0], [0, 0, 0]], least = 0.0225;
  for (let i = 0; i < 3; i++) for (let j = 0; j <= i; j++) {
    let sum = C[i][j];
    for (let k = 0; k < j; k++) sum -= L[i][k] * L[j][k];
    L[i][j] = i === j ? Math.sqrt(Math.max(sum, least)) : sum / L[j][j];
  }
  return [0, 1, 2].map(j => [L[0][j], L[1][j], L[2][j]]);
}

class LiveFilm {
  constructor(data) {
    this.airway = data.airway ? decodeAirway(data.airway) : null;
    this.tanHalfHeight = data.tan_half_height;
    this.count = 0;
    this.columns = {};
    for (const name of ["time", "phase", "deviation", "latency", "leftOut", "state"]) this.columns[name] = new Float64Array(MOST_ANSWERS);
    this.allPoses = new Float32Array(12 * MOST_ANSWERS);
    this.colors = [];
    this.leftOut = 0;
    this.last = null;
  }

  // `number`: answers before this one, of which a page that is opened late need not have all.
  add(line, number) {
    if (this.count === MOST_ANSWERS) this.halve();
    const k = this.count++, M = line.world_from_camera, put = (name, value) => { this.columns[name][k] = value; };
    // x, y and z axis, then the centre: columns of the matrix.
    for (let c = 0; c < 4; c++) for (let r = 0; r < 3; r++) this.allPoses[12 * k + 3 * c + r] = M[r][c];
    put("time", line.time_s);
    put("phase", line.phase);
    put("deviation", line.phase_deviation ?? 0);
    put("latency", line.latency_ms);
    put("leftOut", line.left_out);
    put("state", STATES.indexOf(line.state));
    this.leftOut = line.frame - number;
    this.last = line;
    this.spread = null;
  }

  halve() {
    const kept = MOST_ANSWERS / 2;
    for (const column of Object.values(this.columns)) for (let k = 0; k < kept; k++) column[k] = column[2 * k + 1];
    for (let k = 0; k < kept; k++) this.allPoses.copyWithin(12 * k, 12 * (2 * k + 1), 12 * (2 * k + 2));
    this.count = kept;
  }

  // Each target: its place, how far it is from the scope, and its largest deviation in any direction, mm.
  targets() {
    if (!this.last) return [];
    const M = this.last.world_from_camera, centre = [M[0][3], M[1][3], M[2][3]];
    return this.last.targets_mm.map((place, k) => ({
      place, away: Math.hypot(...sub(place, centre)), deviation: widestDeviation(this.last.target_covariance_mm2[k]),
    }));
  }

  // --- what the scene asks ---------------------------------------------------------------------------------------
  get isLive() { return true; }
  get poses() { return this.allPoses.subarray(0, 12 * this.count); }
  truePhase() { return this.last ? this.last.phase : 0; }
  targetsAt() { return []; }
  predictedTargets() { return this.last ? this.last.targets_mm : []; }
  colorAt(_, frame) { return this.colors[this.columns.state[frame]]; }

  // Two deviations of each target in every direction; the covariance is in the camera's axes.
  spreadAt() {
    if (!this.last) return [];
    const M = this.last.world_from_camera;
    const turned = v => [0, 1, 2].map(r => 2 * (M[r][0] * v[0] + M[r][1] * v[1] + M[r][2] * v[2]));
    this.spread = this.spread || this.last.targets_mm.map((centre, k) =>
      ({ centre, axes: halfAxes(this.last.target_covariance_mm2[k]).map(turned) }));
    return this.spread;
  }
}

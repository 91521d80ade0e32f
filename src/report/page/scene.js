"use strict";
// The airway in 3D: own WebGL 2, no library. One canvas and one context serve the whole page, since browsers allow only
// a few; the open case borrows it. Nothing is drawn while nothing changes.
//
// Axes of the scanner: x to the patient's left, y backwards, z towards the head. Matrices are column-major.

// Errors in mm on a logarithmic scale: blue is right, yellow about a millimetre, purple is wrong. Lightness and hue
// change together, so that it reads without red and green, too. Purple is 3:1 on a dark stage.
const ERROR_STOPS = ["#6aaed6", "#9fc9cf", "#f5d06a", "#ee8a3c", "#d1402f", "#b3148c"];
const ERROR_SCALE_MM = [0.1, 10];
const errorShare = mm => {
  const [low, high] = ERROR_SCALE_MM.map(Math.log);
  return Math.min(1, Math.max(0, (Math.log(Math.max(mm, 1e-9)) - low) / (high - low)));
};
const rgbOf = hex => [1, 3, 5].map(k => parseInt(hex.slice(k, k + 2), 16) / 255);
const errorColor = mm => {
  const at = errorShare(mm) * (ERROR_STOPS.length - 1), k = Math.min(ERROR_STOPS.length - 2, Math.floor(at));
  const [a, b] = [rgbOf(ERROR_STOPS[k]), rgbOf(ERROR_STOPS[k + 1])];
  return a.map((v, c) => v + (b[c] - v) * (at - k));
};

// Half the side of what is seen around the scope, from near; mm: some branches on every side.
const NEAR_MM = 26;
// How far it is turned up or down at most, radians: straight from above or below has no upper side.
const MOST_ELEVATION = 1.5;
// Least and greatest magnification.
const ZOOMS = [0.3, 30];
// How far the slider may be from the film's phase to count as the same: half of its step.
const SAME_PHASE = 0.0025;
const within = (low, high, value) => Math.min(high, Math.max(low, value));
// Patient's directions and their letters: left, right, head, feet, anterior and posterior.
const DIRECTIONS = [["L", [1, 0, 0]], ["R", [-1, 0, 0]], ["H", [0, 0, 1]], ["F", [0, 0, -1]], ["A", [0, -1, 0]], ["P", [0, 1, 0]]];

// --- shaders ---------------------------------------------------------------------------------------------------
// Both breath holds are on the GPU; the slider moves one uniform. `invariant`: the depth pass and the colour pass must
// agree to the last bit, or the shell gets holes.
const AIRWAY_VERTEX = `#version 300 es
precision highp float;
layout(location=0) in vec3 inspiration; layout(location=1) in vec3 expiration;
layout(location=2) in vec3 normal0; layout(location=3) in vec3 normal1;
layout(location=4) in float code;
uniform mat4 viewProjection; uniform float phase; uniform float phaseError; uniform int errorKind;
out vec3 place; out vec3 normal; out float errorMm;
invariant gl_Position;
void main() {
  place = mix(inspiration, expiration, phase);
  normal = mix(normal0, normal1, phase);
  errorMm = -1.0;
  if (errorKind == 1 && code < 254.5) errorMm = 0.01 * pow(10000.0, code / 254.0);
  if (errorKind == 2) errorMm = phaseError * length(expiration - inspiration);
  gl_Position = viewProjection * vec4(place, 1.0);
}`;
const AIRWAY_FRAGMENT = `#version 300 es
precision highp float;
in vec3 place; in vec3 normal; in float errorMm;
uniform vec3 eye; uniform vec3 light; uniform int inside; uniform float dark; uniform float back;
uniform sampler2D errorColors;
out vec4 color;
vec3 tint(vec3 base) {
  if (errorMm < 0.0) return base;
  float share = clamp(log(max(errorMm, 1e-9) / 0.1) / log(100.0), 0.0, 1.0);
  // What is right keeps the colour of tissue; colour means error.
  return mix(base, pow(texture(errorColors, vec2(share * 0.98 + 0.01, 0.5)).rgb, vec3(2.2)), smoothstep(0.0, 0.1, share));
}
void main() {
  vec3 toEye = eye - place; float distance = length(toEye); toEye /= distance;
  vec3 n = normalize(normal);
  if (inside == 1) {
    // As the scope sees it: light at the lens, inverse square with the exposure of a near wall, wet mucosa.
    float facing = max(dot(n, toEye), 0.0);
    float fall = 1.0 / (1.0 + distance * distance / 260.0);
    vec3 base = tint(vec3(0.72, 0.25, 0.20));
    vec3 lit = base * (0.035 + 1.5 * facing * fall) + vec3(0.55) * pow(facing, 40.0) * fall;
    color = vec4(pow(1.0 - exp(-1.6 * lit), vec3(1.0 / 2.2)), 1.0);
    return;
  }
  // From outside: glass. What is seen edge-on is dense, what is seen face-on lets the path through (Schlick's power,
  // softened: real glass would show no wall at all).
  float facing = abs(dot(n, toEye));
  float rim = pow(1.0 - facing, 2.2);
  vec3 outward = dot(n, toEye) < 0.0 ? -n : n;
  float key = max(dot(outward, light), 0.0);
  vec3 base = tint(mix(vec3(0.60, 0.26, 0.22), vec3(0.75, 0.42, 0.36), dark));
  vec3 lit = base * (0.42 + 0.62 * key + 0.16 * outward.z);
  lit = mix(lit, mix(lit * 0.45, lit * 1.5 + 0.04, dark), rim);
  // A known error has the legend's colour, with just enough light to show the shape.
  float known = smoothstep(0.1, 0.3, errorMm);
  lit = mix(lit, base * (0.82 + 0.18 * key), known);
  float shine = pow(max(dot(normalize(light + toEye), outward), 0.0), 48.0) * 0.45 * (1.0 - known);
  float alpha = mix(mix(0.18, 0.80, known), 0.94, rim) * back;
  alpha = min(1.0, alpha + shine * back);
  color = vec4(pow(lit + shine, vec3(1.0 / 2.2)) * alpha, alpha);
}`;
const SOLID_VERTEX = `#version 300 es
precision highp float;
layout(location=0) in vec3 place; layout(location=1) in vec3 normal; layout(location=2) in vec4 paint;
uniform mat4 viewProjection; out vec3 n; out vec4 ink;
void main() { n = normal; ink = paint; gl_Position = viewProjection * vec4(place, 1.0); }`;
const SOLID_FRAGMENT = `#version 300 es
precision highp float;
in vec3 n; in vec4 ink; uniform vec3 light; out vec4 color;
void main() {
  float key = 0.62 + 0.38 * dot(normalize(n), light);
  color = vec4(ink.rgb * key * ink.a, ink.a);
}`;

// The scene of one page. `host` of `open` is the element that gets the canvas.
class AirwayScene {
  constructor() {
    this.canvas = document.createElement("canvas");
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", "The airway with the scope's path and the targets. Arrow keys turn it, plus and minus zoom.");
    this.compass = el("svg", { class: "compass", viewBox: "-36 -36 72 72", "aria-hidden": "true" });
    // Kept after drawing, so that it prints and can be read back.
    const gl = this.gl = this.canvas.getContext("webgl2", { antialias: true, alpha: false, preserveDrawingBuffer: true });
    this.isUsable = !!gl;
    this.view = { kind: "outside", azimuth: -0.45, elevation: 0.16, zoom: 1, shift: [0, 0] };
    this.state = { frame: 0, phase: 0, row: null, surface: true, path: true, targets: true };
    if (!gl) return;
    this.airwayProgram = this.program(AIRWAY_VERTEX, AIRWAY_FRAGMENT);
    this.solidProgram = this.program(SOLID_VERTEX, SOLID_FRAGMENT);
    this.solidBuffer = gl.createBuffer();
    this.solidArray = gl.createVertexArray();
    gl.bindVertexArray(this.solidArray);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.solidBuffer);
    [[3, 0], [3, 12], [4, 24]].forEach(([size, offset], k) => {
      gl.enableVertexAttribArray(k);
      gl.vertexAttribPointer(k, size, gl.FLOAT, false, 40, offset);
    });
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    const row = new Uint8Array(64 * 4);
    for (let k = 0; k < 64; k++) {
      const [low, high] = ERROR_SCALE_MM;
      errorColor(low * (high / low) ** (k / 63)).forEach((v, c) => { row[4 * k + c] = 255 * v; });
      row[4 * k + 3] = 255;
    }
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 64, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, row);
    for (const [key, value] of [["MIN_FILTER", gl.LINEAR], ["MAG_FILTER", gl.LINEAR], ["WRAP_S", gl.CLAMP_TO_EDGE], ["WRAP_T", gl.CLAMP_TO_EDGE]])
      gl.texParameteri(gl.TEXTURE_2D, gl["TEXTURE_" + key], value);
    this.listen();
    new ResizeObserver(() => this.redraw()).observe(this.canvas);
  }

  program(vertex, fragment) {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    const places = {};
    for (let k = 0; k < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); k++) {
      const name = gl.getActiveUniform(program, k).name;
      places[name] = gl.getUniformLocation(program, name);
    }
    return { program, places };
  }

  // `film`: airway and poses, and functions for places and colours at a frame (decodeFilm of player.js, LiveFilm of
  // live.js); `host`: where the canvas goes.
  open(film, host) {
    const gl = this.gl, { airway } = film;
    this.film = film;
    host.prepend(this.canvas, this.compass);
    if (this.array) { [this.array, this.lastArray].forEach(a => gl.deleteVertexArray(a)); this.buffers.forEach(b => gl.deleteBuffer(b)); }
    this.buffers = [];
    const attribute = (index, size, data) => {
      const buffer = gl.createBuffer();
      this.buffers.push(buffer);
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(index);
      gl.vertexAttribPointer(index, size, gl.FLOAT, false, 0, 0);
      return buffer;
    };
    const [codes, faces] = [gl.createBuffer(), gl.createBuffer()];
    this.buffers.push(codes, faces);
    this.codes = codes;
    gl.bindBuffer(gl.ARRAY_BUFFER, codes);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(airway.inspiration.length / 3).fill(255), gl.STATIC_DRAW);
    // The wall between two states, which the phase blends.
    const wall = (start, end) => {
      const array = gl.createVertexArray();
      gl.bindVertexArray(array);
      attribute(0, 3, start);
      attribute(1, 3, end);
      attribute(2, 3, normalsOf(start, airway.faces));
      attribute(3, 3, normalsOf(end, airway.faces));
      gl.bindBuffer(gl.ARRAY_BUFFER, codes);
      gl.enableVertexAttribArray(4);
      gl.vertexAttribPointer(4, 1, gl.FLOAT, false, 0, 0);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, faces);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, airway.faces, gl.STATIC_DRAW);
      gl.bindVertexArray(null);
      return array;
    };
    this.array = wall(airway.inspiration, airway.expiration);
    this.lastArray = airway.last ? wall(airway.last, airway.last) : null;
    this.coded = null;
    const low = [1e9, 1e9, 1e9], high = [-1e9, -1e9, -1e9];
    for (const vertices of [airway.inspiration, airway.expiration, airway.last || []])
      for (let k = 0; k < vertices.length; k++) { low[k % 3] = Math.min(low[k % 3], vertices[k]); high[k % 3] = Math.max(high[k % 3], vertices[k]); }
    this.centre = mix3(low, high, 0.5);
    this.half = sub(high, low).map(v => v / 2);
    this.radius = Math.hypot(...this.half);
    this.view = { kind: "outside", azimuth: -0.45, elevation: 0.16, zoom: 1, shift: [0, 0] };
    this.redraw();
  }

  set(changes) { Object.assign(this.state, changes); this.redraw(); }

  // Another view, with all of it in sight.
  show(kind) { Object.assign(this.view, { kind, zoom: 1, shift: [0, 0] }); this.redraw(); }

  // The scope looks where the film says: its view is not turned or moved.
  turn(azimuth, elevation) {
    const { view } = this;
    if (this.isRide()) return;
    view.azimuth += azimuth;
    view.elevation = within(-MOST_ELEVATION, MOST_ELEVATION, view.elevation + elevation);
  }

  zoomBy(factor) { this.view.zoom = within(...ZOOMS, this.view.zoom * factor); }

  // `right` and `up` in mm: never so far that nothing is left in sight.
  move(right, up) {
    const { shift } = this.view;
    if (this.isRide()) return;
    [right, up].forEach((by, k) => { shift[k] = within(-0.8 * this.radius, 0.8 * this.radius, shift[k] + by); });
  }

  redraw() {
    if (this.pending || !this.film) return;
    this.pending = requestAnimationFrame(() => { this.pending = 0; this.draw(); });
  }

  // --- turning and zooming: fingers scroll the page up and down and turn the airway sideways ------------------------
  listen() {
    const fingers = new Map(), canvas = this.canvas;
    canvas.addEventListener("pointerdown", e => { fingers.set(e.pointerId, [e.clientX, e.clientY]); canvas.setPointerCapture(e.pointerId); });
    const lift = e => fingers.delete(e.pointerId);
    canvas.addEventListener("pointerup", lift);
    canvas.addEventListener("pointercancel", lift);
    canvas.addEventListener("pointermove", e => {
      const before = fingers.get(e.pointerId);
      if (!before) return;
      const [dx, dy] = [e.clientX - before[0], e.clientY - before[1]];
      if (fingers.size === 2) {
        const other = [...fingers].find(([id]) => id !== e.pointerId)[1];
        const spread = p => Math.hypot(p[0] - other[0], p[1] - other[1]);
        this.zoomBy(spread([e.clientX, e.clientY]) / Math.max(1, spread(before)));
      } else if (e.shiftKey || e.buttons & 6) {
        const mm = this.seenMm / canvas.clientHeight;
        this.move(-dx * mm, dy * mm);
      } else this.turn(-dx * 0.008, dy * 0.008);
      fingers.set(e.pointerId, [e.clientX, e.clientY]);
      this.redraw();
    });
    canvas.addEventListener("contextmenu", e => e.preventDefault());
    // Only with the focus: a page that is scrolled past must not zoom.
    canvas.addEventListener("wheel", e => {
      if (document.activeElement !== canvas && !e.ctrlKey) return;
      e.preventDefault();
      this.zoomBy(Math.exp(-e.deltaY * 0.0012));
      this.redraw();
    }, { passive: false });
    canvas.addEventListener("keydown", e => {
      // As a drag in the arrow's direction.
      const step = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[e.key];
      if (step) this.turn(...step);
      else if (e.key === "+" || e.key === "=") this.zoomBy(1.15);
      else if (e.key === "-") this.zoomBy(1 / 1.15);
      else return;
      e.preventDefault();
      this.redraw();
    });
  }

  // Pose between two frames: axes x, y, z and the centre.
  poseAt(frame) {
    const poses = this.film.poses, last = poses.length / 12 - 1;
    const a = Math.min(last, Math.floor(frame)), b = Math.min(last, a + 1), t = frame - a;
    const part = k => mix3([...poses.subarray(12 * a + 3 * k, 12 * a + 3 * k + 3)], [...poses.subarray(12 * b + 3 * k, 12 * b + 3 * k + 3)], t);
    return { x: unit(part(0)), y: unit(part(1)), z: unit(part(2)), centre: part(3) };
  }

  // Whether it is seen from the scope; before the first pose nothing is.
  isRide() { return this.view.kind === "ride" && this.film.poses.length > 0; }

  camera(aspect) {
    const { view, radius } = this;
    if (this.isRide()) {
      const pose = this.poseAt(this.state.frame), back = pose.z.map(v => -v), up = pose.y.map(v => -v);
      const matrix = multiply(perspective(this.film.tanHalfHeight / view.zoom, aspect, 0.2, 4 * radius), viewOf(pose.centre, pose.x, up, back));
      return { eye: pose.centre, matrix, light: back };
    }
    const [ca, sa, ce, se] = [Math.cos(view.azimuth), Math.sin(view.azimuth), Math.cos(view.elevation), Math.sin(view.elevation)];
    // Azimuth 0 looks from the front, as at a person who stands before us.
    const back = [sa * ce, -ca * ce, se], x = [ca, sa, 0], up = cross(back, x);
    const tan = 0.27;
    // As near as the box around both breaths allows, in this direction.
    const isNear = view.kind === "near" && this.film.poses.length > 0, half = isNear ? [NEAR_MM, NEAR_MM, NEAR_MM] : this.half;
    const reach = axis => Math.abs(axis[0]) * half[0] + Math.abs(axis[1]) * half[1] + Math.abs(axis[2]) * half[2];
    const distance = (Math.max(reach(up) / tan, reach(x) / (tan * aspect)) * 0.96 + 0.6 * reach(back)) / view.zoom;
    this.seenMm = 2 * distance * tan;
    const middle = isNear ? this.poseAt(this.state.frame).centre : this.centre;
    const centre = madd(madd(middle, x, view.shift[0]), up, view.shift[1]);
    this.axes = [x, up];
    const eye = madd(centre, back, distance);
    const near = Math.max(distance - 2 * radius, distance * 0.02);
    const matrix = multiply(perspective(tan, aspect, near, distance + 2 * radius), viewOf(eye, x, up, back));
    return { eye, matrix, light: unit(madd(madd(back, x, -0.55), up, 0.75)) };
  }

  // Which way the patient lies, in a corner of the view from outside.
  drawCompass() {
    const isShown = !this.isRide();
    this.compass.classList.toggle("gone", !isShown);
    if (!isShown) return;
    const [x, up] = this.axes;
    this.compass.replaceChildren(...DIRECTIONS.flatMap(([letter, way]) => {
      const [right, down] = [dot(x, way), -dot(up, way)], length = Math.hypot(right, down);
      // What points at us or away from us has no place of its own.
      if (length < 0.6) return [];
      return [el("line", { x1: 0, y1: 0, x2: 19 * right, y2: 19 * down }), el("text", { x: 28 * right, y: 28 * down + 4, "text-anchor": "middle" }, letter)];
    }));
  }

  // Whether the slider has the phase of the film at this frame. At another one, what a row said of this frame does not
  // belong to the wall that is drawn. A live film has no other phase.
  isAtFilmPhase() {
    const { film, state } = this;
    return !!film && (film.isLive || Math.abs(state.phase - film.truePhase(state.frame)) < SAME_PHASE);
  }

  // Path, scope and targets at the cursor.
  solids(dark) {
    const { film, state, radius, view } = this, solids = new Solids(), glow = new Solids();
    const frames = film.poses.length / 12, isRide = this.isRide(), ink = dark ? [0.93, 0.94, 0.96] : [0.12, 0.13, 0.16];
    // What scope, path and balls are in proportion to.
    const size = view.kind === "near" ? 2.2 * NEAR_MM : radius, thin = Math.max(0.35, size * 0.0065), isAtFilmPhase = this.isAtFilmPhase();
    if (state.path && !isRide && frames > 1) {
      const points = [], radii = [], colors = [], step = Math.max(1, Math.floor(frames / 300));
      for (let k = 0; k < frames - 1 + step; k += step) {
        const f = Math.min(k, frames - 1);
        points.push([...film.poses.subarray(12 * f + 9, 12 * f + 12)]);
        const past = f <= state.frame;
        const color = state.row && film.colorAt(state.row, f) || ink;
        colors.push(past ? color : mix3(color, dark ? [0.3, 0.32, 0.36] : [0.8, 0.81, 0.83], 0.55));
        radii.push(past ? thin * 1.5 : thin * 0.8);
      }
      solids.tube(points, radii, colors);
    }
    if (!isRide && frames && isAtFilmPhase) {
      const pose = this.poseAt(state.frame), length = size * 0.1, at = s => madd(pose.centre, pose.z, s);
      solids.tube([at(-length), at(-length * 0.25), at(0)], [thin * 3.2, thin * 3.2, thin * 2.4], [[0.2, 0.22, 0.26], [0.2, 0.22, 0.26], [0.75, 0.78, 0.82]], 1, 14);
      solids.tube([at(0), at(0.01)], [thin * 2.4, 0], [[1, 0.95, 0.7], [1, 0.95, 0.7]], 1, 14);
      const cone = length * 1.6;
      glow.tube([at(0), at(cone)], [thin, cone * film.tanHalfHeight * 0.8], [[1, 0.84, 0.35], [1, 0.84, 0.35]], dark ? 0.20 : 0.34, 20);
    }
    if (state.targets) {
      const ball = isRide ? 0.7 : size * 0.013;
      const truth = isAtFilmPhase ? film.targetsAt(state.phase, state.frame) : film.targetsByPhase(state.phase);
      const predicted = isAtFilmPhase && state.row && film.predictedTargets(state.row, state.frame) || [];
      const color = predicted.length ? rgbOf(state.row.color) : ink;
      for (const place of truth) solids.sphere(place, ball, ink);
      predicted.forEach((place, k) => {
        if (!place.every(Number.isFinite)) return;
        solids.sphere(place, ball * 1.12, color);
        if (truth[k] && Math.hypot(...sub(place, truth[k])) > 1e-3)
          solids.tube([truth[k], place], [thin * 0.8, thin * 0.8], [color, color]);
      });
      // How well they are known, where a film says it.
      for (const { centre, axes } of film.spreadAt?.(state.frame) || []) glow.ellipsoid(centre, axes, color, dark ? 0.2 : 0.16);
    }
    return [solids, glow];
  }

  drawSolids(solids, camera) {
    const gl = this.gl, { program, places } = this.solidProgram;
    if (!solids.data.length) return;
    gl.useProgram(program);
    gl.uniformMatrix4fv(places.viewProjection, false, camera.matrix);
    gl.uniform3fv(places.light, camera.light);
    gl.bindVertexArray(this.solidArray);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.solidBuffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(solids.data), gl.DYNAMIC_DRAW);
    gl.drawArrays(gl.TRIANGLES, 0, solids.data.length / 10);
  }

  // Whether the wall of the last frame is drawn, which is no blend by the phase: at that frame, with the film's phase.
  showsLast() {
    const { film, state } = this;
    if (!film || !film.airway.last) return false;
    const last = film.poses.length / 12 - 1;
    return state.frame > last - 0.5 && this.isAtFilmPhase();
  }

  // Which error the surface shows: none, one per vertex of the last frame, or the one that follows from the phase. Where
  // the wall that is drawn is not the true one, there is none.
  errorKind() {
    const { row, surface } = this.state;
    if (!row || !surface || !row.surface || row.surface === "unknown" || row.surface === "other_faces") return 0;
    if (!this.isAtFilmPhase()) return 0;
    if (this.film && this.film.airway.last && !this.showsLast()) return 0;
    if (row.surface === "by_phase") return 2;
    if (this.coded !== row) {
      this.gl.bindBuffer(this.gl.ARRAY_BUFFER, this.codes);
      this.gl.bufferData(this.gl.ARRAY_BUFFER, Float32Array.from(row.surface), this.gl.STATIC_DRAW);
      this.coded = row;
    }
    return 1;
  }

  draw() {
    const gl = this.gl, canvas = this.canvas, scale = Math.min(2, window.devicePixelRatio || 1);
    const width = Math.round(canvas.clientWidth * scale), height = Math.round(canvas.clientHeight * scale);
    if (!width || !height) return;
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    gl.viewport(0, 0, width, height);
    const style = getComputedStyle(canvas), dark = style.getPropertyValue("--dark").trim() === "1";
    const isRide = this.isRide(), paper = isRide ? [0, 0, 0] : rgbOf(style.getPropertyValue("--stage").trim());
    gl.clearColor(...paper, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const camera = this.camera(width / height), { program, places } = this.airwayProgram;
    const kind = this.errorKind(), { row, phase, frame } = this.state;
    const stated = kind === 2 ? this.film.statedPhase(row, frame) : null;
    gl.useProgram(program);
    gl.uniformMatrix4fv(places.viewProjection, false, camera.matrix);
    gl.uniform3fv(places.eye, camera.eye);
    gl.uniform3fv(places.light, camera.light);
    gl.uniform1f(places.phase, phase);
    gl.uniform1i(places.errorKind, stated == null && kind === 2 ? 0 : kind);
    gl.uniform1f(places.phaseError, stated == null ? 0 : Math.abs(stated - this.film.truePhase(frame)));
    gl.uniform1i(places.inside, isRide ? 1 : 0);
    gl.uniform1f(places.dark, dark ? 1 : 0);
    const faces = this.film.airway.faces.length, array = this.showsLast() ? this.lastArray : this.array;
    // One layer of glass at a time: first the depth of the nearest wall alone, then its colour. No sorting is needed,
    // and walls behind walls do not pile up to fog.
    const layer = (cull, strength) => {
      gl.useProgram(program);
      gl.bindVertexArray(array);
      gl.enable(gl.CULL_FACE);
      gl.cullFace(cull);
      gl.uniform1f(places.back, strength);
      gl.colorMask(false, false, false, false);
      gl.drawElements(gl.TRIANGLES, faces, gl.UNSIGNED_SHORT, 0);
      gl.colorMask(true, true, true, true);
      gl.enable(gl.BLEND);
      gl.drawElements(gl.TRIANGLES, faces, gl.UNSIGNED_SHORT, 0);
      gl.disable(gl.BLEND);
      gl.disable(gl.CULL_FACE);
    };
    const [solids, glow] = this.solids(dark);
    this.drawCompass();
    if (isRide) {
      gl.bindVertexArray(array);
      gl.drawElements(gl.TRIANGLES, faces, gl.UNSIGNED_SHORT, 0);
      this.drawSolids(solids, camera);
      return;
    }
    // Normals point into the lumen: the far walls are the ones that face us.
    layer(gl.BACK, 0.75);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    this.drawSolids(solids, camera);
    gl.enable(gl.BLEND);
    gl.depthMask(false);
    this.drawSolids(glow, camera);
    gl.depthMask(true);
    gl.disable(gl.BLEND);
    layer(gl.FRONT, 1);
    if (!kind) return;
    // A wall in the colours of errors is dense: path, scope and balls shine through it.
    gl.clear(gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.BLEND);
    gl.blendColor(0, 0, 0, 0.4);
    gl.blendFunc(gl.CONSTANT_ALPHA, gl.ONE_MINUS_CONSTANT_ALPHA);
    this.drawSolids(solids, camera);
    gl.disable(gl.BLEND);
  }
}

// Area-weighted unit normals.
function normalsOf(places, faces) {
  const out = new Float32Array(places.length);
  for (let f = 0; f < faces.length; f += 3) {
    const [a, b, c] = [faces[f], faces[f + 1], faces[f + 2]].map(v => 3 * v);
    const at = k => [places[k], places[k + 1], places[k + 2]];
    const n = cross(sub(at(b), at(a)), sub(at(c), at(a)));
    for (const v of [a, b, c]) for (let k = 0; k < 3; k++) out[v + k] += n[k];
  }
  for (let v = 0; v < out.length; v += 3) {
    const l = Math.hypot(out[v], out[v + 1], out[v + 2]) || 1;
    out[v] /= l; out[v + 1] /= l; out[v + 2] /= l;
  }
  return out;
}

"use strict";
// A case: the film beside the renderings, errors over time and the airway, all under one cursor. Data are read when a
// case is opened, and forgotten when another one is.

// What the scene asks of a film.
function decodeFilm(data) {
  const film = data.film;
  if (!film || !film.airway) return null;
  const phases = floatsOf(film.phases), targets = floatsOf(film.targets_mm), count = targets.length / 6;
  const lerp = (values, at) => {
    const a = Math.min(values.length - 1, Math.floor(at)), b = Math.min(values.length - 1, a + 1);
    return values[a] + (values[b] - values[a]) * (at - a);
  };
  // Where no phase says it: on the clinical track.
  const byFrame = film.targets_by_frame_mm ? floatsOf(film.targets_by_frame_mm) : null;
  const nearestSample = frame => nearest(data.samples, frame);
  const targetsByPhase = phase => Array.from({ length: count }, (_, k) => [0, 1, 2].map(axis => {
    const a = targets[3 * k + axis];
    return a + (targets[3 * (count + k) + axis] - a) * phase;
  }));
  return {
    airway: decodeAirway(film.airway),
    poses: floatsOf(film.poses), tanHalfHeight: film.tan_half_height,
    truePhase: frame => lerp(phases, frame),
    statedPhase: (row, frame) => row.phase[nearestSample(frame)],
    // Of the path: by the error in mm of targets where the row states them, of depth otherwise.
    colorAt: (row, frame) => {
      for (const id of ["target_mean_mm", "depth_rmse_mm"]) {
        const k = data.metrics.findIndex(m => m.id === id);
        if (k >= 0 && row.series[k].some(v => v != null)) {
          const error = row.series[k][nearestSample(frame)];
          return error == null ? null : errorColor(error);
        }
      }
      return null;
    },
    targetsByPhase,
    targetsAt: (phase, frame) => byFrame ? Array.from({ length: count }, (_, k) => [0, 1, 2].map(axis => {
      const last = byFrame.length / (3 * count) - 1, f = Math.min(last, Math.floor(frame)), g = Math.min(last, f + 1);
      const at = frame => byFrame[3 * (count * frame + k) + axis];
      return at(f) + (at(g) - at(f)) * (frame - f);
    })) : targetsByPhase(phase),
    predictedTargets: (row, frame) => {
      if (!row.targets_mm || !row.pictures) return null;
      row.targets = row.targets || floatsOf(row.targets_mm);
      const at = nearest(row.pictures.frames, frame) * 3 * count;
      return Array.from({ length: count }, (_, k) => [...row.targets.subarray(at + 3 * k, at + 3 * k + 3)]);
    },
  };
}

// --- the film ------------------------------------------------------------------------------------------------------
class Film {
  constructor(pictures) { this.pictures = pictures; this.images = []; }
  // The picture nearest to a frame; decoded once, when it is first wanted. `ready` is called when it is.
  at(frame, ready) {
    const k = nearest(this.pictures.frames, frame);
    let image = this.images[k];
    if (!image) {
      image = this.images[k] = new Image();
      image.src = "data:image/jpeg;base64," + this.pictures.jpeg[k];
      image.decode().then(() => { image.isReady = true; this.waiting?.(); }, () => {});
    }
    this.waiting = ready;
    return image.isReady ? image : null;
  }
}

class Tile {
  constructor(player, film, row) {
    this.row = row;
    this.film = new Film(film);
    this.canvas = el("canvas", { width: film.width, height: film.height });
    this.value = el("span", { class: "value" });
    const name = row ? [swatch(row), el("b", {}, row.title)] : [el("b", {}, "Truth")];
    this.element = el("figure", { class: "tile", "data-method": row ? row.method : null },
      row ? el("button", { class: "picture", "aria-pressed": "false", title: `Show the errors of ${row.title} on the airway`, onclick: () => player.pick(row) }, this.canvas)
        : el("div", { class: "picture" }, this.canvas),
      el("figcaption", {}, el("span", { class: "name" }, ...name), this.value));
  }
  draw(player) {
    const again = () => player.drawTiles();
    const own = this.film.at(player.frame, again), context = this.canvas.getContext("2d");
    if (!own) return;
    const { width, height } = this.canvas;
    context.globalCompositeOperation = "source-over";
    context.drawImage(own, 0, 0, width, height);
    if (!this.row || !player.isDifference) return;
    const truth = player.tiles[0].film.at(player.frame, again);
    if (!truth) return;
    context.globalCompositeOperation = "difference";
    context.drawImage(truth, 0, 0, width, height);
    // Twice added to itself: four times as bright.
    context.globalCompositeOperation = "lighter";
    context.drawImage(this.canvas, 0, 0);
    context.drawImage(this.canvas, 0, 0);
  }
}

const swatch = row => el("svg", { class: "swatch", viewBox: "0 0 24 10", "aria-hidden": "true" },
  el("line", { x1: 1, x2: 23, y1: 5, y2: 5, stroke: row.color, "stroke-width": 3.4, "stroke-dasharray": row.dash && row.dash.join(" ") }));

// --- errors over time ------------------------------------------------------------------------------------------------
class ErrorPlot {
  constructor(player) {
    this.player = player;
    this.svg = el("svg", { class: "curves", role: "img" });
    const move = e => {
      const box = this.svg.getBoundingClientRect(), [x, y] = [e.clientX - box.left, e.clientY - box.top];
      if (!this.rows) return;
      this.name(this.rowAt(x, y) || player.row);
      if (e.type !== "pointermove" || e.buttons) player.seek(this.frameAt(x));
    };
    this.svg.addEventListener("pointerdown", e => { this.svg.setPointerCapture(e.pointerId); move(e); });
    this.svg.addEventListener("pointermove", move);
    this.svg.addEventListener("pointerleave", () => this.rows && this.name(player.row));
    new ResizeObserver(() => this.draw()).observe(this.svg);
  }

  // Everything but the cursor, in CSS pixels, so that text has its size on every screen.
  draw() {
    const { svg, player } = this, { data } = player, m = data.metrics[player.metric];
    const width = svg.clientWidth, height = svg.clientHeight;
    if (!width || !height || !m) return;
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    svg.setAttribute("aria-label", `${m.heading} over time`);
    const box = { left: 52, right: width - 12, top: 44, bottom: height - 40 };
    const rows = this.rows = data.rows.filter(row => !player.hidden.has(row.method) && row.series[player.metric].some(v => v != null));
    const values = rows.flatMap(row => row.series[player.metric]).filter(v => v != null && Number.isFinite(v));
    // Errors in mm span decades; the rest does not.
    const isLog = /\[mm\]/.test(m.heading) && values.some(v => v > 0);
    const floor = 0.01;
    let [low, high] = [Math.min(...values), Math.max(...values)];
    if (!values.length) [low, high] = [0, 1];
    // What is less stands on the floor, which says so.
    const isCut = isLog && low < floor;
    if (isLog) { low = isCut ? floor : low / 1.25; high = Math.max(high, low * 4) * 1.25; }
    else { const margin = (high - low) * 0.06 || 0.05; low = m.higher || low < 0 ? low - margin : Math.max(0, low - margin); high += margin; }
    const y = this.y = v => {
      const share = isLog ? Math.log(Math.max(v, low) / low) / Math.log(high / low) : (v - low) / (high - low);
      return box.bottom - share * (box.bottom - box.top);
    };
    const end = data.times_s[data.times_s.length - 1] || 1;
    this.x = time => box.left + time / end * (box.right - box.left);
    this.frameAt = px => {
      const time = (px - box.left) / (box.right - box.left) * end, k = nearest(data.times_s, time);
      const next = data.times_s[k] < time ? k + 1 : k - 1, share = data.times_s[next] === undefined ? 0 : (time - data.times_s[k]) / (data.times_s[next] - data.times_s[k]);
      return data.samples[k] + (share ? share * (data.samples[next] - data.samples[k]) : 0);
    };
    const parts = [el("text", { x: 8, y: 15, class: "title" }, `${m.heading} ${m.higher ? "↑" : "↓"}`)];
    // Each from half way to the frame before to half way to the next, so that there are no gaps.
    const { times_s: times } = data, edge = k => Math.round(this.x(k < 0 ? 0 : k + 1 < times.length ? (times[k] + times[k + 1]) / 2 : end));
    const bands = data.phases.map((p, k) => el("rect", { x: edge(k - 1), width: edge(k) - edge(k - 1), y: box.bottom + 1, height: 5, class: "breath", "fill-opacity": (0.08 + 0.82 * p).toFixed(2) }));
    const ticks = isLog ? logTicks(low, high, (box.bottom - box.top) / 22) : linearTicks(low, high, Math.max(2, (box.bottom - box.top) / 42));
    for (const v of ticks) parts.push(el("line", { x1: box.left, x2: box.right, y1: y(v), y2: y(v), class: "grid" }), el("text", { x: box.left - 6, y: y(v) + 4, "text-anchor": "end" }, isCut && v <= floor * 1.001 ? `≤ ${label(v)}` : label(v)));
    for (const v of linearTicks(0, end, Math.max(2, (box.right - box.left) / 80))) parts.push(el("text", { x: this.x(v), y: box.bottom + 20, "text-anchor": "middle" }, label(v)));
    parts.push(el("text", { x: (box.left + box.right) / 2, y: height - 5, "text-anchor": "middle", class: "muted" }, width < 420 ? "seconds; strong band: expiration" : "seconds; the band is stronger towards expiration"), ...bands);
    // The chosen row last, on top of the others.
    const chosen = player.row, curves = el("g", { class: "rows" });
    this.curves = new Map();
    for (const row of [...rows].sort((a, b) => (a === chosen) - (b === chosen))) {
      let path = "", pen = "M";
      row.series[player.metric].forEach((v, k) => {
        if (v == null) { if (row.series[player.metric].filter(x => x != null).length > data.samples.length / 2) pen = "M"; return; }
        path += `${pen}${this.x(data.times_s[k]).toFixed(1)} ${y(v).toFixed(1)}`; pen = "L";
      });
      const curve = el("path", { d: path, fill: "none", stroke: row.color, "stroke-dasharray": row.dash && row.dash.join(" "), "stroke-linejoin": "round" });
      this.curves.set(row, curve);
      curves.append(curve);
    }
    this.cursor = el("line", { y1: box.top - 4, y2: box.bottom + 6, class: "cursor" });
    this.named = el("g");
    svg.replaceChildren(...parts, curves, this.cursor, this.named);
    this.name(chosen);
    this.move();
  }

  // The row whose curve passes near a place, if there is one.
  rowAt(x, y) {
    const { data, metric } = this.player, frame = this.frameAt(x), last = data.samples.length - 1;
    const b = Math.min(last, Math.max(1, data.samples.findIndex(sample => sample >= frame))), a = Math.max(0, b - 1);
    const share = a === b ? 0 : (frame - data.samples[a]) / (data.samples[b] - data.samples[a]);
    let [near, least] = [null, 12];
    for (const row of this.rows) {
      const [from, to] = [row.series[metric][a], row.series[metric][b]];
      if (from == null || to == null) continue;
      const off = Math.abs(this.y(from) + (this.y(to) - this.y(from)) * share - y);
      if (off < least) [near, least] = [row, off];
    }
    return near;
  }

  // Says whose curve it is, and makes it stand out beside the chosen one.
  name(row) {
    for (const [other, curve] of this.curves) {
      const isShown = other === row || other === this.player.row;
      curve.setAttribute("stroke-width", isShown ? 3.2 : 1.6);
    }
    const line = row && el("g", { class: "rows" }, el("line", { x1: 8, x2: 30, y1: 29, y2: 29.01, stroke: row.color, "stroke-width": 3.4, "stroke-dasharray": row.dash && row.dash.join(" ") }));
    this.named.replaceChildren(...row ? [line, el("text", { x: 37, y: 33 }, row.title)] : []);
  }

  move() {
    if (!this.cursor) return;
    const x = this.x(this.player.time());
    this.cursor.setAttribute("x1", x); this.cursor.setAttribute("x2", x);
  }
}

function logTicks(low, high, wanted) {
  const decades = [];
  for (let d = Math.floor(Math.log10(low)); d <= Math.ceil(Math.log10(high)); d++) decades.push(d);
  for (const steps of [[1, 2, 5], [1, 3], [1]]) {
    const out = decades.flatMap(d => steps.map(s => s * 10 ** d)).filter(v => v >= low * (1 - 1e-9) && v <= high);
    if (out.length <= wanted || steps.length === 1) return out;
  }
}

// --- the case --------------------------------------------------------------------------------------------------------
class CasePlayer {
  constructor(host, data, page) {
    Object.assign(this, { host, data, page, frame: 0, metric: 0, row: null, isDifference: false, hidden: page.hidden });
    const film = data.film;
    this.frames = film ? floatsOf(film.times_s) : Float32Array.from(data.times_s);
    this.last = film ? this.frames.length - 1 : data.samples[data.samples.length - 1];
    this.tiles = film && film.pictures.frames.length ? [new Tile(this, film.pictures, null), ...data.rows.filter(row => row.pictures).map(row => new Tile(this, row.pictures, row))] : [];
    for (const row of data.rows) if (row.surface && row.surface.at_end) row.surface = bytesOf(row.surface.at_end);
    this.plot = new ErrorPlot(this);
    this.build(film && film.airway && page.scene().isUsable ? decodeFilm(data) : null);
    this.hide();
    this.seek(0);
  }

  // Of the rows that the filter leaves the one that is best by the first metric; a bound, which is no method, only where
  // there is nothing else.
  best() {
    const mean = row => { const known = row.series[0]?.filter(v => v != null) || []; return known.length ? known.reduce((a, b) => a + b) / known.length : Infinity; };
    const sign = this.data.metrics[0]?.higher ? -1 : 1, worst = row => Number.isFinite(mean(row)) ? sign * mean(row) : Infinity;
    const left = this.data.rows.filter(row => !this.hidden.has(row.method));
    return left.sort((a, b) => a.is_bound - b.is_bound || (worst(a) < worst(b) ? -1 : worst(a) > worst(b) ? 1 : 0))[0] || null;
  }

  build(film) {
    const { data } = this, id = name => `${name}-${this.host.id}`;
    this.play = el("button", { class: "play", "aria-label": "Play", onclick: () => this.toggle() }, "▶");
    this.slider = el("input", { type: "range", min: 0, max: this.last, step: "any", value: 0, id: id("time"), oninput: () => this.seek(+this.slider.value), onkeydown: e => this.step(e) });
    this.readout = el("output", { for: id("time") });
    const options = (list, name) => list.map((entry, k) => el("option", { value: k }, name(entry)));
    this.metricSelect = el("select", { id: id("metric"), onchange: () => { this.metric = +this.metricSelect.value; this.plot.draw(); this.drawTiles(); } }, ...options(data.metrics, m => m.heading));
    this.rowSelect = el("select", { id: id("row"), onchange: () => this.pick(data.rows[+this.rowSelect.value]) }, ...options(data.rows, row => row.title));
    const bar = el("div", { class: "bar" }, this.play,
      el("label", { class: "grow", for: id("time") }, el("span", { class: "hidden" }, "Time"), this.slider), this.readout);
    const picks = el("div", { class: "picks" },
      el("label", {}, "Curves ", this.metricSelect), el("label", {}, "Errors of ", this.rowSelect),
      data.film && data.rows.some(row => row.pictures) ? check("Difference to the truth, 4 times as bright", false, on => { this.isDifference = on; this.drawTiles(); }) : null);
    // What the numbers of the tiles are.
    this.beside = el("p", { class: "muted note" });
    const stage = film ? this.buildStage(film, id) : null;
    const why = stage || data.film && !data.film.airway ? null : data.film ? "This browser has no WebGL 2: the airway is not drawn." : "This run kept no film and no airway of the case.";
    if (why) this.host.append(el("p", { class: "muted" }, why));
    this.host.append(
      el("div", { class: stage ? "views" : "views one" }, stage, el("div", { class: "side" }, picks, this.plot.svg)),
      bar,
      this.tiles.length ? this.beside : "",
      this.tiles.length ? el("div", { class: "film" }, ...this.tiles.map(tile => tile.element)) : "");
    if (film) this.page.scene().open(film, this.stage);
  }

  buildStage(film, id) {
    this.film = film;
    const scene = this.page.scene();
    this.stage = el("div", { class: "stage" });
    const views = [["outside", "From outside"], ["ride", "Ride along"]].map(([kind, name]) =>
      el("button", { "aria-pressed": String(kind === "outside"), onclick: e => {
        scene.show(kind);
        for (const button of views) button.setAttribute("aria-pressed", String(button === e.currentTarget));
        this.explain();
      } }, name));
    this.phaseSlider = el("input", { type: "range", min: 0, max: 1, step: 0.005, value: 0, id: id("phase"), oninput: () => {
      this.follows.checked = false;
      this.setPhase(+this.phaseSlider.value);
    } });
    this.phaseReadout = el("output", { for: id("phase") });
    const follow = check("as in the film", true, on => { if (on) this.setPhase(film.truePhase(this.frame)); });
    this.follows = follow.querySelector("input");
    this.legend = el("div", { class: "scale" });
    this.note = el("p", { class: "muted note" });
    return el("div", { class: "scene" },
      el("div", { class: "tools" }, el("span", { class: "group", role: "group", "aria-label": "View" }, ...views),
        check("path", scene.state.path, on => scene.set({ path: on })), check("targets", scene.state.targets, on => scene.set({ targets: on })), check("error as colour", scene.state.surface, on => { scene.set({ surface: on, row: this.row }); this.explain(); })),
      this.stage,
      el("div", { class: "phase" }, el("label", { for: id("phase") }, "Phase"), el("span", { class: "ends" }, "in"), this.phaseSlider, el("span", { class: "ends" }, "out"), this.phaseReadout, follow),
      this.legend, this.note);
  }

  setPhase(phase) {
    this.phaseSlider.value = phase;
    this.phaseReadout.value = phase.toFixed(2);
    this.page.scene().set({ phase });
    this.explainChange();
  }

  // What the words below the scene depend on, besides the row and the view.
  shownState() {
    const scene = this.page.scene();
    return `${scene.errorKind()} ${scene.showsLast()} ${scene.isAtFilmPhase()}`;
  }

  // The words below the scene where they no longer hold.
  explainChange() { if (this.explained !== this.shownState()) this.explain(); }

  // What the wall shows.
  wallWords() {
    const { row, film } = this, scene = this.page.scene(), known = scene.errorKind();
    if (!scene.isAtFilmPhase()) return "The slider has another phase than the film at this frame: scope, predictions and colours of error are not shown. Balls: targets at the slider's phase.";
    const fades = known && scene.state.surface ? " Below 0.1 mm it keeps the colour of tissue." : "";
    const balls = " Balls: targets, true in black or white" + (row?.targets_mm ? ", predicted in the row's colour." : ".");
    const path = row ? " The path: its mean target error, or depth error, as the scope passed." : "";
    const has = row && row.surface && row.surface !== "unknown" && row.surface !== "other_faces";
    const wall = !scene.state.surface || !row ? "" :
      known === 1 ? `The wall: distance of ${row.title} to the true one at the last frame.` :
      known === 2 ? `The wall: distance of ${row.title} to the true one, which follows from the phase it states.` :
      has ? "" :
      row.surface === "other_faces" ? `The surface of ${row.title} has other faces than the film's, and no correspondence.csv: the wall has no colour.` :
      `No surface of ${row.title} is known point by point: the wall has no colour.`;
    const blend = film.airway.last && !scene.showsLast() ? "The wall is a blend of both breath holds by the phase. Tissue also moves beyond the breath here: the true wall is known at the last frame alone" + (has && scene.state.surface ? `, where the error of ${row.title} has its colour. ` : ". ") : "";
    return blend + wall + fades + path + balls;
  }

  explain() {
    if (!this.legend) return;
    const scene = this.page.scene(), degrees = 2 * Math.atan(this.film.tanHalfHeight) * 180 / Math.PI;
    this.legend.replaceChildren(el("i", { style: `background:linear-gradient(90deg,${ERROR_STOPS.join(",")})` }), ...["0.1", "1", "10 mm"].map(text => el("span", {}, text)));
    this.explained = this.shownState();
    this.note.textContent = (scene.isRide() ? `Seen by a pinhole camera of ${degrees.toFixed(0)} degrees from top to bottom, without the distortion of the film's lens. ` : "") + this.wallWords();
  }

  // A row that the reader wants: it is taken again when a filter that hides it is taken off.
  pick(row) { this.picked = row; this.choose(row); }

  choose(row) {
    this.row = row;
    this.rowSelect.value = row ? this.data.rows.indexOf(row) : "";
    for (const tile of this.tiles) tile.element.querySelector("button")?.setAttribute("aria-pressed", String(tile.row === row));
    if (this.film) { this.page.scene().set({ row }); this.explain(); }
    this.plot.draw();
  }

  time() {
    const a = Math.floor(this.frame), b = Math.min(this.last, a + 1);
    if (this.data.film) return this.frames[a] + (this.frames[b] - this.frames[a]) * (this.frame - a);
    return this.data.times_s[nearest(this.data.samples, this.frame)];
  }

  seek(frame) {
    this.frame = Math.min(this.last, Math.max(0, frame));
    this.slider.value = this.frame;
    const phase = this.film ? this.film.truePhase(this.frame) : this.data.phases[nearest(this.data.samples, this.frame)];
    const shown = Number.isInteger(this.frame) ? this.frame : this.frame.toFixed(1);
    this.readout.value = `${this.time().toFixed(2)} s · frame ${shown} · phase ${phase.toFixed(2)}`;
    this.slider.setAttribute("aria-valuetext", this.readout.value);
    if (this.film) {
      this.page.scene().set({ frame: this.frame });
      if (this.follows.checked) this.setPhase(phase);
      this.explainChange();
    }
    this.plot.move();
    this.drawTiles();
  }

  // Keys of the slider: from frame to frame.
  step(e) {
    const by = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageUp: 10, PageDown: -10 }[e.key];
    if (!by || e.ctrlKey || e.altKey || e.metaKey) return;
    e.preventDefault();
    this.seek(Math.round(this.frame) + by);
  }

  drawTiles() {
    const m = this.data.metrics[this.metric], k = nearest(this.data.samples, this.frame);
    this.beside.textContent = m ? `Number beside each name: ${m.heading} at this frame; ${m.higher ? "higher" : "lower"} is better.` : "";
    for (const tile of this.tiles) {
      tile.draw(this);
      if (!tile.row) { tile.value.textContent = ""; continue; }
      const value = tile.row.series[this.metric][k];
      tile.value.textContent = value == null ? "–" : value.toFixed(m.digits);
    }
  }

  toggle() {
    this.isPlaying = !this.isPlaying;
    this.play.textContent = this.isPlaying ? "❚❚" : "▶";
    this.play.setAttribute("aria-label", this.isPlaying ? "Pause" : "Play");
    // Else a press on pause and play within one picture would leave two loops.
    cancelAnimationFrame(this.playing);
    if (!this.isPlaying) return;
    if (this.frame >= this.last) this.seek(0);
    const rate = this.last / (this.frames[this.frames.length - 1] || 1);
    let before = performance.now();
    const step = now => {
      if (!this.isPlaying) return;
      this.seek(this.frame + (now - before) / 1000 * rate);
      before = now;
      if (this.frame >= this.last) { this.toggle(); return; }
      this.playing = requestAnimationFrame(step);
    };
    this.playing = requestAnimationFrame(step);
  }

  // Rows that the filter hides; of one that is hidden no errors are shown.
  hide() {
    this.data.rows.forEach((row, k) => {
      const option = this.rowSelect.options[k];
      option.hidden = option.disabled = this.hidden.has(row.method);
    });
    const isLeft = row => row && !this.hidden.has(row.method);
    this.choose(isLeft(this.picked) ? this.picked : this.best());
    for (const tile of this.tiles) if (tile.row) tile.element.hidden = this.hidden.has(tile.row.method);
  }

  close() {
    if (this.isPlaying) this.toggle();
    this.host.replaceChildren();
  }
}

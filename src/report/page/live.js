"use strict";
// The live page: lines come as server-sent events, everything is drawn anew at most once per frame of the screen.

// Seconds that the curves show.
const SHOWN_S = 30;
// Milliseconds between two drawings of the curves.
const CURVE_MS = 100;

const STATE_WORDS = {
  waiting: ["Waiting", "for the first frame"],
  tracking: ["Tracking", "the picture agrees with the answer"],
  unsure: ["Unsure", "do not rely on this answer alone"],
  lost: ["Lost", "the picture does not agree with the answer"],
};
// Milliseconds between two sentences to a screen reader.
const SPOKEN_MS = 5000;
const STATE_SIGNS = { waiting: "…", tracking: "●", unsure: "▲", lost: "✕" };

// A curve over the last seconds.
class LiveCurve {
  constructor(film, title, parts) {
    Object.assign(this, { film, title, parts });
    this.svg = el("svg", { class: "curves", role: "img", "aria-label": title });
    new ResizeObserver(() => this.draw()).observe(this.svg);
  }

  draw() {
    const { svg, film } = this, width = svg.clientWidth, height = svg.clientHeight, { time } = film.columns, n = film.count;
    if (!width || !height) return;
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    const end = n ? time[n - 1] : 0, span = Math.min(SHOWN_S, Math.max(2, n ? end - time[0] : 0)), start = Math.max(n ? time[0] : 0, end - span);
    let first = n;
    while (first > 0 && time[first - 1] >= start) first--;
    const box = { left: 40, right: width - 10, top: 24, bottom: height - 22 };
    box.x = t => box.left + (t - start) / span * (box.right - box.left);
    const { low, high, ticks } = this.parts.range(first, n);
    box.y = v => box.bottom - (Math.min(high, Math.max(low, v)) - low) / (high - low) * (box.bottom - box.top);
    const nodes = [el("text", { x: 0, y: 14, class: "title" }, this.title)];
    for (const [v, name] of ticks) nodes.push(
      el("line", { x1: box.left, x2: box.right, y1: box.y(v), y2: box.y(v), class: "grid" }),
      el("text", { x: box.left - 6, y: box.y(v) + 4, "text-anchor": "end" }, name));
    for (const t of linearTicks(start, start + span, Math.max(2, width / 90)))
      if (box.x(t) < box.right - 12) nodes.push(el("text", { x: box.x(t), y: height - 4, "text-anchor": "middle" }, label(t)));
    nodes.push(el("text", { x: box.right, y: height - 4, "text-anchor": "end" }, "s"));
    svg.replaceChildren(...nodes, ...this.parts.draw(box, first, n));
  }
}

const pathOf = points => points.map(([x, y], k) => `${k ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("");

class LivePage {
  constructor(data) {
    this.data = data;
    this.film = new LiveFilm(data);
    const scene = new AirwayScene();
    this.airway = this.film.airway && scene.isUsable ? scene : null;
    this.walls = false;
    this.build();
    document.getElementById("tools").append(themeButton(() => this.recolor()));
    document.documentElement.classList.add("scripted");
    this.listen();
    this.refresh();
  }

  // As the page of a report has it.
  scene() { return this.airway; }

  // --- what stands on the page -------------------------------------------------------------------------------------
  build() {
    this.sign = el("span", { class: "sign", "aria-hidden": "true" });
    this.word = el("b");
    this.why = el("span", { class: "why" });
    this.link = el("span", { class: "link" }, "connecting");
    this.state = el("p", { class: "state" }, this.sign, this.word, this.why, this.link);
    // What a screen reader says: at most every few seconds, however often the state changes.
    this.said = el("span", { class: "hidden", role: "status" });
    const { columns } = this.film;
    const indices = (first, n) => Array.from({ length: n - first }, (_, k) => first + k);
    const line = (box, values, first, n) => el("path", { d: pathOf(indices(first, n).map(k => [box.x(columns.time[k]), box.y(values[k])])), class: "line" });
    this.phaseCurve = new LiveCurve(this.film, "Phase, ± two deviations", {
      range: () => ({ low: -0.05, high: 1.05, ticks: [[0, "in"], [0.5, "0.5"], [1, "out"]] }),
      draw: (box, first, n) => {
        const edge = sign => indices(first, n).map(k => [box.x(columns.time[k]), box.y(columns.phase[k] + sign * 2 * columns.deviation[k])]);
        const strip = [];
        for (let k = first, from = first; k < n; k++) {
          if (k + 1 < n && columns.state[k + 1] === columns.state[from]) continue;
          const left = box.x(columns.time[from]), right = k + 1 < n ? box.x(columns.time[k + 1]) : box.x(columns.time[k]) + 2;
          strip.push(el("rect", { x: left, width: Math.max(1, right - left), y: box.bottom + 1, height: 5, class: STATES[columns.state[from]] }));
          from = k + 1;
        }
        return [el("path", { d: pathOf([...edge(1), ...edge(-1).reverse()]), class: "band" }), line(box, columns.phase, first, n), ...strip];
      },
    });
    this.latencyCurve = new LiveCurve(this.film, "Latency, ms", {
      range: (first, n) => {
        let high = 20;
        for (let k = first; k < n; k++) high = Math.max(high, columns.latency[k] * 1.1);
        return { low: 0, high, ticks: linearTicks(0, high, 3).map(v => [v, label(v)]) };
      },
      draw: (box, first, n) => [line(box, columns.latency, first, n), ...indices(first, n).filter(k => columns.leftOut[k] > 0).map(k => {
        const x = box.x(columns.time[k]);
        return el("line", { x1: x, x2: x, y1: box.bottom - 7, y2: box.bottom, class: "left-out" });
      })],
    });
    this.values = {};
    const fact = (name, text) => [el("dt", {}, text), this.values[name] = el("dd", {}, "–")];
    const facts = el("dl", { class: "facts" }, ...fact("frame", "Frame"), ...fact("phase", "Phase"), ...fact("nearest", "Nearest target"),
      ...fact("worst", "Least known target"), ...fact("masked", "Not wall"), ...fact("latency", "Latency"), ...fact("leftOut", "Left out"));
    const [width, height] = this.data.picture_px;
    this.picture = el("canvas", { width, height, role: "img", "aria-label": "The frame just answered" });
    this.overlay = check("tint what was not used", false, on => { this.walls = on; this.shownLine = null; this.fetchPicture(); });
    this.overlay.hidden = true;
    const seen = el("div", { class: "seen" }, el("figure", { class: "shown" }, this.picture, this.overlay), facts);
    const side = el("div", { class: "side" }, seen, this.phaseCurve.svg, this.latencyCurve.svg,
      el("p", { class: "muted note" }, "Strip below the phase: green tracking, amber unsure, red lost. Red ticks at the foot of the latency: frames left out."));
    document.getElementById("live").append(this.state, this.said, el("div", { class: "views" }, this.buildStage(), side));
  }

  buildStage() {
    const scene = this.airway;
    if (!scene) return el("p", { class: "muted" }, this.film.airway ? "This browser has no WebGL 2: the airway is not drawn." : "The two surfaces of this film do not fit each other: the airway is not drawn.");
    const stage = el("div", { class: "stage" });
    const views = [["outside", "Whole airway"], ["near", "Near the scope"], ["ride", "From the scope"]].map(([kind, name]) =>
      el("button", { "aria-pressed": String(kind === "outside"), onclick: e => {
        scene.show(kind);
        for (const button of views) button.setAttribute("aria-pressed", String(button === e.currentTarget));
      } }, name));
    scene.state.row = { color: "#000000" };
    scene.open(this.film, stage);
    return el("div", { class: "scene" },
      el("div", { class: "tools" }, el("span", { class: "group", role: "group", "aria-label": "View" }, ...views),
        check("path", true, on => scene.set({ path: on })), check("targets", true, on => scene.set({ targets: on }))),
      stage,
      el("p", { class: "muted note" }, "The wall is the blend of both breath holds by the phase. The path has the colour of the state. Balls are targets where the answer puts them, each in a veil of two deviations; so is every ±."));
  }

  // Colours of the scene are those of the page.
  recolor() {
    const style = getComputedStyle(document.documentElement), color = name => style.getPropertyValue(name).trim();
    this.film.colors = STATES.map(state => rgbOf(color(`--${state}`)));
    if (this.airway) this.airway.set({ row: { color: color("--accent") } });
    this.phaseCurve.draw();
  }

  // --- lines -------------------------------------------------------------------------------------------------------
  listen() {
    const source = this.source = new EventSource(`events?run=${this.data.run}`);
    source.onopen = () => this.connection("live");
    source.onmessage = event => { this.film.add(JSON.parse(event.data), +event.lastEventId); this.changed(); };
    source.onerror = () => this.connection("connection lost, trying again", true);
    source.addEventListener("end", event => { source.close(); this.ended(JSON.parse(event.data)); });
    // Another run is served at this address: its page has another airway.
    source.addEventListener("other", () => { source.close(); location.reload(); });
  }

  speak() {
    if (this.speaking) return;
    const now = () => `${this.word.textContent} ${this.why.textContent}; ${this.link.textContent}`;
    this.said.textContent = now();
    this.speaking = setTimeout(() => { this.speaking = 0; if (this.said.textContent !== now()) this.speak(); }, SPOKEN_MS);
  }

  connection(text, isBad = false) {
    this.link.textContent = text;
    this.speak();
    this.link.classList.toggle("bad", isBad);
  }

  ended({ frames, left_out, latency_ms, error }) {
    this.isEnded = true;
    this.connection(error ? `stopped: ${error}` : `the film has ended: ${frames} frames answered, ${left_out} left out, latency ${latency_ms[0].toFixed(0)} ms (median), ${latency_ms[1].toFixed(0)} ms (99 %)`, !!error);
    this.changed();
  }

  changed() {
    if (this.pending) return;
    this.pending = requestAnimationFrame(() => { this.pending = 0; this.refresh(); });
  }

  // --- drawing -----------------------------------------------------------------------------------------------------
  refresh() {
    const line = this.film.last, state = line ? line.state : "waiting";
    if (this.state.dataset.state !== state) {
      this.state.dataset.state = state;
      this.sign.textContent = STATE_SIGNS[state];
      [this.word.textContent, this.why.textContent] = STATE_WORDS[state];
      this.speak();
    }
    if (line) this.show(line);
    this.fetchPicture();
    const now = performance.now();
    clearTimeout(this.later);
    if (now - (this.drawn || 0) < CURVE_MS) { this.later = setTimeout(() => this.refresh(), CURVE_MS); return; }
    this.drawn = now;
    this.phaseCurve.draw();
    this.latencyCurve.draw();
  }

  show(line) {
    const set = (name, text) => { this.values[name].textContent = text; };
    set("frame", `${line.frame}, ${line.time_s.toFixed(2)} s`);
    set("phase", line.phase.toFixed(2) + (line.phase_deviation == null ? "" : ` ± ${(2 * line.phase_deviation).toFixed(2)}`));
    const targets = this.film.targets(), two = target => (2 * target.deviation).toFixed(1);
    if (targets.length) {
      const nearest = targets.reduce((a, b) => b.away < a.away ? b : a), worst = targets.reduce((a, b) => b.deviation > a.deviation ? b : a);
      set("nearest", `${nearest.away.toFixed(0)} mm, ± ${two(nearest)} mm`);
      set("worst", `± ${two(worst)} mm`);
    }
    const { masked } = this.values, isTold = line.masked_share != null;
    masked.hidden = masked.previousSibling.hidden = this.overlay.hidden = !isTold;
    if (isTold) set("masked", `${(100 * line.masked_share).toFixed(0)} %`);
    set("latency", `${line.latency_ms.toFixed(1)} ms`);
    set("leftOut", `${this.film.leftOut} of ${line.frame + 1}`);
    if (this.airway) this.airway.set({ frame: this.film.count - 1, phase: line.phase });
  }

  // The newest picture; one at a time, so that a slow page asks for fewer.
  fetchPicture() {
    const line = this.film.last;
    if (!line || this.isFetching || this.shownLine === line) return;
    this.isFetching = true;
    this.shownLine = line;
    const image = new Image(), done = () => { this.isFetching = false; };
    image.onload = () => {
      done();
      this.picture.getContext("2d").drawImage(image, 0, 0, this.picture.width, this.picture.height);
      this.fetchPicture();
    };
    image.onerror = done;
    image.src = `picture.jpg?frame=${line.frame}${this.walls ? "&walls=1" : ""}`;
  }
}

const page = new LivePage(JSON.parse(document.getElementById("data").textContent));

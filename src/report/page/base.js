"use strict";
// What the scripts of all pages share: elements, typed arrays, ticks, light and dark.

const el = (tag, attributes = {}, ...children) => {
  const svg = ["svg", "path", "line", "text", "g", "rect", "circle"].includes(tag);
  const node = svg ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
  for (const [key, value] of Object.entries(attributes))
    if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else if (value === true) node.setAttribute(key, "");
    else if (value !== false && value != null) node.setAttribute(key, value);
  node.append(...children.filter(child => child != null));
  return node;
};

// --- typed arrays from base64, little-endian as every browser's machine --------------------------------------------
const bytesOf = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));
const floatsOf = text => new Float32Array(bytesOf(text).buffer);
const wordsOf = text => new Uint16Array(bytesOf(text).buffer);

// The airway of a page: places of each vertex, in mm.
function decodeAirway({ low_mm, step_mm, inspiration, expiration, last, faces }) {
  const places = text => Float32Array.from(wordsOf(text), (v, k) => low_mm[k % 3] + step_mm * v);
  return { inspiration: places(inspiration), expiration: places(expiration), last: last ? places(last) : null, faces: wordsOf(faces) };
}

// Index of the number of an ascending list that is nearest to `value`.
function nearest(list, value) {
  let low = 0, high = list.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (list[middle] <= value) low = middle; else high = middle;
  }
  return Math.abs(list[low] - value) <= Math.abs(list[high] - value) ? low : high;
}

// --- controls and ticks -------------------------------------------------------------------------------------------
const check = (text, on, change) => {
  const input = el("input", { type: "checkbox", checked: on, onchange: () => change(input.checked) });
  return el("label", { class: "check" }, input, ` ${text}`);
};

// `change` is called when the page has become light or dark, and once at the beginning.
function themeButton(change) {
  const root = document.documentElement, media = matchMedia("(prefers-color-scheme: dark)");
  const isDark = () => (root.dataset.theme || (media.matches ? "dark" : "light")) === "dark";
  const button = el("button", { id: "theme", onclick: () => { root.dataset.theme = isDark() ? "light" : "dark"; name(); } });
  const name = () => {
    button.textContent = isDark() ? "☀ Light" : "☾ Dark";
    change();
  };
  media.addEventListener("change", name);
  name();
  return button;
}

const label = v => v === 0 ? "0" : String(Number(v.toPrecision(3)));
function linearTicks(low, high, wanted) {
  const rough = (high - low) / wanted, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map(k => k * power).find(s => s >= rough) || 10 * power;
  const out = [];
  for (let v = Math.ceil(low / step - 1e-9) * step; v <= high + 1e-9 * step; v += step) out.push(Math.abs(v) < step / 1e6 ? 0 : v);
  return out;
}

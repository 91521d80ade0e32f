"use strict";
// The page as a whole: tables that sort, one filter for everything, tracks, light and dark, and cases that open. Without
// this script tables and plots stand as they are.

// --- sorting: a header becomes a button; the third press gives the order of the report back ------------------------
function makeSortable(table) {
  const body = table.tBodies[0], original = [...body.rows];
  const heads = [...table.tHead.rows[table.tHead.rows.length - 1].cells];
  const valueOf = (row, k) => {
    const cell = row.cells[k], number = cell.dataset.value;
    return number === undefined ? cell.textContent.trim().toLowerCase() : number === "" ? null : +number;
  };
  heads.forEach((head, k) => {
    const button = el("button", { title: head.title || null, onclick: () => {
      const first = head.dataset.better === "higher" ? "descending" : "ascending";
      const second = first === "ascending" ? "descending" : "ascending";
      const now = { [first]: second, [second]: "none" }[head.getAttribute("aria-sort")] || first;
      for (const other of heads) other.setAttribute("aria-sort", "none");
      head.setAttribute("aria-sort", now);
      const sign = now === "descending" ? -1 : 1;
      const rows = now === "none" ? original : [...original].sort((a, b) => {
        const [x, y] = [valueOf(a, k), valueOf(b, k)];
        // What has no value stands last, whichever way.
        if (x === null || y === null) return (x === null) - (y === null);
        return sign * (typeof x === "number" && typeof y === "number" ? x - y : String(x).localeCompare(String(y)));
      });
      body.classList.toggle("sorted", now !== "none");
      body.append(...rows);
    } }, ...head.childNodes);
    head.setAttribute("aria-sort", "none");
    head.append(button);
  });
}

class Page {
  constructor() {
    this.hidden = new Set();
    this.open = null;
    const tools = document.getElementById("tools");
    for (const table of document.querySelectorAll("table.sortable")) makeSortable(table);
    this.buildTracks(tools);
    this.buildFilter(tools);
    tools.append(themeButton(() => this.shared?.redraw()));
    document.documentElement.classList.add("scripted");
    for (const details of document.querySelectorAll("details.case")) {
      details.addEventListener("toggle", () => this.toggle(details));
      if (details.open) this.toggle(details);
    }
    this.printLight();
  }

  // Made when the first case is opened.
  scene() { return this.shared = this.shared || new AirwayScene(); }

  buildTracks(tools) {
    const sections = [...document.querySelectorAll("section.track")];
    if (sections.length < 2) return;
    const buttons = sections.map(section => el("button", { onclick: () => show(section) }, section.dataset.track));
    const show = chosen => sections.forEach((section, k) => {
      section.hidden = section !== chosen;
      buttons[k].setAttribute("aria-pressed", String(section === chosen));
    });
    tools.append(el("span", { class: "named" }, "Track ", el("span", { class: "group", role: "group", "aria-label": "Track", id: "tracks" }, ...buttons)));
    show(sections[0]);
  }

  buildFilter(tools) {
    const words = el("input", { type: "search", id: "filter", placeholder: "ours, static …", oninput: () => this.filter() });
    const bounds = el("input", { type: "checkbox", checked: true, id: "bounds", onchange: () => this.filter() });
    const none = el("span", { role: "status", class: "failed" });
    tools.append(el("label", { for: "filter" }, "Rows ", words), el("label", { class: "check" }, bounds, " bounds"), none);
    // The page of a film has the case's own table alone.
    const ofRows = document.querySelector("table.comparison") ? "table.comparison" : "table.of-case";
    this.filter = () => {
      const wanted = words.value.toLowerCase().split(/[,\s]+/).filter(Boolean);
      this.hidden.clear();
      let left = 0;
      for (const row of document.querySelectorAll("tr[data-method]")) {
        const text = `${row.dataset.method} ${row.cells[0].textContent}`.toLowerCase();
        const isShown = (!wanted.length || wanted.some(word => text.includes(word))) && (bounds.checked || !row.classList.contains("sanity"));
        if (!isShown && row.closest(ofRows)) this.hidden.add(row.dataset.method);
        row.hidden = !isShown;
        left += isShown;
      }
      none.textContent = left ? "" : "No row matches.";
      for (const row of document.querySelectorAll("table.of-case tr[data-method]")) row.hidden = this.hidden.has(row.dataset.method);
      this.open?.player?.hide();
    };
  }

  // Paper is white, and nothing on it can be opened.
  printLight() {
    const root = document.documentElement;
    let theme, opened = [];
    addEventListener("beforeprint", () => {
      theme = root.dataset.theme;
      opened = [...document.querySelectorAll("details:not(.case):not([open])")];
      root.dataset.theme = "light";
      for (const details of opened) details.open = true;
      this.shared?.draw();
    });
    addEventListener("afterprint", () => {
      if (theme) root.dataset.theme = theme; else delete root.dataset.theme;
      for (const details of opened) details.open = false;
      opened = [];
      this.shared?.redraw();
    });
  }

  toggle(details) {
    if (!details.open) {
      if (this.open?.details === details) { this.open.player?.close(); this.open = null; }
      return;
    }
    if (this.open?.details === details) return;
    // One case at a time: there is one canvas.
    if (this.open) {
      this.open.player?.close();
      this.open.details.open = false;
    }
    const script = details.querySelector("script[type='application/json']");
    this.open = { details, player: null };
    if (script) this.open.player = new CasePlayer(details.querySelector(".player"), JSON.parse(script.textContent), this);
  }
}

const page = new Page();

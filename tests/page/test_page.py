"""Opens report.html of a run in headless Chromium and checks what a reader relies on: test_page.py CHROMIUM REPORT [PICTURES]

No console error and no request; the scene is drawn and the phase slider changes it; tables sort, rows filter, tracks
switch; 400 and 360 px wide nothing scrolls sideways; no label of a plot covers another. PICTURES: a folder for screenshots.
"""

import pathlib
import sys
import tempfile

from browser import Browser

# Share of the scene's pixels that differ from the most frequent colour, and a hash of all of them.
PIXELS = """(() => {
  const canvas = document.querySelector('.stage canvas'), copy = document.createElement('canvas');
  page.scene().draw();
  [copy.width, copy.height] = [canvas.width, canvas.height];
  const context = copy.getContext('2d', { willReadFrequently: true });
  context.drawImage(canvas, 0, 0);
  const data = context.getImageData(0, 0, copy.width, copy.height).data, counts = new Map();
  let hash = 7;
  for (let k = 0; k < data.length; k += 4) {
    const color = data[k] << 16 | data[k + 1] << 8 | data[k + 2];
    counts.set(color, (counts.get(color) || 0) + 1);
    hash = (hash * 31 + color) | 0;
  }
  return { drawn: 1 - Math.max(...counts.values()) / (data.length / 4), colors: counts.size, hash };
})()"""

# Pairs of labels in one plot whose boxes overlap by more than a pixel.
OVERLAPS = """[...document.querySelectorAll('figure.plot > svg, svg.curves')].flatMap(svg => {
  const boxes = [...svg.querySelectorAll('text')].filter(t => t.textContent.trim()).map(t => [t.textContent.trim(), t.getBoundingClientRect()]).filter(([, b]) => b.width);
  return boxes.flatMap(([a, p], i) => boxes.slice(0, i).filter(([, q]) =>
    Math.min(p.right, q.right) - Math.max(p.left, q.left) > 1 && Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top) > 2).map(([b]) => `${a} | ${b}`));
})"""

# Drivers of software WebGL say that reading pixels is slow: that is this test's own doing.
OWN_DOING = "GPU stall due to ReadPixels"


# Types into the filter.
FILTER = "(() => { const f = document.getElementById('filter'); f.value = '%s'; f.dispatchEvent(new Event('input')); })()"


def check(holds, what):
    if not holds:
        raise AssertionError(what)
    print(f"  ok: {what}")


def first_column(browser):
    return browser.run("[...document.querySelector('table.comparison').tBodies[0].rows].filter(r => !r.hidden).map(r => r.dataset.method)")


def open_first(browser):
    browser.run("document.querySelector('section.track:not([hidden]) details.case').open = true; 1")
    browser.settle()


def test_desktop(browser, url, pictures, dark):
    browser.show(url, 1280, 2200, dark)
    order = first_column(browser)
    check(len(order) > 1, f"{len(order)} rows in the comparison")
    browser.run("document.querySelector('table.comparison').tHead.rows[1].cells[3].querySelector('button').click(); 1")
    values = browser.run("[...document.querySelector('table.comparison').tBodies[0].rows].map(r => r.cells[3].dataset.value).filter(Boolean).map(Number)")
    better = browser.run("document.querySelector('table.comparison').tHead.rows[1].cells[3].dataset.better")
    check(values == sorted(values, reverse=better == "higher"), f"the table sorts, {better} first: {values[:3]} ..")
    word = browser.run("document.querySelector('table.comparison').tHead.rows[1].cells[3].getAttribute('aria-sort')")
    check(word == ("descending" if better == "higher" else "ascending"), "the header says how")
    for _ in range(2):
        browser.run("document.querySelector('table.comparison').tHead.rows[1].cells[3].querySelector('button').click(); 1")
    check(first_column(browser) == order, "the third press gives the report's order back")

    browser.run("(() => { const f = document.getElementById('filter'); f.value = %r; f.dispatchEvent(new Event('input')); })()" % order[0])
    shown = first_column(browser)
    check(order[0] in shown and len(shown) < len(order) and all(order[0] in row for row in shown), f"the filter leaves {shown}")
    open_first(browser)
    tiles = browser.run("[...document.querySelectorAll('.tile[data-method]')].filter(t => !t.hidden).map(t => t.dataset.method)")
    rows = browser.run("[...document.querySelectorAll('table.comparison tr[data-method]')].filter(r => !r.hidden).map(r => r.dataset.method)")
    check(set(tiles) <= set(rows), f"a case that is opened later shows the filtered rows alone: {tiles}")
    named = browser.run("[page.open.player.row.method, page.open.player.plot.named.textContent, page.open.player.rowSelect.selectedOptions[0].textContent, page.open.player.row.title]")
    check(named[0] in rows and len(set(named[1:])) == 1, f"the row whose errors are shown is one that is left: {named}")
    browser.run(FILTER % "zzz")
    check("No row matches" in browser.run("document.querySelector('#tools').textContent"), "a filter that leaves nothing says so")
    browser.run(FILTER % "")
    all_tiles = browser.run("[...document.querySelectorAll('.tile[data-method]')].filter(t => !t.hidden).map(t => t.dataset.method)")
    check(len(all_tiles) > 1 and set(tiles) <= set(all_tiles), f"{len(all_tiles)} rows beside the film")

    browser.settle()
    first = browser.run(PIXELS)
    check(first["drawn"] > 0.03 and first["colors"] > 200, f"the airway is drawn: {first['drawn']:.0%} of the stage, {first['colors']} colours")
    browser.run("(() => { const s = document.querySelector('input[id^=phase-]'); s.value = 0.9; s.dispatchEvent(new Event('input')); })()")
    second = browser.run(PIXELS)
    check(second["hash"] != first["hash"], "the phase slider changes pixels")
    words = browser.run("[page.scene().isAtFilmPhase(), page.scene().errorKind(), page.open.player.note.textContent]")
    check(words[:2] == [False, 0] and "another phase than the film" in words[2], "at another phase no error is shown, and the words say why")
    label = browser.run("!!document.querySelector('label[for^=phase-]') && !!document.querySelector('label[for^=time-]')")
    check(label, "sliders have labels")
    # With the film's phase again: at another one the scope may be outside of the lumen.
    browser.run("document.querySelector('.phase input[type=checkbox]').click(); 1")
    browser.run("[...document.querySelectorAll('.scene button')].find(b => b.textContent === 'Ride along').click(); 1")
    ride = browser.run(PIXELS)
    check(ride["drawn"] > 0.5 and ride["colors"] > 200, f"the ride shows the lumen: {ride['colors']} colours")
    if pictures:
        browser.screenshot(pictures / f"ride-{'dark' if dark else 'light'}.png")
    turned = browser.run("(() => { const { view } = page.scene(), before = JSON.stringify(view); page.scene().turn(0.3, 0.3); page.scene().move(5, 5); return before === JSON.stringify(view); })()")
    check(turned, "the view of the scope is not turned")
    browser.run("[...document.querySelectorAll('.scene button')].find(b => b.textContent === 'From outside').click(); 1")
    view = browser.run("""(() => {
      const scene = page.scene(), before = { ...scene.view }, press = (key, times) => { for (let k = 0; k < times; k++) scene.canvas.dispatchEvent(new KeyboardEvent('keydown', { key })); };
      press('ArrowUp', 40); press('+', 60); scene.move(1e6, -1e6);
      const { elevation, zoom, shift } = scene.view, reach = Math.hypot(...shift) / scene.radius;
      scene.show('outside');
      const after = { ...scene.view };
      Object.assign(scene.view, before);
      return [Math.abs(elevation), zoom, reach, after.zoom, ...after.shift];
    })()""")
    check(view[0] < 1.57 and view[1] <= 30 and view[2] < 1.2 and view[3:] == [1, 0, 0], f"the airway stays in sight: {view}")
    step = browser.run("""(() => {
      const { player } = page.open, press = key => { player.slider.dispatchEvent(new KeyboardEvent('keydown', { key })); return player.frame; };
      player.seek(2.4);
      const frames = ['ArrowRight', 'ArrowLeft', 'PageDown'].map(press);
      player.seek(0);
      return frames;
    })()""")
    check(step == [3, 2, 0], f"keys step from frame to frame: {step}")

    tile = "document.querySelectorAll('.tile canvas')[1].toDataURL()"
    browser.run("new Promise(done => setTimeout(done, 200))")
    before = browser.run(tile)
    browser.run("(() => { const s = document.querySelector('input[id^=time-]'); s.value = s.max; s.dispatchEvent(new Event('input')); })()")
    browser.run("new Promise(done => setTimeout(done, 200))")
    check(browser.run(tile) != before, "the time slider changes the film")
    cursor = browser.run("+document.querySelector('.curves .cursor').getAttribute('x1')")
    check(cursor > 300, "the cursor of the curves is at the end")
    off = browser.run("""(() => {
      const { plot, data, metric } = page.open.player, row = plot.rows.find(row => row.series[metric][1] != null), y = plot.y(row.series[metric][1]);
      plot.name(plot.rowAt(plot.x(data.times_s[1]), y));
      return Math.abs(plot.y(plot.rows.find(row => row.title === plot.named.textContent).series[metric][1]) - y);
    })()""")
    check(off < 1, "a curve is named where it is touched")
    # From the beginning to the end, by the button that a reader presses.
    label = "document.querySelector('button.play').getAttribute('aria-label')"
    browser.run("page.open.player.seek(0); 1")
    browser.run("document.querySelector('button.play').click(); 1")
    check(browser.run(label) == "Pause", "play offers to pause")
    browser.run(f"new Promise((done, fail) => {{ const look = () => {label} === 'Play' ? done(1) : setTimeout(look, 50); setTimeout(fail, 40000); look(); }})")
    check(browser.run("page.open.player.frame >= page.open.player.last"), "the film plays to its end")
    if pictures:
        browser.run("page.open.player.seek(page.open.player.last * 0.4); 1")
        browser.run("new Promise(done => setTimeout(done, 300))")
        browser.screenshot(pictures / f"desktop-{'dark' if dark else 'light'}.png")
    overlaps = browser.run(OVERLAPS)
    check(not overlaps, f"no label covers another {overlaps[:5]}")


def test_phone(browser, url, pictures, wide):
    browser.show(url, wide, 800, touch=True)
    open_first(browser)
    browser.run("new Promise(done => setTimeout(done, 300))")
    width = browser.run("document.scrollingElement.scrollWidth")
    check(width <= wide, f"{wide} px wide nothing scrolls sideways: {width}")
    cut = browser.run("""[...document.querySelectorAll('svg.curves text')].filter(t => {
      const [p, q] = [t.getBoundingClientRect(), t.ownerSVGElement.getBoundingClientRect()];
      return p.left < q.left - 1 || p.right > q.right + 1;
    }).map(t => t.textContent)""")
    check(not cut, f"no words of the curves are cut {cut}")
    browser.run("document.querySelector('.wide').scrollLeft = 150; 1")
    left = browser.run("document.querySelector('table.comparison tbody td').getBoundingClientRect().left")
    check(left >= 0, "the first column stays")
    # A line is about 1.16 times as high as its letters' size; what is written upwards has the same size.
    size = browser.run("""Math.min(...[...document.querySelectorAll('figure.plot text:not([transform]), .curves text')]
        .map(t => t.getBoundingClientRect().height / 1.16).filter(h => h))""")
    check(size >= 10, f"the smallest text of a plot is {size:.1f} px high")
    if pictures:
        browser.screenshot(pictures / f"phone-{wide}.png")


def test_tracks(browser, url):
    """A report of both tracks: one of them is shown, with tables and cases of its own."""
    browser.show(url, 1280, 900)
    shown = "[...document.querySelectorAll('section.track')].filter(s => s.offsetParent).map(s => s.dataset.track)"
    tracks = browser.run("[...document.querySelectorAll('section.track')].map(s => s.dataset.track)")
    check(sorted(tracks) == ["clinical", "ideal"], f"the report has both tracks: {tracks}")
    values = "[...document.querySelectorAll('section.track:not([hidden]) table.comparison td')].map(c => c.textContent).join('|')"
    numbers = []
    for k, track in enumerate(tracks):
        browser.run(f"document.querySelectorAll('#tracks button')[{k}].click(); 1")
        check(browser.run(shown) == [track], f"the switch shows {track} alone")
        numbers.append(browser.run(values))
        open_first(browser)
        check(browser.run("page.open.player.host.id").startswith(f"{track}-"), "its cases open")
        browser.settle()
        picture = browser.run(PIXELS)
        check(picture["drawn"] > 0.03 and picture["colors"] > 200, f"its airway is drawn: {picture['colors']} colours")
    check(numbers[0] != numbers[1], "the tables differ")
    names = browser.run("[...document.querySelectorAll('h2.track-name')].map(h => [h.textContent, !!h.offsetParent])")
    check(len(names) == 2 and not any(shown for _, shown in names), f"headings of tracks are for readers without scripts: {names}")


# The open case as a film of the clinical track would have it: targets that move by a millimetre a frame, and a wall at the
# last frame that is the one at expiration.
BEYOND_PHASE = """(() => {
  const before = page.open.player, data = JSON.parse(JSON.stringify(before.data)), film = data.film;
  const base64 = array => btoa(String.fromCharCode(...new Uint8Array(array.buffer)));
  const count = floatsOf(film.targets_mm).length / 6, frames = floatsOf(film.times_s).length;
  film.targets_by_frame_mm = base64(Float32Array.from({ length: 3 * count * frames }, (_, k) => Math.floor(k / (3 * count))));
  film.airway.last = film.airway.expiration;
  const codes = base64(new Uint8Array(wordsOf(film.airway.inspiration).length / 3).fill(200));
  for (const row of data.rows) { row.surface = { at_end: codes }; delete row.targets; }
  before.close();
  page.open.player = new CasePlayer(before.host, data, page);
  return frames - 1;
})()"""


def test_beyond_phase(browser, url):
    """A film whose wall no phase says: balls where they are, no colour of error but at the last frame."""
    browser.show(url, 1280, 2200)
    open_first(browser)
    last = browser.run(BEYOND_PHASE)
    browser.settle()
    state = "[page.scene().errorKind(), page.open.player.note.textContent, page.scene().film.targetsAt(0.5, page.scene().state.frame)[0]]"
    browser.run("page.open.player.seek(1); 1")
    kind, note, ball = browser.run(state)
    check(kind == 0 and "Tissue also moves beyond the breath" in note, "the blend of both breath holds has no colour of error")
    check(ball == [1, 1, 1], f"balls are where the targets are at the frame: {ball}")
    before = browser.run(PIXELS)
    browser.run(f"page.open.player.seek({last}); 1")
    kind, note, ball = browser.run(state)
    check(kind == 1 and "at the last frame" in note and ball == [last] * 3, "the last frame has the true wall and its error")
    check(browser.run(PIXELS)["hash"] != before["hash"], "and shows it")
    browser.run("(() => { const s = document.querySelector('input[id^=phase-]'); s.value = 0.3; s.dispatchEvent(new Event('input')); })()")
    check(browser.run(state)[0] == 0, "at another phase the wall is a blend again")


def test_without_script(browser, url):
    browser.call("Emulation.setScriptExecutionDisabled", value=True)
    browser.show_plain(url)
    tables, plots = browser.count("table.comparison tbody tr"), browser.count("figure.plot > svg")
    browser.call("Emulation.setScriptExecutionDisabled", value=False)
    check(tables > 1 and plots > 1, f"without JavaScript there are {tables} rows and {plots} plots")


def main(program, report, pictures=None):
    report, pictures = pathlib.Path(report).resolve(), pictures and pathlib.Path(pictures)
    if pictures:
        pictures.mkdir(parents=True, exist_ok=True)
    url = report.as_uri()
    size = report.stat().st_size
    check(size < 15_000_000, f"the page has {size / 1e6:.1f} MB")
    with Browser(program) as browser:
        for dark in (False, True):
            test_desktop(browser, url, pictures, dark)
        for wide in (360, 400):
            test_phone(browser, url, pictures, wide)
        with tempfile.TemporaryDirectory() as folder:
            printed = (pictures or pathlib.Path(folder)) / "print.pdf"
            browser.pdf(printed)
            check(printed.stat().st_size > 50_000, f"it prints: {printed.stat().st_size / 1e6:.1f} MB")
        films = sorted(report.parent.glob("films/*.html"))
        if films:
            browser.show(films[0].as_uri())
            browser.settle()
            check(browser.run("document.querySelectorAll('.tile').length") > 1, "the whole film is open")
            back = browser.run("document.querySelector('a[href$=\"report.html\"]').href")
            check(back == url, f"and leads back to the report: {back}")
        test_beyond_phase(browser, url)
        test_without_script(browser, url)
        requests = [r for r in browser.requests if r != url and r not in [f.as_uri() for f in films]]
        check(not requests, f"nothing is asked for {requests[:3]}")
        problems = [p for p in browser.problems if OWN_DOING not in p]
        check(not problems, f"nothing on the console {problems[:3]}")


if __name__ == "__main__":
    main(*sys.argv[1:])

"""Opens a merged report in headless Chromium: test_merged.py CHROMIUM REPORT ROW

ROW, a prediction of one's own, stands in the table, beside the film, among the curves and among the contours, next to the
rows of the run that it was merged with.
"""

import pathlib
import sys

from browser import Browser
from test_page import OWN_DOING, check, first_column, open_first

# Whether a tile shows a picture: its canvas has more than one colour.
TILES = """[...document.querySelectorAll('.tile[data-method]')].filter(tile => {
  const canvas = tile.querySelector('canvas');
  const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
  return new Set(new Uint32Array(data.buffer)).size > 10;
}).map(tile => tile.dataset.method)"""


def main(program, report, row):
    url = pathlib.Path(report).resolve().as_uri()
    with Browser(program) as browser:
        browser.show(url, 1280, 2200)
        rows = first_column(browser)
        check(row in rows and len(rows) > 1, f"{row} stands in the table: {rows}")
        foreign = browser.run("[...document.querySelectorAll('table.comparison tr.foreign')].map(r => r.dataset.method)")
        check(row in foreign and len(foreign) < len(rows), f"marked as another's: {foreign}")
        open_first(browser)
        browser.run("new Promise(done => setTimeout(done, 300))")
        tiles = browser.run(TILES)
        check(row in tiles and len(tiles) > 1, f"beside the film: {tiles}")
        others = [other for other in rows if other != row]
        check(any(other in tiles for other in others), "the run's own pictures are kept")
        check(browser.count(".curves path, .curves polyline") > 1, "curves of both")
        words = browser.run("[...document.querySelectorAll('figure.plot')].filter(f => f.getAttribute('aria-label').match(/[Cc]ontour/)).map(f => f.textContent).join(' ')")
        check(row in words, "its contours are drawn")
        problems = [problem for problem in browser.problems if OWN_DOING not in problem]
        check(not problems, f"nothing on the console {problems[:3]}")


if __name__ == "__main__":
    main(*sys.argv[1:])

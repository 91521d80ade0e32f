"""Opens the page of `track` in headless Chromium while a film is followed: test_live.py CHROMIUM PROGRAM FILM [PICTURES]

Lines arrive, the airway is drawn, the phase changes it, the picture is shown and tinted, a page that is opened late has the
whole path, 400 px wide nothing scrolls sideways, no label covers another; no console error, and no request but to its own
address. PICTURES: a folder for screenshots.
"""

import pathlib
import re
import signal
import subprocess
import sys
import tempfile

from browser import Browser
from test_page import OVERLAPS, OWN_DOING, PIXELS, check

ENDED = "document.querySelector('.link').textContent.includes('the film has ended')"
# Colours of the picture, and whether any of it is as blue as no wall is.
PICTURE = """(() => {
  const shown = document.querySelector('.shown canvas'), canvas = document.createElement('canvas');
  [canvas.width, canvas.height] = [shown.width, shown.height];
  const context = canvas.getContext('2d', { willReadFrequently: true });
  context.drawImage(shown, 0, 0);
  const data = context.getImageData(0, 0, canvas.width, canvas.height).data;
  let blue = 0;
  for (let k = 0; k < data.length; k += 4) blue += data[k + 2] > data[k] + 40;
  return { colors: new Set(new Uint32Array(data.buffer)).size, blue: blue / (data.length / 4) };
})()"""


def until(browser, condition, what, seconds=50):
    """Waits until an expression of the page holds."""
    script = f"new Promise(done => {{ const ask = () => {condition} ? done(true) : --left ? setTimeout(ask, 50) : done(false); let left = {seconds * 20}; ask(); }})"
    check(browser.run(script), what)


def follow(chromium, program, film, pictures, test, width, height, dark, touch):
    """Runs `track` on a film with a page open, hands both to `test`, and ends it as a user does."""
    words = [program, "track", "--sequence", film, "--method", "ours-nav", "--paced", "--page", "127.0.0.1:0"]
    # A file: nobody reads while the page is looked at, and a pipe would fill.
    with tempfile.TemporaryFile("w+") as printed:
        process = subprocess.Popen(words, stdout=printed, stderr=subprocess.PIPE, text=True)
        try:
            url = re.search(r"http://\S+", process.stderr.readline()).group()
            with Browser(chromium) as browser:
                browser.show(url, width, height, dark, touch)
                test(browser, url, pictures)
                requests = [r for r in browser.requests if not r.startswith(url)]
                check(not requests, f"nothing is asked of others {requests[:3]}")
                problems = [p for p in browser.problems if OWN_DOING not in p]
                check(not problems, f"nothing on the console {problems[:3]}")
            process.send_signal(signal.SIGINT)
            said = process.communicate(timeout=60)[1]
            check(process.returncode == 0, f"Ctrl-C after the end is no error: {process.returncode} {said}")
        finally:
            process.kill()
            process.wait()
        printed.seek(0)
        return printed.read()


def common(browser, url, pictures, name):
    until(browser, "page.film.count > 0", "lines arrive")
    until(browser, ENDED, "the page says that the film has ended")
    browser.settle()
    count = browser.run("page.film.count")
    check(count > 1, f"{count} answers are on the page")
    check(browser.run("document.querySelector('.state b').textContent") in ("Tracking", "Unsure", "Lost"), "the state is a word")
    until(browser, f"{PICTURE}.colors > 50", "the frame is shown")
    pixels = browser.run(PIXELS)
    check(pixels["drawn"] > 0.03 and pixels["colors"] > 200, f"the airway is drawn: {pixels['drawn']:.0%} of the stage")
    overlaps = browser.run(OVERLAPS)
    check(not overlaps, f"no label covers another {overlaps[:5]}")
    width = browser.run("document.scrollingElement.scrollWidth")
    check(width <= browser.run("innerWidth"), f"nothing scrolls sideways: {width}")
    covers = """(() => { const [p, q] = ['.shown', '.facts'].map(s => { const r = document.createRange(); r.selectNodeContents(document.querySelector(s)); return r.getBoundingClientRect(); });
      return Math.min(p.right, q.right) - Math.max(p.left, q.left) > 1 && Math.min(p.bottom, q.bottom) > Math.max(p.top, q.top); })()"""
    check(not browser.run(covers), "the words below the picture do not run over the numbers")
    if pictures:
        browser.screenshot(pictures / f"live-{name}.png")


def desktop(browser, url, pictures):
    common(browser, url, pictures, "light")
    hashes = []
    for phase in (0, 1):
        # Path, scope and balls stay where they are.
        browser.run(f"page.scene().set({{ phase: {phase}, path: false, targets: false }}); 1")
        hashes.append(browser.run(PIXELS)["hash"])
    check(hashes[0] != hashes[1], "the phase moves the wall")
    browser.run("page.scene().set({ path: true, targets: true, phase: page.film.last.phase }); 1")
    whole = browser.run(PIXELS)["hash"]
    browser.run("page.scene().set({ targets: false }); 1")
    check(browser.run(PIXELS)["hash"] != whole, "targets are drawn")
    browser.run("page.scene().set({ targets: true }); 1")
    for view in ("Near the scope", "From the scope"):
        browser.run(f"[...document.querySelectorAll('.scene button')].find(b => b.textContent === '{view}').click(); 1")
        seen = browser.run(PIXELS)
        check(seen["drawn"] > 0.1 and seen["colors"] > 200, f"{view}: {seen['drawn']:.0%} of the stage")
        if pictures:
            browser.settle()
            browser.screenshot(pictures / f"live-{view.split()[0].lower()}.png")
    check(browser.run("!document.querySelector('.shown label').hidden"), "what is not wall can be tinted")
    before = browser.run(PICTURE)["blue"]
    browser.run("document.querySelector('.shown input').click(); 1")
    until(browser, f"{PICTURE}.blue > {before} + 0.001", "and is, when it is asked for")
    if pictures:
        browser.screenshot(pictures / "live-tinted.png")
    # Opened late.
    count = browser.run("page.film.count")
    browser.show(url, 1200, 900)
    until(browser, ENDED, "a page that is opened late learns that the film has ended")
    check(browser.run("page.film.count") == count, "and has all answers")


def dark(browser, url, pictures):
    common(browser, url, pictures, "dark")


def phone(browser, url, pictures):
    common(browser, url, pictures, "phone")


def phone_dark(browser, url, pictures):
    common(browser, url, pictures, "phone-dark")


def main(chromium, program, film, pictures=None):
    pictures = pictures and pathlib.Path(pictures)
    if pictures:
        pictures.mkdir(parents=True, exist_ok=True)
    for test in (desktop, dark, phone, phone_dark):
        is_phone = test in (phone, phone_dark)
        size = (360 if test is phone_dark else 400, 800) if is_phone else (1200, 900)
        lines = follow(chromium, program, film, pictures, test, *size, test in (dark, phone_dark), is_phone)
        check(len(lines.splitlines()) > 1, "the lines are printed as well")


if __name__ == "__main__":
    main(*sys.argv[1:])

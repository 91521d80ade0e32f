"""Opens a report of both tracks in headless Chromium: test_tracks.py CHROMIUM REPORT"""

import pathlib
import sys

from browser import Browser
from test_page import OWN_DOING, check, test_tracks

if __name__ == "__main__":
    with Browser(sys.argv[1]) as browser:
        test_tracks(browser, pathlib.Path(sys.argv[2]).resolve().as_uri())
        problems = [problem for problem in browser.problems if OWN_DOING not in problem]
        check(not problems, f"nothing on the console {problems[:3]}")

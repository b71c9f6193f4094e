"""A headless Chromium to look at pages with, for benchmarks and tests: the only file that knows selenium."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

_WORDS = (
    "headless", "no-sandbox", "disable-gpu", "disable-quic", "no-first-run", "disable-background-networking",
    "disable-component-update", "disable-sync", "window-size=1200,900",
)  # fmt: skip


def missing() -> str:
    """What there is not to drive a Chromium with; empty where all is there."""
    try:
        import selenium  # noqa: F401
    except ImportError:
        return "needs the selenium package"
    there = shutil.which("chromium") and shutil.which("chromedriver")
    return "" if there else "needs Debian's chromium and chromium-driver"


def processor_seconds(browser: Any) -> float:
    """What the processes of a running Chromium took of the processor so far [s]; where Linux does not tell, NaN."""
    parents, taken = {}, {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            pid, rest = stat.parent.name, stat.read_text().rpartition(")")[2].split()
        except OSError:  # it ended meanwhile
            continue
        parents[int(pid)], taken[int(pid)] = int(rest[1]), int(rest[11]) + int(rest[12])
    family = {browser.service.process.pid}
    while more := {pid for pid, parent in parents.items() if parent in family} - family:
        family |= more
    return sum(taken.get(pid, 0) for pid in family) / os.sysconf("SC_CLK_TCK") if taken else float("nan")


@contextmanager
def chromium() -> Iterator[Any]:
    """A running Chromium with an empty profile, which keeps what pages say on their console."""
    from selenium import webdriver

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        options = webdriver.ChromeOptions()
        options.binary_location = shutil.which("chromium") or ""
        for word in (*_WORDS, f"user-data-dir={profile}"):
            options.add_argument(f"--{word}")
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        running = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
        try:
            running.set_script_timeout(60)
            yield running
        finally:
            running.quit()

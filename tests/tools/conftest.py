"""A run as files, and a browser to look at pages with."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from report_files import write_run

from semmap.intersections import SemanticMap
from tools.bench.chromium import chromium, missing


@pytest.fixture
def run(tmp_path: Path, semantic_map: SemanticMap) -> Path:
    """A run of ten seconds over the map, with its truth, as the files of `semmap localize` say it."""
    return write_run(tmp_path, semantic_map)


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """A headless Chromium; the tests that need it are skipped where there is none."""
    if reason := missing():
        pytest.skip(reason)
    with chromium() as running:
        yield running

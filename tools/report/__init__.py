"""Self-contained HTML pages about a semantic database or a run: no network, no scripts, figures inline."""

from __future__ import annotations

from pathlib import Path

from semmap import database
from semmap.files import written_whole
from tools.files import writable_file
from tools.report.database_page import database_page
from tools.report.run_files import read_run
from tools.report.run_page import run_page


def write_report(source: Path, out: Path) -> None:
    """Write the page about ``source``, a run directory or a semantic database, to ``out``.

    Raises `InputFileError` for a directory without a run or an ``out`` that cannot be written, `DatabaseError` for a
    file that is not a database.
    """
    writable_file(out)
    page = run_page(read_run(source)) if source.is_dir() else database_page(database.load(source), source.name)
    with written_whole(out) as temporary:
        temporary.write_text(page, encoding="utf-8")

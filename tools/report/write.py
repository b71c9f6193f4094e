"""`semmap report`: from databases and run directories to pages, figures and tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from semmap import database
from semmap.errors import SettingsError
from semmap.files import written_whole
from tools.files import writable_directory, writable_file
from tools.progress import Advance
from tools.report.comparison import compared, comparison_drawings
from tools.report.comparison_page import comparison_page
from tools.report.csv_files import write_comparison_tables, write_database_tables, write_run_tables
from tools.report.database_drawings import database_drawings
from tools.report.database_page import database_page
from tools.report.figures import Drawing, write_drawing
from tools.report.inertial import inertial_drawings
from tools.report.likeness import likeness_of
from tools.report.run_drawings import run_drawings
from tools.report.run_files import RunFiles, read_run
from tools.report.run_page import run_page
from tools.settings import ToolSettings


@dataclass(frozen=True, slots=True)
class Wanted:
    """What a report shall be: a page, a directory of figures, a directory of tables, a Rerun recording; None: not."""

    page: Path | None = None
    figures: Path | None = None
    tables: Path | None = None
    rerun: Path | None = None

    def check(self) -> None:
        """Raise `SettingsError` where nothing is wanted, `InputFileError` where it cannot be written."""
        if not any((self.page, self.figures, self.tables, self.rerun)):
            mend = "give --out FILE, --figures DIR, --csv DIR, or --rerun FILE"
            raise SettingsError("nothing to write", field="report", mend=mend)
        for file in (self.page, self.rerun):
            if file is not None:
                writable_file(file)
        for directory in (self.figures, self.tables):
            if directory is not None:
                writable_directory(directory)


def write_report(
    sources: Sequence[Path],
    wanted: Wanted,
    settings: ToolSettings,
    *,
    map_file: Path | None = None,
    recording: Path | None = None,
    progress: Advance | None = None,
) -> None:
    """Write what is ``wanted`` about one semantic database, one run directory, or several runs compared.

    map_file : of a run, where its database no longer is where the run found it.
    recording : of a run: its IMU is shown as well, and ``wanted.rerun`` has its scans from there.

    Raises `InputFileError` for a directory without a run, `DatabaseError` for a file that is not a database,
    `SettingsError` where sources or what is wanted of them do not go together.
    """
    wanted.check()
    if len(sources) == 1 and not sources[0].is_dir():
        _about_database(sources[0], wanted, settings, progress)
        return
    if files := [source for source in sources if not source.is_dir()]:
        mend = "give one database, or directories of runs"
        raise SettingsError(f"{files[0]} is not a directory of a run", field="report", mend=mend)
    if len(sources) == 1:
        _about_run(sources[0], wanted, map_file, recording, progress)
    else:
        _about_runs(sources, wanted, map_file)


def _about_database(source: Path, wanted: Wanted, settings: ToolSettings, progress: Advance | None) -> None:
    if wanted.rerun is not None:
        raise SettingsError("is made of a run", field="--rerun", mend="give the directory of a run")
    semantic_map = database.load(source)
    likeness = likeness_of(semantic_map, settings.localize, progress)
    if wanted.page is not None:
        _write_page(wanted.page, database_page(semantic_map, source.name, settings.localize, likeness))
    if wanted.figures is not None:
        _write_figures(wanted.figures, database_drawings(semantic_map, likeness))
    if wanted.tables is not None:
        write_database_tables(wanted.tables, semantic_map, likeness, settings.localize)


def _about_run(
    source: Path, wanted: Wanted, map_file: Path | None, recording: Path | None, progress: Advance | None
) -> None:
    run = read_run(source, map_file)
    inertial = _inertial(source, run, recording) if recording is not None else []
    if wanted.page is not None:
        _write_page(wanted.page, run_page(run, inertial))
    if wanted.figures is not None:
        _write_figures(wanted.figures, chain(run_drawings(run), inertial))
    if wanted.tables is not None:
        write_run_tables(wanted.tables, run)
    if wanted.rerun is not None:
        from tools.report.rerun_file import write_rerun

        write_rerun(wanted.rerun, run, recording, progress)


def _inertial(source: Path, run: RunFiles, recording: Path) -> list[Drawing]:
    """The IMU of a run's recording, by the settings of the run."""
    settings = ToolSettings.from_yaml(source / "settings.yaml").localize
    return list(inertial_drawings(recording, Path(str(run.summary.get("rig"))), settings.denoise))


def _about_runs(sources: Sequence[Path], wanted: Wanted, map_file: Path | None) -> None:
    if wanted.rerun is not None:
        raise SettingsError("is made of one run", field="--rerun", mend="give one directory of a run")
    runs = [read_run(source, map_file) for source in sources]
    if wanted.page is not None:
        _write_page(wanted.page, comparison_page(runs))
    if wanted.figures is not None:
        _write_figures(wanted.figures, comparison_drawings(compared(runs)))
    if wanted.tables is not None:
        write_comparison_tables(wanted.tables, runs)


def _write_page(path: Path, text: str) -> None:
    with written_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _write_figures(directory: Path, drawings: Iterable[Drawing]) -> None:
    for drawing in drawings:
        write_drawing(drawing, directory)

"""Work directories: what stays when a build breaks off, what goes, and that two builds keep apart."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from maps.work_directory import kept_whole, work_directory
from semmap.errors import BuildError, CloudError, InputFileError


@pytest.fixture
def work(tmp_path: Path) -> Path:
    return tmp_path / "deep" / "mine.h5.work"


def leave(work: Path, identity: dict[str, object], error: BaseException | None) -> None:
    """A build that finishes one file and then ends, well or not."""
    with work_directory(work, identity):
        (work / "part").write_text("done")
        if error is not None:
            raise error


def test_it_goes_when_the_build_is_done(work: Path) -> None:
    leave(work, {"a": 1}, None)
    assert list(work.parent.iterdir()) == []


@pytest.mark.parametrize("error", [CloudError("shows no floor"), InputFileError("is cut off")])
def test_it_goes_when_the_input_is_at_fault(work: Path, error: BaseException) -> None:
    with pytest.raises(type(error)):
        leave(work, {"a": 1}, error)
    assert list(work.parent.iterdir()) == []


@pytest.mark.parametrize("error", [KeyboardInterrupt(), BuildError("lost"), ZeroDivisionError()])
def test_it_stays_when_the_build_breaks_off_and_serves_the_next(work: Path, error: BaseException) -> None:
    with pytest.raises(type(error)):
        leave(work, {"a": 1}, error)
    with work_directory(work, {"a": 1}):
        assert (work / "part").read_text() == "done"
    assert not work.exists()


def test_what_was_made_from_something_else_is_removed(work: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        leave(work, {"sources": [["a.laz", "1"]]}, KeyboardInterrupt())
    with work_directory(work, {"sources": [["a.laz", "2"]]}):
        assert not (work / "part").exists()


def test_a_damaged_manifest_is_none(work: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        leave(work, {"a": 1}, KeyboardInterrupt())
    (work / "manifest.json").write_text('{"a"')
    with work_directory(work, {"a": 1}):
        assert not (work / "part").exists()


def test_two_builds_at_once_are_refused_and_a_killed_one_leaves_no_lock(work: Path) -> None:
    code = (
        "import sys, time; from pathlib import Path; from maps.work_directory import work_directory\n"
        "with work_directory(Path(sys.argv[1]), {}): print('in', flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", code, str(work)], stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "in\n"
        with pytest.raises(BuildError, match="another build is at work there; wait"), work_directory(work, {}):
            pass
        assert work.exists()
        other.send_signal(signal.SIGKILL)
    with work_directory(work, {}):
        pass
    assert not work.exists()


def test_a_directory_of_somebody_else_is_left_alone(work: Path) -> None:
    work.mkdir(parents=True)
    (work / "thesis.tex").write_text("years of work")
    with pytest.raises(BuildError, match="holds files that are not semmap's"), work_directory(work, {}):
        pass
    assert (work / "thesis.tex").exists()


def test_a_file_in_its_place(work: Path) -> None:
    work.parent.mkdir(parents=True)
    work.write_text("")
    with pytest.raises(InputFileError, match=r"cannot be made .*choose another --out"), work_directory(work, {}):
        pass


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_place_that_may_not_be_written(work: Path) -> None:
    work.parent.mkdir(parents=True)
    work.parent.chmod(0o500)
    with pytest.raises(InputFileError, match="cannot be made"), work_directory(work, {}):
        pass


def fill_the_disk(path: Path) -> None:
    with kept_whole(path) as temporary:
        temporary.write_text("half")
        raise OSError(28, os.strerror(28))


def test_a_full_disk_is_an_error_that_keeps_what_is_finished(tmp_path: Path) -> None:
    with pytest.raises(BuildError, match=r"part: cannot be written \(No space left.*run the same command again"):
        fill_the_disk(tmp_path / "part")
    assert list(tmp_path.iterdir()) == []

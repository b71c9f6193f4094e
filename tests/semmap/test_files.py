"""Files are there whole or not at all."""

import os

import pytest

from semmap.errors import InputFileError
from semmap.files import written_whole


def test_the_file_appears_when_the_block_ends(tmp_path):
    path = tmp_path / "new" / "a.txt"
    with written_whole(path) as temporary:
        temporary.write_text("all of it")
        assert not path.exists()
    assert path.read_text() == "all of it"
    assert os.listdir(path.parent) == ["a.txt"]


def test_a_block_that_fails_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def break_off():
        with written_whole(path) as temporary:
            temporary.write_text("half of")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        break_off()
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_the_temporary_file_keeps_the_suffix_that_libraries_go_by(tmp_path):
    with written_whole(tmp_path / "a.laz") as temporary:
        assert temporary.suffix == ".laz"


def test_places_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    for path, pattern in ((tmp_path, "is a directory"), (tmp_path / "file" / "a.txt", "cannot be written")):
        with pytest.raises(InputFileError, match=pattern), written_whole(path):
            pass

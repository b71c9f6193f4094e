"""How well a run knew its position, from `uncertainty.csv` to the figures of the report."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from semmap.errors import InputFileError
from semmap.geometry import Array
from tools.report.covariance import covariance_over_distance, ellipses_along_track, mode_colours
from tools.report.figures import svg
from tools.report.uncertainty import Uncertainties, read_uncertainties
from tools.run import UNCERTAINTY_COLUMNS

MODES = ["LIU"] * 30 + ["LIO"] * 5 + ["LIW"] * 65


def table(*, in_map: bool) -> str:
    """A hundred rows; the map's covariance is known from the twentieth on, or never."""
    lines = [",".join(UNCERTAINTY_COLUMNS)]
    for i, mode in enumerate(MODES):
        cells = {"stamp": f"{0.1 * i:.9f}", "mode": mode, "degenerate": "0", "odom_xx": "1.0", "odom_yz": "0.5"}
        cells |= {f"odom_{axes}": "0.0" for axes in ("xy", "xz", "yy", "zz")}
        if in_map and i >= 20:
            cells |= {f"map_{axes}": "0.01" if axes in ("xx", "yy", "zz") else "0.0" for axes in AXES}
        lines.append(",".join(cells.get(name, "") for name in UNCERTAINTY_COLUMNS))
    return "\n".join(lines) + "\n"


AXES = ("xx", "xy", "xz", "yy", "yz", "zz")


def known(covariance: Array) -> Uncertainties:
    stamps = np.int64(1e8) * np.arange(len(MODES))
    rotation_std = np.full((len(MODES), 3), 0.01)
    return Uncertainties(stamps, np.array(MODES), "map", np.tile(covariance, (len(MODES), 1, 1)), rotation_std)


def test_rows_read_back_in_the_map_where_it_was_known_or_else_in_odom(tmp_path: Path) -> None:
    (tmp_path / "in_map.csv").write_text(table(in_map=True))
    (tmp_path / "in_odom.csv").write_text(table(in_map=False))
    in_map, in_odom = (read_uncertainties(tmp_path / f"{name}.csv") for name in ("in_map", "in_odom"))
    assert in_map.frame == "map" and in_odom.frame == "odom"
    assert np.isnan(in_map.position[:20]).all()
    assert_allclose(in_map.position[20:], np.tile(0.01 * np.eye(3), (80, 1, 1)))
    assert_allclose(in_odom.position[0], [[1.0, 0.0, 0.0], [0.0, 0.0, 0.5], [0.0, 0.5, 0.0]])
    assert in_map.stretches() == [(0, 30, "LIU"), (30, 35, "LIO"), (35, 100, "LIW")]
    assert in_map.at(in_map.stamps_ns[28:33]).stretches() == [(0, 2, "LIU"), (2, 5, "LIO")]


@pytest.mark.parametrize(("old", "new"), [("0.400000000,LIU", "soon,LIU"), (",1.0,", ",one,")])
def test_a_damaged_row_is_named(tmp_path: Path, old: str, new: str) -> None:
    lines = table(in_map=False).splitlines()
    lines[5] = lines[5].replace(old, new)
    (tmp_path / "bad.csv").write_text("\n".join(lines))
    with pytest.raises(InputFileError, match=r"bad\.csv.*line"):
        read_uncertainties(tmp_path / "bad.csv")


def test_the_figures_show_every_mode_and_the_factor() -> None:
    way = 0.3 * np.arange(len(MODES))
    positions = np.column_stack([way, 0.1 * np.sin(way), np.zeros_like(way)])
    small = known(np.diag([1e-6, 1e-6, 1e-6]))
    for picture in (svg(covariance_over_distance(small, way)), svg(ellipses_along_track(small, positions))):
        assert picture.startswith("<svg")
        assert all(mode in picture for mode in ("LIU", "LIO", "LIW"))
    assert "100 times as large" in svg(ellipses_along_track(small, positions))
    assert "times as large" not in svg(ellipses_along_track(known(np.eye(3)), positions))


def test_nothing_known_makes_an_empty_figure_not_an_error() -> None:
    blind = known(np.full((3, 3), np.nan))
    positions = np.zeros((len(MODES), 3))
    assert svg(ellipses_along_track(blind, positions)).startswith("<svg")


def test_modes_of_other_names_get_colours_of_their_own() -> None:
    one = known(np.eye(3))
    names = np.array(["IU"] * 50 + ["IW"] * 50)
    other = Uncertainties(one.stamps_ns, names, "map", one.position, one.rotation_std)
    colours = mode_colours(other)
    assert list(colours) == ["IU", "IW"] and len(set(colours.values())) == 2

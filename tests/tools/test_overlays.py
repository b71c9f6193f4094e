"""`overlays.h5`: to the centimetre, the same bytes, and refused when damaged."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.testing import assert_allclose

from localize.results import Overlay
from semmap.errors import InputFileError
from semmap.geometry import se3, transform, yaw_rotation
from tools.overlays import read_overlays, write_overlays


def overlays() -> list[Overlay]:
    rng = np.random.default_rng(0)
    T = se3(yaw_rotation(0.7), np.array([600_000.0, 5_400_000.0, 200.0]))
    return [Overlay(k, T, rng.uniform(-9.0, 9.0, (n, 3)).astype(np.float32)) for k, n in enumerate((300, 0, 2000))]


def test_points_come_back_in_the_map_to_the_centimetre(tmp_path: Path) -> None:
    written = overlays()
    write_overlays(tmp_path / "overlays.h5", written)
    read = read_overlays(tmp_path / "overlays.h5")
    assert read.id.tolist() == [0, 1, 2]
    assert [len(read.in_map(k)) for k in range(3)] == [300, 0, 800]
    expected = transform(written[0].T_map_imu, written[0].points.astype(float))
    nearest = np.abs(read.in_map(0)[:, None] - expected).sum(axis=2).min(axis=1)
    assert_allclose(nearest, 0.0, atol=0.02)


def test_the_same_overlays_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_overlays(tmp_path / name, overlays())
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_no_overlays_are_a_file_too(tmp_path: Path) -> None:
    write_overlays(tmp_path / "overlays.h5", [])
    assert len(read_overlays(tmp_path / "overlays.h5")) == 0


@pytest.mark.parametrize("name", ["id", "cloud_offsets", "cloud_points", "T_map_imu"])
def test_a_damaged_file_is_refused_by_name(tmp_path: Path, name: str) -> None:
    path = tmp_path / "overlays.h5"
    write_overlays(path, overlays())
    with h5py.File(path, "r+") as file:
        del file["overlays"][name]
        file["overlays"][name] = np.zeros((2, 2))
    with pytest.raises(InputFileError, match=r"overlays\.h5.*run `semmap localize` again"):
        read_overlays(path)

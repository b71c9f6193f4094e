"""The benchmark mine of paper 004: a map and a recording that this project did not make."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from semmap import database
from tools import cli

MINE = Path(__file__).resolve().parents[2] / "shared" / "data" / "edgar_mine"

pytestmark = pytest.mark.skipif(
    not MINE.is_dir(), reason="the benchmark mine is not beside the repository (shared/data)"
)


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with the mine's database ``mine.h5``."""
    directory = tmp_path_factory.mktemp("edgar")
    assert cli.run(["build", str(MINE / "prior_map.laz"), "--out", str(directory / "mine.h5")]) == 0
    return directory


def test_the_map_gives_the_reference_junctions(out: Path) -> None:
    junctions = np.loadtxt(MINE / "junctions.csv", delimiter=",", skiprows=1, usecols=(1, 2))
    found = np.array([one.p_map[:2] for one in database.load(out / "mine.h5").intersections])
    distances = np.linalg.norm(junctions[:, None] - found[None], axis=-1)
    assert np.count_nonzero(distances.min(axis=1) < 4.0) >= 30


def test_a_recording_that_starts_in_motion_is_placed_without_alignment(out: Path) -> None:
    recording = MINE / "recording_60s"
    words = ["localize", recording, "--rig", MINE / "rig.yaml", "--map", out / "mine.h5", "--out", out / "run"]
    assert cli.run([str(word) for word in words]) == 0
    truth = next(path for path in (MINE / "ground_truth.tum", recording / "ground_truth.tum") if path.is_file())
    assert cli.run(["evaluate", str(out / "run"), "--truth", str(truth)]) == 0
    evaluation = json.loads((out / "run" / "evaluation.json").read_text())
    final, realtime = (evaluation["trajectories"][name] for name in ("trajectory", "realtime"))
    assert final["frame"] == "map"
    assert final["absolute"]["position_m"]["rmse"] < 0.5
    assert realtime["absolute"]["position_m"]["max"] < 1.0
    assert evaluation["realtime"]["first_fix_s"] > 0.0

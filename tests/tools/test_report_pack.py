"""Numbers on their way into a page: nothing lost beyond a step of the grid, nothing that HTML could read."""

from __future__ import annotations

import base64
import gzip
import json
import re

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tools.report.contour_data import UNSEEN, contour_bytes
from tools.report.pack import BATCH, STEPS, Blobs, Clouds, json_element, packed_points, simplified, thinned
from tools.report.series import POINTS, drawn_rows


def unpacked(blobs: Blobs, name: str, dtype: type) -> np.ndarray:
    """What a page's script makes of an array."""
    (text,) = re.findall(f'id="blob-{name}">([^<]*)<', blobs.html())
    return np.frombuffer(gzip.decompress(base64.b64decode(text)), dtype)


def test_clouds_come_back_within_a_step_of_their_grid() -> None:
    rng = np.random.default_rng(0)
    clouds = [rng.uniform(-20.0, 20.0, (int(rng.integers(0, 50)), 3)) for _ in range(BATCH + 3)]
    blobs = Blobs()
    packed = Clouds(blobs, "cloud")
    for cloud in clouds:
        packed.add(cloud)
    for k, (start, count, *box) in enumerate(packed.done()):
        bits = unpacked(blobs, f"cloud-{k // BATCH}", np.uint32)[int(start) : int(start + count)]
        steps = np.stack([bits >> shift & STEPS for shift in (0, 10, 20)], axis=1)
        points = np.array(box[:3]) + np.array(box[3:]) * steps
        order, expected = np.lexsort(points.T), clouds[k][np.lexsort(points_on_grid(clouds[k], box).T)]
        assert_allclose(points[order], expected, atol=40.0 / STEPS)


def points_on_grid(cloud: np.ndarray, box: list[float]) -> np.ndarray:
    return np.round((cloud - box[:3]) / np.maximum(box[3:], 1e-9))


def test_a_single_point_is_packed() -> None:
    low, _, packed = packed_points(np.array([[1.0, 2.0, 3.0]]))
    assert_allclose(low, [1.0, 2.0, 3.0])
    assert_array_equal(packed, [0])


def test_json_cannot_end_its_element() -> None:
    hostile = {"name": "</script><!--<script>", "amp": "&lt;", "line": "\u2028"}
    element = json_element(hostile)
    inside = element.removeprefix('<script type="application/json" id="data">').removesuffix("</script>")
    assert not set("<>&\u2028") & set(inside)
    assert json.loads(inside) == hostile


def test_what_is_not_a_number_does_not_pass_as_one() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        json_element({"a": float("nan")})


def test_thinned_keeps_all_parts() -> None:
    points = np.concatenate([np.random.default_rng(0).normal(at, 0.2, (500, 3)) for at in (0.0, 10.0)])
    few = thinned(points, 100)
    assert len(few) == 100 and abs(np.count_nonzero(few[:, 0] > 5.0) - 50) <= 5
    assert thinned(few, 100) is few


def test_a_simplified_line_is_nowhere_off() -> None:
    t = np.linspace(0.0, 6.0, 400)
    line = np.column_stack([t, np.sin(t)])
    rows = simplified(line, 0.01)
    assert 5 < len(rows) < 60 and rows[0] == 0 and rows[-1] == 399
    assert_allclose(np.interp(t, t[rows], line[rows, 1]), line[:, 1], atol=0.02)


def test_contours_as_bytes() -> None:
    distance, seen = np.array([0.0, 6.0, 12.0, 20.0, 3.0], np.float32), np.array([True, True, True, True, False])
    assert_array_equal(contour_bytes(distance, seen, 12.0), [0, 127, 254, 254, UNSEEN])


def test_long_series_keep_their_peaks() -> None:
    values = np.zeros(50_000)
    values[[777, 31_234]] = 5.0, -7.0
    values[40_000:41_000] = np.nan
    rows = drawn_rows(values)
    assert len(rows) < POINTS + 10 and {0, 777, 31_234, 39_999, 41_000, 49_999} <= set(rows.tolist())

"""Rig files: what is accepted, and the one line that says what is wrong."""

import copy

import numpy as np
import pytest
import yaml
from numpy.testing import assert_allclose

from semmap.errors import RigError
from semmap.rig import Rig

FULL = {
    "frame": "map",
    "imu": {"topic": "/imu/data", "rate_hz": 200, "accel_unit": "g", "time_offset_s": -0.01},
    "lidar": {
        "topic": "/points",
        "p_imu_lidar": [0.05, 0.0, 0.12],
        "q_imu_lidar_xyzw": [0.0, 0.0, 0.70710678, 0.70710678],
    },
    "wheel": {"topic": "/wheel", "p_imu_wheel": [-0.1, 0, -0.35]},
    "uwb": {
        "topic": "/uwb/range",
        "range_std": 0.06,
        "p_imu_tag": [0, 0, 0.3],
        "anchors": {100: [1, 2, 3], 101: [4, 5, 6]},
        "center": [0, 0, 0],
        "max_range": 21.0,
    },
    "total_station": {"topic": "/prism", "position": [1, 2, 3], "p_imu_prism": [0, 0, 0.5]},
    "earth": {"latitude_deg": 37.87, "grid_bearing_deg": -12.5},
}


def write(path, data) -> str:
    path.write_text(data if isinstance(data, str) else yaml.safe_dump(data))
    return str(path)


def changed(key: str, value) -> dict:
    """FULL with one nested key set, or removed where value is None."""
    data = copy.deepcopy(FULL)
    *blocks, last = key.split(".")
    block = data
    for name in blocks:
        block = block[name]
    if value is None:
        del block[last]
    else:
        block[last] = value
    return data


def test_a_full_rig(tmp_path):
    rig = Rig.from_yaml(write(tmp_path / "rig.yaml", FULL))
    assert rig.imu.accel_unit == "g"
    assert rig.uwb.anchor_positions().keys() == {100, 101}
    assert_allclose(rig.uwb.anchor_positions()[101], [4, 5, 6])
    # Ninety degrees about z: what is ahead of the lidar is on the left of the imu.
    assert_allclose(rig.lidar.T_imu_lidar @ [1, 0, 0, 1], [0.05, 1.0, 0.12, 1], atol=1e-7)
    assert_allclose(rig.wheel.T_imu_wheel[:3, :3], np.eye(3))


def test_only_the_imu_is_needed(tmp_path):
    rig = Rig.from_yaml(write(tmp_path / "rig.yaml", {"imu": {"topic": "/imu"}}))
    assert rig.lidar is rig.wheel is rig.uwb is rig.total_station is None
    assert rig.imu.accel_unit == "m/s2"


def test_without_leaves_sensors_out_and_the_rig_alone(tmp_path):
    rig = Rig.from_yaml(write(tmp_path / "rig.yaml", FULL))
    less = rig.without("uwb", "prism", "intersections")
    assert less.uwb is less.total_station is None
    assert less.lidar == rig.lidar
    assert rig.uwb is not None


BAD = {
    "a latitude beyond the pole": (changed("earth.latitude_deg", 137.87), r"earth\.latitude_deg: .*89"),
    "misspelt key": (
        changed("lidar.min_rnage", 1.0),
        r"lidar\.min_rnage: unknown key; did you mean `min_range`",
    ),
    "misspelt block": (changed("lidr", {}), r"lidr: unknown key; did you mean `lidar`"),
    "missing extrinsic": (
        changed("lidar.p_imu_lidar", None),
        r"lidar\.p_imu_lidar: is missing; add `p_imu_lidar`",
    ),
    "missing topic": (changed("imu.topic", None), r"imu\.topic: is missing"),
    "no imu": (changed("imu", None), r"imu: is missing"),
    "two numbers": (changed("wheel.p_imu_wheel", [1.0, 2.0]), r"wheel\.p_imu_wheel\.2: "),
    "NaN": (changed("wheel.p_imu_wheel", [float("nan"), 0, 0]), r"wheel\.p_imu_wheel\.0: .*finite"),
    "not a unit quaternion": (changed("lidar.q_imu_lidar_xyzw", [0, 0, 0, 2]), "unit quaternion x y z w"),
    "zero quaternion": (changed("lidar.q_imu_lidar_xyzw", [0, 0, 0, 0]), "unit quaternion x y z w"),
    "negative noise": (changed("imu.gyro_noise", -1.0), r"imu\.gyro_noise: .*greater than 0"),
    "unknown unit": (changed("imu.accel_unit", "ft/s2"), r"imu\.accel_unit: .*'m/s2' or 'g'"),
    "ranges the wrong way round": (changed("lidar.max_range", 0.5), r"lidar: min_range 0\.6 is not below"),
    "no anchors": (changed("uwb.anchors", {}), r"uwb\.anchors: "),
    "anchor without a number": (changed("uwb.anchors", {"left": [0, 0, 0]}), r"uwb\.anchors\.left"),
    "block is a number": ({"imu": 3}, r"imu: .*it holds 3"),
    "a list": ("- imu", "is not a mapping"),
    "broken YAML": ("imu: {topic: /imu\nlidar: 3", r"is not valid YAML \(line 2: "),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_rigs_say_what_is_wrong_in_one_line(name, tmp_path):
    data, pattern = BAD[name]
    path = write(tmp_path / "rig.yaml", data)
    with pytest.raises(RigError, match=pattern) as caught:
        Rig.from_yaml(path)
    assert str(caught.value).startswith(path)
    assert "\n" not in str(caught.value)
    assert caught.value.mend


def test_a_missing_file_and_a_directory(tmp_path):
    with pytest.raises(RigError, match="no such file"):
        Rig.from_yaml(tmp_path / "none.yaml")
    with pytest.raises(RigError, match="cannot be read"):
        Rig.from_yaml(tmp_path)

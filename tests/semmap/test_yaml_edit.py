"""Numbers put into somebody's YAML: they are read back, and nothing else changes."""

from __future__ import annotations

import pytest
import yaml

from semmap.yaml_edit import with_values

BLOCK = """\
# my robot
frame: map
imu:
  topic: /imu/data   # the good one
  gyro_noise: 0.0003 # from the sheet
  rate_hz: 200       # nominal

lidar: {topic: /points, p_imu_lidar: [0, 0, 1]}  # gyro_noise: 7
"""
FLOW = "imu: {topic: /imu/data, gyro_noise: 3e-4, rate_hz: 200}\nlidar: {topic: /points, p_imu_lidar: [0, 0, 1]}\n"
LAST = "frame: map\nimu:\n    topic: /imu\n    accel_unit: g"
NESTED = "imu:\n  topic: /imu\n  list:\n    - 1\n    - 2\n\n# the end\nlidar: {topic: /p}\n"
VALUES = {"gyro_noise": 1.23456e-7, "accel_noise": 1e-5, "gyro_bias_std": 2.0}


@pytest.mark.parametrize("text", [BLOCK, FLOW, LAST, NESTED, BLOCK.replace("\n\n", "\n")])
def test_numbers_are_set_and_the_rest_stays(text) -> None:
    changed = with_values(text, "imu", VALUES)
    before, after = yaml.safe_load(text), yaml.safe_load(changed)
    assert after["imu"] == before["imu"] | {"gyro_noise": 1.235e-7, "accel_noise": 1e-5, "gyro_bias_std": 2.0}
    assert {k: v for k, v in after.items() if k != "imu"} == {k: v for k, v in before.items() if k != "imu"}
    for comment in ("# my robot", "# the good one", "# from the sheet", "# nominal", "# the end"):
        assert (comment in text) == (comment in changed)
    assert with_values(changed, "imu", VALUES) == changed


def test_values_stay_in_their_lines() -> None:
    assert with_values(BLOCK, "imu", {"gyro_noise": 5e-4}) == BLOCK.replace("0.0003", "0.0005")


@pytest.mark.parametrize("text", ["", "- 1\n", "frame: map\n", "imu:\n", "imu: {}\n", "imu: 3\n"])
def test_where_there_is_no_such_block(text) -> None:
    with pytest.raises(ValueError, match="no mapping `imu`"):
        with_values(text, "imu", VALUES)

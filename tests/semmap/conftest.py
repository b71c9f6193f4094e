"""Shared by the tests of the vocabulary: PointCloud2 messages of any layout, and a rig with every sensor."""

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

from semmap.rig import Rig

DATATYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


def cloud_message(
    table: np.ndarray, *, height: int = 1, row_padding: int = 0, stamp_ns: int = 0, big: bool = False
) -> SimpleNamespace:
    """A PointCloud2 with the columns of a structured array (n,), in ``height`` rows with padding after each."""
    names = table.dtype.names
    order = ">" if big else "<"
    formats = [table.dtype[name].base.newbyteorder(order) for name in names]
    shapes = [table.dtype[name].shape for name in names]
    offsets = [table.dtype.fields[name][1] for name in names]
    layout = {
        "names": names,
        "formats": [(f, s) if s else f for f, s in zip(formats, shapes, strict=True)],
        "offsets": offsets,
        "itemsize": table.dtype.itemsize,
    }
    packed = table.astype(np.dtype(layout))
    step, width = table.dtype.itemsize, len(table) // height
    rows = np.frombuffer(packed.tobytes(), np.uint8).reshape(height, width * step)
    padded = np.concatenate([rows, np.full((height, row_padding), 0xAB, np.uint8)], axis=1)
    fields = [
        SimpleNamespace(name=name, offset=offset, datatype=DATATYPES[f.str[1:]], count=int(np.prod(s)) if s else 1)
        for name, offset, f, s in zip(names, offsets, formats, shapes, strict=True)
    ]
    return SimpleNamespace(
        header=SimpleNamespace(
            stamp=SimpleNamespace(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9), frame_id="lidar"
        ),
        height=height,
        width=width,
        fields=fields,
        is_bigendian=big,
        point_step=step,
        row_step=width * step + row_padding,
        data=padded.reshape(-1),
        is_dense=False,
    )


@pytest.fixture
def make_cloud() -> Callable[..., SimpleNamespace]:
    return cloud_message


@pytest.fixture
def full_rig() -> Rig:
    return Rig.model_validate(
        {
            "imu": {"topic": "/imu/data"},
            "lidar": {"topic": "/lidar/points", "p_imu_lidar": [0.05, 0, 0.12]},
            "wheel": {"topic": "/wheel/twist", "p_imu_wheel": [0, 0, 0]},
            "uwb": {"topic": "/uwb/range", "p_imu_tag": [0, 0, 0], "anchors": {100: [0, 0, 0], 101: [9, 0, 0]}},
            "total_station": {"topic": "/prism", "position": [0, 0, 0], "p_imu_prism": [0, 0, 0]},
        }
    )

"""The bytes of `sensor_msgs/PointCloud2` as columns, and back. Knows the layout, not the middleware."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from semmap.errors import CloudError
from semmap.measurements import Scan

_DTYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_DATATYPES = {code: number for number, code in _DTYPES.items()}

RING_FIELDS = ("ring", "line", "channel", "laser_id", "beam")
INTENSITY_FIELDS = ("intensity", "reflectivity", "reflectance", "intensities")


class PointFieldMessage(Protocol):
    """`sensor_msgs/PointField`: a column of a cloud."""

    name: str
    offset: int
    datatype: int
    count: int


class PointCloud2Message(Protocol):
    """`sensor_msgs/PointCloud2` less its header."""

    height: int
    width: int
    fields: Sequence[Any]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: Any


class FieldLayout(NamedTuple):
    """Name, byte offset and PointField datatype of a column."""

    name: str
    offset: int
    datatype: int


def point_table(cloud: PointCloud2Message) -> NDArray[Any]:
    """All scalar columns of a cloud as one structured array (n,), rows flattened, not copied where it can.

    Raises `CloudError` where the layout contradicts itself or the data breaks off.
    """
    dtype = _row_dtype(cloud)
    data = np.frombuffer(cloud.data, dtype=np.uint8)
    width, height, step = int(cloud.width), int(cloud.height), int(cloud.point_step)
    row_step = int(cloud.row_step) if height > 1 else width * step
    if width * height == 0:
        return np.empty(0, dtype)
    if row_step < width * step:
        raise CloudError(f"row_step {row_step} is shorter than {width} points of {step} bytes", field="row_step")
    needed = row_step * (height - 1) + width * step
    if len(data) < needed:
        raise CloudError(f"holds {len(data)} of {needed} bytes", field="data", mend="the cloud is cut off")
    if row_step == width * step:
        return np.frombuffer(data, dtype, count=width * height)
    return np.ndarray((height, width), dtype, buffer=data, strides=(row_step, step)).reshape(-1)


def _row_dtype(cloud: PointCloud2Message) -> np.dtype[Any]:
    order = ">" if cloud.is_bigendian else "<"
    columns: dict[str, tuple[str, int]] = {}
    for field in cloud.fields:
        name, code = field.name.strip("\0 "), _DTYPES.get(int(field.datatype))
        if code is None:
            raise CloudError(f"has the unknown datatype {field.datatype}", field=name, mend="datatypes are 1 to 8")
        if int(field.offset) + int(code[1]) > int(cloud.point_step):
            raise CloudError(f"lies beyond the {cloud.point_step} bytes of a point", field=name)
        if int(field.count) <= 1:
            columns.setdefault(name, (order + code, int(field.offset)))
    return np.dtype(
        {
            "names": list(columns),
            "formats": [code for code, _ in columns.values()],
            "offsets": [offset for _, offset in columns.values()],
            "itemsize": int(cloud.point_step),
        }
    )


def coordinates(table: NDArray[Any]) -> NDArray[np.float32]:
    """Columns x, y, z as (n, 3) float32 [m]. Raises `CloudError` where one is missing."""
    names = table.dtype.names or ()
    for axis in "xyz":
        if axis not in names:
            raise CloudError("is missing", field=axis, mend=f"the cloud has {', '.join(names) or 'no fields'}")
    points = np.empty((len(table), 3), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        points[:, 0], points[:, 1], points[:, 2] = table["x"], table["y"], table["z"]
    return points


def find_column(names: Iterable[str], wanted: Iterable[str]) -> str | None:
    """The first of the ``wanted`` names that a cloud has, whatever its case."""
    spelt = {name.lower(): name for name in names}
    return next((spelt[name] for name in wanted if name in spelt), None)


def within_range(points: NDArray[np.float32], min_range: float, max_range: float) -> NDArray[np.bool_]:
    """Mask (n,) of points whose range [m] is finite and in the limits; (0, 0, 0), "no return", never is."""
    with np.errstate(over="ignore", invalid="ignore"):
        squared = np.einsum("ij,ij->i", points, points)
    return np.asarray((squared >= max(min_range**2, 1e-12)) & (squared <= max_range**2))


def encode_scan(scan: Scan) -> tuple[list[FieldLayout], int, NDArray[np.uint8]]:
    """Columns, point size and bytes of a scan: x y z, intensity, ring if there, time [s] after the stamp."""
    columns: list[tuple[str, str, NDArray[Any]]] = [(axis, "f4", scan.points[:, k]) for k, axis in enumerate("xyz")]
    if scan.intensity is not None:
        columns.append(("intensity", "f4", scan.intensity))
    if scan.ring is not None:
        columns.append(("ring", "u2", scan.ring))
    columns.append(("time", "f4", scan.offsets_ns * 1e-9))
    table = np.empty(len(scan.points), dtype=[(name, "<" + code) for name, code, _ in columns])
    for name, _, values in columns:
        table[name] = values
    offsets = np.cumsum([0, *(int(code[1]) for _, code, _ in columns)]).tolist()
    layout = [
        FieldLayout(name, offset, _DATATYPES[code])
        for (name, code, _), offset in zip(columns, offsets[:-1], strict=True)
    ]
    return layout, table.dtype.itemsize, table.view(np.uint8).reshape(-1)

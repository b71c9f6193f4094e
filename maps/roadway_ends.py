"""Ends of roadways: the medial axis turns to a corner of the face there; the axis of a roadway goes straight to it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Sequence

import numpy as np

from maps.free_space import FreeSpace
from maps.roadways import Roadway
from semmap.geometry import Array

_FULL = 0.8
"""The end begins where the walls are nearer than this share of the median of the cells before."""
_BEFORE, _BACK, _LEG, _LOOK_M = 50, 5, 20, 12.0
"""In cells: how many before tell the usual distance to the walls, how far back from there the straight piece begins,
and how many give its direction."""


def with_straight_ends(roads: Sequence[Roadway], met: Container[int], space: FreeSpace) -> list[Roadway]:
    """The roadways with loose ends that go straight to the face, or to where one sees no farther.

    met : the nodes that are no ends, whatever leaves them.
    """
    leave = Counter(node for road in roads for node in road.nodes)
    loose = {node for node, count in leave.items() if count == 1 and node not in met}
    return [_straight(_straight(road, loose, space).reversed(), loose, space).reversed() for road in roads]


def _straight(road: Roadway, loose: Container[int], space: FreeSpace) -> Roadway:
    """The roadway with a straight second end, if that is loose."""
    if road.nodes[1] not in loose:
        return road
    full = road.clearance >= _FULL * np.median(road.clearance[-_BEFORE:])
    last = max(len(full) - 1 - int(np.argmax(full[::-1])) - _BACK, 0)
    along = road.axis[last, :2] - road.axis[max(last - _LEG, 0), :2]
    run = float(np.hypot(*along))
    far = space.sight(road.axis[[last]], np.arctan2(along[[1]], along[[0]]), _LOOK_M).distance[0] - space.cell
    if run == 0.0 or far <= 0.0:
        return road
    steps = np.linspace(0.0, far, max(round(far / space.cell), 1) + 1)[1:, None]
    ahead = road.axis[last] + np.hstack([steps * along / run, 0.0 * steps])
    rows = _walked(ahead, space)
    tail = np.column_stack([ahead[: len(rows), :2], space.height[rows]])
    clearance = np.concatenate([road.clearance[: last + 1], space.clearance[rows].astype(np.float64)])
    return Roadway(road.nodes, np.vstack([road.axis[: last + 1], tail]), clearance)


def _walked(line: Array, space: FreeSpace) -> list[int]:
    """Rows of the cells along a line (k, 3) whose heights are not known but for the first, as far as there is floor."""
    rows: list[int] = []
    z = float(line[0, 2])
    for x, y in line[:, :2]:
        row = int(space.find(np.array([[x, y, z]]))[0])
        if row < 0:
            break
        rows.append(row)
        z = float(space.height[row])
    return rows

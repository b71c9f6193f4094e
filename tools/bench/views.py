"""Views of intersections as a robot has them: a few stacked keyframes on the way through, entered from each branch."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from localize.settings import KeyframeSettings
from localize.voxel_map import voxel_means
from maps.views import View
from semmap.geometry import Array, inverse, se3, so3_exp, transform, yaw_rotation
from semmap.intersections import Intersection, SemanticMap
from semmap.rig import LidarBlock
from tools.simulator.lidar import beam_directions, measured_ranges
from tools.simulator.mine import Mine
from tools.simulator.rigs import default_rig
from tools.simulator.settings import MotionSettings, SensorFaults

KEYFRAMES = 5
REACH_M = 8.0
"""Along the way, from the last keyframe to the invariant point at most, before it and behind it."""
_STEP, _CORNER_M = 0.25, 1.0
_CLEAR_M = 0.4
"""A place nearer to the rock than this is none a robot flies through."""
_STEP_NOISE_M, _STEP_NOISE_RAD, _TILT_NOISE_RAD = 0.02, 0.002, 0.004
"""Odometry from keyframe to keyframe, and its vertical, where noise is asked for."""


@dataclass(frozen=True, slots=True, eq=False)
class Approach:
    """Stacked keyframes near one intersection.

    row : of the intersection in the map. branch : by which the robot came in, in the order of the graph's edges.
    along : how far the last keyframe is past the intersection on its way [m], negative before it.
    views : the keyframes in a gravity-aligned frame of any yaw with its origin at the last one.
    T_map_stack : (4, 4).
    """

    row: int
    branch: int
    along: float
    views: tuple[View, ...]
    T_map_stack: Array

    @property
    def wholly_near(self) -> bool:
        """Whether all its keyframes are within the reach."""
        return abs(self.along) <= REACH_M and abs(self.along - (KEYFRAMES - 1) * KeyframeSettings().distance) <= REACH_M


def approaches(there: SemanticMap, mine: Mine, count: int, *, seed: int, noise: bool = False) -> Iterator[Approach]:
    """Views spread evenly over the branches of all intersections; ways without room for a robot give none."""
    ways = [(row, branch) for row in range(len(there)) for branch in range(len(_leaving(there, row)))]
    rng = np.random.default_rng([seed, 21])
    rounds = -(-count // max(len(ways), 1))
    order = np.concatenate([rng.permutation(len(ways)) for _ in range(rounds)])[:count]
    for number, way in enumerate(order.tolist()):
        row, branch = ways[way]
        one = _approach(there, mine, row, branch, np.random.default_rng([seed, 22, number]), noise)
        if one is not None:
            yield one


def _leaving(there: SemanticMap, row: int) -> list[Array]:
    """Axes (k, 3) of the roadways that leave an intersection, each beginning at it; a loop leaves twice."""
    graph = there.roadways
    is_here = graph.node_intersection == there.intersections[row].id
    out = []
    for (a, b), axis in zip(graph.edge_nodes, graph.edge_axes, strict=True):
        out += [axis] if is_here[a] else []
        out += [axis[::-1]] if is_here[b] else []
    return out


def _approach(
    there: SemanticMap, mine: Mine, row: int, branch: int, rng: np.random.Generator, noise: bool
) -> Approach | None:
    keyframes = KeyframeSettings()
    line, at_point = _way(_leaving(there, row), branch, there.intersections[row], rng)
    before = (KEYFRAMES - 1) * keyframes.distance
    first, last = max(-REACH_M, before - at_point), min(REACH_M, (len(line) - 1) * _STEP - at_point)
    if first >= last:
        return None
    along = float(rng.uniform(first, last))
    at = (at_point + along - before + keyframes.distance * np.arange(KEYFRAMES)) / _STEP
    poses = [_pose(line, index, rng) for index in at]
    if mine.raycaster.clearance(np.array([T[:3, 3] for T in poses])).min() < _CLEAR_M:
        return None
    T_map_stack = se3(yaw_rotation(rng.uniform(0.0, 2.0 * np.pi)), poses[-1][:3, 3])
    believed = _drifted(poses, rng) if noise else poses
    views = tuple(_view(mine, T, b, T_map_stack, keyframes, rng) for T, b in zip(poses, believed, strict=True))
    return Approach(row, branch, along, views, T_map_stack)


def _way(leaving: list[Array], branch: int, one: Intersection, rng: np.random.Generator) -> tuple[Array, float]:
    """A path (k, 3) on the floor in steps, in by one branch and out by another, and how far along it the point is."""
    others = [axis for number, axis in enumerate(leaving) if number != branch] or [leaving[branch]]
    outward = others[int(rng.integers(len(others)))]
    path = np.concatenate([leaving[branch][::-1], outward[1:]])
    walked = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    at = np.arange(0.0, walked[-1], _STEP)
    line = np.stack([np.interp(at, walked, path[:, k]) for k in range(3)], axis=-1)
    line = gaussian_filter1d(line, _CORNER_M / _STEP, axis=0, mode="nearest")
    return line, float(np.argmin(np.linalg.norm(line - one.p_map, axis=1)) * _STEP)


def _pose(line: Array, index: float, rng: np.random.Generator) -> Array:
    """LiDAR pose (4, 4) over a place of the path: it looks along the path, follows its slope and wobbles a little."""
    motion = MotionSettings()
    here, ahead, behind = (_at(line, index + step) for step in (0.0, 2.0, -2.0))
    dx, dy, dz = ahead - behind
    pitch = -np.arctan2(dz, np.hypot(dx, dy))
    wobble = so3_exp(np.radians(motion.wobble_deg) * np.append(rng.normal(size=2), 0.0))
    R = yaw_rotation(np.arctan2(dy, dx)) @ so3_exp(np.array([0.0, pitch, 0.0])) @ wobble
    return se3(R, here + [0.0, 0.0, motion.height])


def _at(line: Array, index: float) -> Array:
    steps = np.arange(len(line))
    return np.array([np.interp(index, steps, line[:, k]) for k in range(3)])


def _drifted(poses: list[Array], rng: np.random.Generator) -> list[Array]:
    """The poses as odometry has them: errors add up backwards from the last, and all share a tilt."""
    last = poses[-1]
    tilt = se3(so3_exp(_TILT_NOISE_RAD * np.append(rng.normal(size=2), 0.0)), np.zeros(3))
    error, out = tilt, []
    for T in reversed(poses):
        out.append(last @ error @ inverse(last) @ T)
        step = se3(so3_exp(_STEP_NOISE_RAD * rng.normal(size=3)), _STEP_NOISE_M * rng.normal(size=3))
        error = error @ step
    return out[::-1]


def _view(
    mine: Mine,
    T_map_lidar: Array,
    believed: Array,
    T_map_stack: Array,
    keyframes: KeyframeSettings,
    rng: np.random.Generator,
) -> View:
    """One keyframe: measured from where the LiDAR is, put where it is believed to be."""
    block = default_rig().lidar
    assert block is not None
    T_stack_lidar = inverse(T_map_stack) @ believed
    points = transform(T_stack_lidar, voxel_means(_scan(mine, T_map_lidar, block, rng), keyframes.voxel))
    return View(points.astype(np.float32), T_stack_lidar[:3, 3])


def _scan(mine: Mine, T_map_lidar: Array, block: LidarBlock, rng: np.random.Generator) -> Array:
    """Points (n, 3) of one turn at rest, lidar frame."""
    directions = beam_directions(block).reshape(-1, 3)
    starts = np.broadcast_to(T_map_lidar[:3, 3], directions.shape)
    hits = mine.raycaster.cast(starts, directions @ T_map_lidar[:3, :3].T)
    ranges, kept = measured_ranges(hits, block, SensorFaults(), rng)
    return np.asarray(ranges[kept, None] * directions[kept])

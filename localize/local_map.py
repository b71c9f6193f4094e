"""The part of the mine the odometry has seen, as what it matches its next scan to."""

from __future__ import annotations

from math import hypot
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from localize._numba_knowledge import new_share
from localize.features import curvature_features
from localize.filter import ErrorStateFilter
from localize.lidar import VAGUE, ScanPart, ScanToMap
from localize.settings import OdometrySettings
from localize.voxel_map import RangeNoise, Renewal, Shapes, VoxelMap, voxel_means
from semmap.errors import SettingsError
from semmap.geometry import Array, inverse, rotation_angle, transform
from semmap.measurements import Scan
from semmap.rig import LidarBlock

_BEAM_STD = 0.002
"""Direction of a beam: half its divergence, as data sheets give it [rad]."""
_STEP_M, _STEP_RAD = 0.35, 0.05
"""A scan from nearer than this to the last mapped one is not mapped: scans that follow closely lie off alike."""
_BLIND_STEP_M, _BLIND_FOR_M = 0.1, 20.0
"""The same where a scan was blind along a direction, and for so long after: what first shows there is met as soon as it
is mapped, and more often than it is mapped its error would be taken for so many. From still nearer the same few lines
of rock would come again and again and pass for planes. Only a scan that meets too little to tell anything, in dust, is
mapped wherever it is from: of rock that one return in thirty comes from there are no planes else."""
_SETTLED = 2e-3
"""A step of an update below this [rad, m] is the last: what the next would mend is of its second order."""
_LEAN_WALK = 1e-4
"""How the map comes to lean as it grows, beyond what its planes' own errors make of it [rad/√m]. Gravity takes it back
at once where speed is seen; along a smooth tunnel it passes for acceleration, and the slide grows with it."""


_HUNG_M, _HUNG_SHARE = 0.5, 0.15
"""So near to its ends, and in so much of it at the far end, nothing is in a range's way: tags sit on robots, anchors
hang on rock, and one low on a wall is seen along the floor."""
_SEEN_M = 200.0
"""What lies farther along a range's way is not looked at: no LiDAR sees so far in a mine."""


_LEVER_M = 10.0
"""At which a turn of the map counts as a move: as `VAGUE` has it."""


class Surface(NamedTuple):
    """The points of one scan (n, 3), in the lidar frame at its end, that belong to one voxel map."""

    points: Array
    voxels: VoxelMap


class ScanMatch(NamedTuple):
    """How a scan met the map: points that met a shape, points tried, and what they alone say of the pose.

    information : (6, 6) by rotation and position of the imu, in its own axes; None where too few points matched.
    """

    matched: int
    considered: int
    information: Array | None


class LocalMap:
    """Voxel maps of the shapes that the settings ask for, and how new they are.

    ``T_odom_map`` and its error are states of the filter. The map is built from poses that are off: `extend` tells the
    filter that the map now lies as wrong as the pose, by the share of it that is new.
    """

    def __init__(self, lidar: LidarBlock, settings: OdometrySettings) -> None:
        self.settings = settings
        self.noise = RangeNoise(lidar.range_std**2, _BEAM_STD**2)
        shapes = Shapes.PLANES_AND_EDGES if settings.features == "eigenvalues" else Shapes.PLANES
        self.planes = VoxelMap(settings.voxel_size, max_points=settings.voxel_points, shapes=shapes)
        self.edges = VoxelMap(settings.voxel_size, max_points=settings.voxel_points, shapes=Shapes.EDGES)
        self.begin()

    def begin(self) -> None:
        """Begin anew, with nothing: the filter has dropped what the map was built by."""
        self.planes.clear()
        self.edges.clear()
        self._T_odom_last: Array | None = None
        self._since_blind_m = np.inf
        self._grown_m = 0.0
        self._old: Array | None = None
        """What the map keeps of its error since a scan last told how far its shapes are off (6, 6); None if all."""
        self._doubt = np.zeros((6, 6))
        self._told = False

    def surfaces(self, scan: Scan, deskewed: Array) -> list[Surface]:
        """What of a scan's points, ``deskewed`` (n, 3), goes where.

        Raises `SettingsError` where curvature is asked for and the LiDAR does not tell its rings.
        """
        if self.settings.features != "curvature":
            return [Surface(deskewed, self.planes)]
        if scan.ring is None:
            raise SettingsError(
                "needs the points' rings", field="odometry.features", mend="use 'planes', or record the field `ring`"
            )
        found = curvature_features(deskewed, scan.ring, scan.offsets_ns)
        return [Surface(deskewed[found.planar], self.planes), Surface(deskewed[found.edges], self.edges)]

    def match(self, surfaces: list[Surface], filter: ErrorStateFilter) -> ScanMatch:
        """Update the filter with a scan."""
        s = self.settings
        parts = [ScanPart(voxel_means(points, s.scan_voxel), voxels) for points, voxels in surfaces]
        model = ScanToMap(parts, self.noise, s.gate, s.correlation, s.min_matches)
        if len(self.planes):
            filter.centre_map()
            self._age(model, filter)
            filter.update(model, iterations=s.iterations, tolerance=_SETTLED)
            self._doubt, self._told = model.doubt, model.pose_information is not None
            if model.blind.size:
                self._since_blind_m = 0.0
        return ScanMatch(model.matched, sum(len(part.points) for part in parts), model.pose_information)

    def _age(self, model: ScanToMap, filter: ErrorStateFilter) -> None:
        """What is new in the map is off by itself, too, and the scan that first meets it tells by how much."""
        if self._old is None:
            return
        noise = model.map_noise(filter.state)
        if noise is not None:
            # the map forgets its old error at the rate at which it takes on new: so its variance stays what it is
            filter.add_map_noise(_positive(noise - self._old @ noise @ self._old.T) + self._leaning(filter.state.g))
            self._old, self._grown_m = None, 0.0

    def _leaning(self, g: Array) -> Array:
        """Covariance (6, 6) of how the map leans by what it grew, against gravity ``g`` (3,)."""
        up = g / np.linalg.norm(g)
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = _LEAN_WALK**2 * self._grown_m * (np.eye(3) - np.outer(up, up))
        return covariance

    def hides(self, tags: Array, anchors: Array, T_odom_map: Array) -> NDArray[np.bool_]:
        """Whether rock that was seen lies between tags and anchors (n, 3) in odom: what is heard came through it."""
        T_map_odom = inverse(T_odom_map)
        begin, end = transform(T_map_odom, tags), transform(T_map_odom, anchors)
        metres = np.linalg.norm(end - begin, axis=1)
        last = np.minimum(metres - np.maximum(_HUNG_M, _HUNG_SHARE * metres), _SEEN_M)
        return self.planes.crosses(begin, end, np.full(len(begin), _HUNG_M), last)

    def extend(self, surfaces: list[Surface], filter: ErrorStateFilter) -> None:
        """Put a scan in at the filter's pose, if it is from another place than the last one."""
        T = filter.state.T_odom_imu
        if self._T_odom_last is not None:
            moved = inverse(self._T_odom_last) @ T
            step_m = hypot(*moved[:3, 3])
            least_m = _STEP_M if self._since_blind_m > _BLIND_FOR_M else _BLIND_STEP_M
            if self._told and step_m < least_m and rotation_angle(moved[:3, :3]) < _STEP_RAD:
                return
            self._grown_m += step_m
            self._since_blind_m += step_m
        self._T_odom_last = T
        T_map_odom = inverse(filter.state.T_odom_map)
        T_map_lidar = T_map_odom @ T @ filter.state.T_imu_lidar
        centre = transform(T_map_odom, filter.state.map_centre)
        for points, voxels in surfaces:
            voxels.forget_far(T_map_lidar[:3, 3], self.settings.max_voxels)
            renewal = voxels.insert(points, T_map_lidar, centre)
            if voxels is self.planes:
                R_odom_imu = filter.state.R
                doubt = np.concatenate([R_odom_imu @ self._doubt[:3], R_odom_imu @ self._doubt[3:]])
                new = renewed(renewal, filter.state.T_odom_map[:3, :3], doubt)
                filter.extend_map(new)
                old = np.eye(6) - new
                self._old = old if self._old is None else old @ self._old


def renewed(renewal: Renewal, R_odom_map: Array, doubt: Array) -> Array:
    """How much of the map is new (6, 6), by direction, 0 to 1, in the axes of odom.

    In a tunnel whose walls are known, the first rock ahead is all that tells of the way along it, and it is new though
    hardly any of the map is. Where the last scan was blind all is new: what a later scan will find there is what is put
    in now; and the more so the nearer it came to that, by its ``doubt`` (6, 6), see `ScanToMap`. The directions are
    those that the map knows best and least, square to one another with turns as metres at `_LEVER_M`: so no step makes
    more of an error than it is, and neither do many, be there ever so few shapes.
    """
    share = np.empty((6, 6))
    new_share(renewal.A, renewal.new, np.ascontiguousarray(R_odom_map), doubt, np.diag(VAGUE), _LEVER_M, share)
    return share


def _positive(covariance: Array) -> Array:
    """The nearest to a symmetric (n, n) that is a covariance: most often itself."""
    try:
        np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        pass
    else:
        return covariance
    variances, axes = np.linalg.eigh(covariance)
    return np.asarray((axes * np.maximum(variances, 0.0)) @ axes.T)

"""The iterated error-state Kalman filter (paper 000 Eq. 1 to 4). It knows no sensor: a sensor offers information."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from localize._numba_propagation import deskew, propagate
from localize._numba_update import solved
from localize.settings import ExtrinsicSettings
from localize.state import (
    ACCEL_BIAS,
    BIASES_FROM,
    CLONE,
    ERROR_DIM,
    GRAVITY,
    GYRO_BIAS,
    LIDAR,
    MAP,
    ODOM,
    POSITION,
    RANGE_SCALE,
    ROTATION,
    TAG,
    VELOCITY,
    WHEEL,
    NavState,
)
from semmap.geometry import Array, se3, skew
from semmap.rig import ImuBlock

_SURE_SIGMAS = 2.0


@dataclass(frozen=True, slots=True)
class Information:
    """What a sensor says at one state: ``A = Σ HᵀN⁻¹H`` and ``b = -Σ HᵀN⁻¹r``, over the error columns ``columns``.

    blind : (m, k) combinations of the columns of which the sensor says nothing, whatever A has there.
    """

    A: Array
    b: Array
    columns: NDArray[np.int64]
    blind: Array | None = None


class MeasurementModel(Protocol):
    """A sensor to the filter: residual, Jacobian and noise at a state, already summed."""

    def linearize(self, state: NavState) -> Information | None:
        """The information at ``state``; None where the measurement says nothing (no match, gated)."""
        ...


def information(residual: Array, H: Array, covariance: Array, columns: NDArray[np.int64]) -> Information:
    """Information of a residual (m,) with Jacobian (m, k) over ``columns`` (k,) and noise covariance (m, m)."""
    weighted = np.linalg.solve(covariance, H).T
    return Information(weighted @ H, -weighted @ residual, columns)


def _hanging_on(info: Information, P: Array) -> Array:
    """Columns (dim, m), whose squares add up to the part of P that hangs on errors which a sensor is blind for."""
    if info.blind is None:
        return np.zeros((len(P), 0))
    PS = P[:, info.columns] @ info.blind.T
    values, vectors = np.linalg.eigh(info.blind @ PS[info.columns])
    used = values > 1e-12 * max(values[-1], 1e-12)
    return np.asarray(PS @ vectors[:, used] / np.sqrt(values[used]))


@dataclass(frozen=True, slots=True)
class InertialTrack:
    """States at the IMU samples of one interval, to deskew between; times are seconds after ``zero_ns``."""

    zero_ns: int
    t: Array
    R: Array
    p: Array
    v: Array
    rate: Array
    acceleration: Array

    def deskew(
        self, points: NDArray[np.float32], offsets_ns: NDArray[np.int64], stamp_ns: int, T_imu_lidar: Array
    ) -> Array:
        """Points (n, 3) of the lidar, each at its own time, in the lidar frame at the end of the track."""
        out = np.empty((len(points), 3))
        times = (offsets_ns + (stamp_ns - self.zero_ns)) * 1e-9
        R, p = np.ascontiguousarray(T_imu_lidar[:3, :3]), np.ascontiguousarray(T_imu_lidar[:3, 3])
        deskew(points, times, self.t, self.R, self.p, self.v, self.rate, self.acceleration, R, p, out)
        return out

    def moved(self, T: Array) -> InertialTrack:
        """The track as it lies after odom's ``T`` (4, 4) moved it."""
        R = T[:3, :3]
        return InertialTrack(
            self.zero_ns, self.t, R @ self.R, self.p @ R.T + T[:3, 3], self.v @ R.T, self.rate, self.acceleration @ R.T
        )

    @property
    def poses(self) -> Array:
        """``T_odom_imu`` (n, 4, 4) at the samples."""
        return se3(self.R, self.p)


def joined(tracks: list[InertialTrack]) -> InertialTrack:
    """Consecutive tracks as one."""
    first = tracks[0]
    if len(tracks) == 1:
        return first
    shift = [(track.zero_ns - first.zero_ns) * 1e-9 for track in tracks]
    return InertialTrack(
        first.zero_ns,
        np.concatenate([track.t + dt for track, dt in zip(tracks, shift, strict=True)]),
        *(np.concatenate([getattr(track, name) for track in tracks]) for name in InertialTrack.__slots__[2:]),
    )


class ErrorStateFilter:
    """State, covariance and time; `predict` carries them on, `update` takes a sensor in.

    Parameters
    ----------
    state, P : start values, P (dim, dim) in the order of `localize.state`.
    stamp_ns : their time.
    imu : noise densities.
    """

    def __init__(self, state: NavState, P: Array, stamp_ns: int, imu: ImuBlock) -> None:
        self.state, self.P, self.stamp_ns = state, P, stamp_ns
        self._densities = np.array([imu.gyro_noise, imu.accel_noise, imu.gyro_bias_walk, imu.accel_bias_walk]) ** 2

    def predict(self, stamps_ns: NDArray[np.int64], gyro: Array, accel: Array) -> InertialTrack:
        """Propagate over IMU samples (n,), (n, 3), (n, 3), the first at the present (paper 000 Eq. 1)."""
        n = len(stamps_ns)
        t = (stamps_ns - stamps_ns[0]) * 1e-9
        track = InertialTrack(int(stamps_ns[0]), t, np.empty((n, 3, 3)), *(np.empty((n, 3)) for _ in range(4)))
        s = self.state
        propagate(
            s.R, s.p, s.v, s.gyro_bias, s.accel_bias, s.g, self.P, t, gyro, accel, self._densities,
            track.R, track.p, track.v, track.rate, track.acceleration,
        )  # fmt: skip
        self.stamp_ns = int(stamps_ns[-1])
        return track

    def transition(self, stamp_ns: int, columns: NDArray[np.int64], F: Array, Q: Array) -> None:
        """The covariance after a prediction of another kind: ``F``, ``Q`` (k, k) over ``columns``; the rest stays."""
        self.P[columns] = F @ self.P[columns]
        self.P[:, columns] = self.P[:, columns] @ F.T
        self.P[np.ix_(columns, columns)] += Q
        self.stamp_ns = stamp_ns

    def update(self, model: MeasurementModel, *, iterations: int = 1, tolerance: float = 5e-4) -> Information | None:
        """Maximum a posteriori state given one sensor (paper 000 Eq. 4); returns the last linearization or None.

        Each step solves ``(I + P A) δ = P b - (x ⊟ x̂)``, which needs no inverse of P: extrinsics that are known
        exactly have zero rows in it and stay as they are. Errors which the sensor is blind for are considered, but
        stay as they are (Schmidt's filter): with what hangs on them they are set aside meanwhile.
        """
        predicted, info, offset = self.state, None, np.zeros(len(self.P))
        for _ in range(iterations):
            latest = model.linearize(self.state)
            if latest is None:
                break
            info = latest
            aside = _hanging_on(info, self.P)
            P = self.P - aside @ aside.T if aside.size else self.P
            rhs = P[:, info.columns] @ info.b - offset
            delta = solved(P, info.columns, info.A, rhs[:, None])[:, 0]
            self.state = self.state.boxplus(delta)
            if np.abs(delta[:6]).max() < tolerance:
                break
            offset = self.state.boxminus(predicted)
        if info is not None:
            both = solved(P, info.columns, info.A, np.hstack([P, aside]) if aside.size else P)
            P, aside = both[:, : len(P)], both[:, len(P) :]
            self.P = 0.5 * (P + P.T)
            if aside.size:
                self.P += aside @ aside.T
        return info

    def clone_pose(self) -> None:
        """Remember the present pose as that of the last keyframe, with its correlation."""
        self.state.T_odom_clone = self.state.T_odom_imu
        self.P[CLONE] = self.P[:6]
        self.P[:, CLONE] = self.P[:, :6]

    def centre_map(self) -> None:
        """Tell the local map's error at the present place: a map that is turned lies the more off the farther away."""
        moved = self.state.p - self.state.map_centre
        J = np.eye(6)
        J[3:, :3] = -skew(moved)
        self.state.map_centre = self.state.p.copy()
        self.P[MAP] = J @ self.P[MAP]
        self.P[:, MAP] = self.P[:, MAP] @ J.T

    def extend_map(self, new: Array) -> None:
        """The map lies, by as much of it as is ``new`` (6, 6), as wrong as the present pose it was put in with.

        new : the share by direction, 0 to 1, of how the map lies turned and moved, in the axes of odom.
        """
        J = np.zeros((6, len(self.P)))
        J[:, MAP] = np.eye(6) - new
        J[:, ROTATION] = new[:, :3] @ self.state.R
        J[:, POSITION] = new[:, 3:]
        # the points lie where the LiDAR is thought to be: its mounting moves them as the pose does
        R_imu_lidar, p_imu_lidar = self.state.T_imu_lidar[:3, :3], self.state.T_imu_lidar[:3, 3]
        turned = new[:, :3] + new[:, 3:] @ skew(self.state.R @ p_imu_lidar)
        J[:, LIDAR] = np.hstack([turned @ self.state.R @ R_imu_lidar, new[:, 3:] @ self.state.R])
        rows = J @ self.P
        own = rows @ J.T
        self.P[MAP], self.P[:, MAP] = rows, rows.T
        self.P[MAP, MAP] = own

    def add_map_noise(self, covariance: Array) -> None:
        """The planes put in lie off by themselves."""
        self.P[MAP, MAP] += covariance

    def locate(
        self,
        T_map_odom: Array,
        covariance: Array,
        *,
        range_scale_std: float = 0.0,
        clock_offset: float = 0.0,
        clock_offset_std: float = 0.0,
    ) -> None:
        """Where odom lies becomes a state, from the place of the robot in the map, which is known apart from odom's.

        covariance : (6, 6) of that place's ``[φ, t]``: turned about the robot and moved, in the axes of the map.
        range_scale_std : what the scale of UWB ranges may be off by; 0 does not estimate it.
        clock_offset, clock_offset_std : of the total station's clock, and how well that is known [s]; likewise.
        """
        s, R = self.state, T_map_odom[:3, :3]
        J = np.zeros((6, len(self.P)))
        # what the pose errs by in odom, odom errs by in the map the other way round
        J[:3, ROTATION] = -R @ s.R
        J[3:, POSITION] = -R
        s.T_map_odom, s.odom_centre = T_map_odom, R @ s.p + T_map_odom[:3, 3]
        self._append(J, covariance)
        s.clock_offset = clock_offset
        self._append(np.zeros((2, len(self.P))), np.diag([range_scale_std**2, clock_offset_std**2]))

    def centre_odom(self) -> None:
        """Tell the error of ``T_map_odom`` at the present place of the robot, as `centre_map` does."""
        s = self.state
        assert s.T_map_odom is not None
        centre = s.T_map_odom[:3, :3] @ s.p + s.T_map_odom[:3, 3]
        J = np.eye(6)
        J[3:, :3] = -skew(centre - s.odom_centre)
        s.odom_centre = centre
        self.P[ODOM] = J @ self.P[ODOM]
        self.P[:, ODOM] = self.P[:, ODOM] @ J.T

    def doubt_odom(self, std: float) -> None:
        """Odom may have lain elsewhere in the map, off by so much [m]."""
        place = np.arange(ODOM.start + 3, ODOM.stop)
        self.P[place, place] += std**2

    def true_distance(self, anchor: int, distance: float) -> float:
        """A UWB distance [m] without the anchor's bias and the radios' scale, as far as they are known for sure.

        A correction below two of its deviations is none: it would carry the filter's own error into the distance.
        """
        s = self.state
        if anchor not in s.anchors:
            return distance
        true = (distance - s.bias_of(anchor)) / s.range_scale
        index = np.r_[RANGE_SCALE, BIASES_FROM + s.anchors.index(anchor)]
        h = np.array([true, 1.0])
        std = np.sqrt(h @ self.P[np.ix_(index, index)] @ h)
        return float(true) if abs(distance - true) > _SURE_SIGMAS * std else distance

    def hear(self, anchor: int, std: float) -> None:
        """An anchor's range bias becomes a state [m]; odom must be located before."""
        if anchor not in self.state.anchors:
            self.state.anchors += (anchor,)
            self.state.range_biases = np.append(self.state.range_biases, 0.0)
            self._append(np.zeros((1, len(self.P))), np.array([[std**2]]))

    def forget(self, anchor: int) -> None:
        """An anchor's range bias is no longer a state."""
        index, s = self.state.anchors.index(anchor), self.state
        s.anchors, s.range_biases = s.anchors[:index] + s.anchors[index + 1 :], np.delete(s.range_biases, index)
        column = BIASES_FROM + index
        self.P = np.delete(np.delete(self.P, column, axis=0), column, axis=1)

    def age_biases(self, variance: float) -> None:
        """The range biases wandered, each by itself, by this much [m²]."""
        self.P[BIASES_FROM:, BIASES_FROM:] += variance * np.eye(len(self.state.anchors))

    def _append(self, J: Array, covariance: Array) -> None:
        """New columns whose error is ``J`` times the old error, and an error of their own."""
        rows = J @ self.P
        self.P = np.block([[self.P, rows.T], [rows, rows @ J.T + covariance]])

    def covariance_since_clone(self) -> Array:
        """Covariance (6, 6), rotation first, of ``T_clone_imu`` perturbed on the right (gtsam's order)."""
        R_clone = self.state.T_odom_clone[:3, :3]
        R_rel = R_clone.T @ self.state.R
        p_clone = R_clone.T @ (self.state.p - self.state.T_odom_clone[:3, 3])
        J = np.zeros((6, len(self.P)))
        J[:3, ROTATION] = np.eye(3)
        J[:3, CLONE.start : CLONE.start + 3] = -R_rel.T
        J[3:, POSITION] = self.state.R.T
        J[3:, CLONE.start + 3 : CLONE.stop] = -self.state.R.T
        J[3:, CLONE.start : CLONE.start + 3] = R_rel.T @ skew(p_clone)
        covariance: Array = J @ self.P @ J.T
        return covariance


def start_covariance(
    imu: ImuBlock, *, tilt_std: float, velocity_std: float, g: Array, mountings: ExtrinsicSettings
) -> Array:
    """Covariance (49, 49) at the start: the pose defines odom and is exact; gravity may lean by ``tilt_std`` [rad]."""
    P = np.zeros((ERROR_DIM, ERROR_DIM))
    P[VELOCITY, VELOCITY] = velocity_std**2 * np.eye(3)
    P[GYRO_BIAS, GYRO_BIAS] = imu.gyro_bias_std**2 * np.eye(3)
    P[ACCEL_BIAS, ACCEL_BIAS] = imu.accel_bias_std**2 * np.eye(3)
    down = g / np.linalg.norm(g)
    for columns, mounting in ((LIDAR, mountings.lidar), (TAG, mountings.tag), (WHEEL, mountings.wheel)):
        P[columns, columns] = np.diag(np.repeat([mounting.rotation_std**2, mounting.position_std**2], 3))
    P[GRAVITY, GRAVITY] = (tilt_std * np.linalg.norm(g)) ** 2 * (np.eye(3) - np.outer(down, down))
    return P

"""Inertial navigation held by a total station's prism fixes (paper 002 Eq. 16 to 26).

The error state is ordered as the first 15 columns of `localize.state`, so that either filter can start the other:
attitude ``R Exp(θ)``, position, velocity, gyroscope bias, accelerometer bias. In the paper position comes first, and
its attitude error turns in the navigation frame; with ours in the body, ``-(ω_in x)`` of Eq. 20 becomes ``-(ω_ib x)``,
which holds earth and transport rate already. A bias decays: where Eq. 18 and 20 print ``1/T`` they mean ``-1/T``.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from pydantic import PositiveFloat

from localize.earth import Earth
from localize.mechanization import Increments, NavigationTrack, Navigator
from semmap.errors import MeasurementError
from semmap.geometry import Array, se3, skew, so3_exp, so3_log
from semmap.measurements import PrismFix
from semmap.rig import ImuBlock, TotalStationBlock
from semmap.settings import Settings

ROTATION, POSITION, VELOCITY = slice(0, 3), slice(3, 6), slice(6, 9)
GYRO_BIAS, ACCEL_BIAS = slice(9, 12), slice(12, 15)
DIM = 15
_CLOCK = 15
"""Beyond the paper: the total station's clock comes last."""
_COVARIANCE_STEP_S = 0.02
"""The covariance is carried on in steps of this length, at the most: shorter than motion, longer than a sample."""


class InsTotalStationSettings(Settings):
    """The INS/total-station filter."""

    bias_time_s: PositiveFloat = 3600.0
    """Time constant T of the biases, first-order Markov processes about their start [s]."""
    gate: PositiveFloat = 16.27
    """A fix whose squared Mahalanobis distance is beyond this is refused (one of a thousand good ones)."""


@dataclass(frozen=True, slots=True, eq=False)
class InsState:
    """``R`` (3, 3) of the imu, position ``p`` and velocity ``v`` (3,) in map axes, biases (3,) [rad/s, m/s²]."""

    R: Array
    p: Array
    v: Array
    gyro_bias: Array
    accel_bias: Array

    @property
    def T_map_imu(self) -> Array:
        """Pose (4, 4)."""
        return se3(self.R, self.p)

    def boxplus(self, delta: Array) -> InsState:
        """The state moved by an error (15,) (paper 002 Eq. 16, 26)."""
        return InsState(
            self.R @ so3_exp(delta[ROTATION]),
            self.p + delta[POSITION],
            self.v + delta[VELOCITY],
            self.gyro_bias + delta[GYRO_BIAS],
            self.accel_bias + delta[ACCEL_BIAS],
        )

    def boxminus(self, other: InsState) -> Array:
        """The error (15,) that takes ``other`` to this state."""
        pairs = ((self.p, other.p), (self.v, other.v), (self.gyro_bias, other.gyro_bias))
        turn = so3_log(other.R.T @ self.R)
        return np.concatenate([turn, *(a - b for a, b in pairs), self.accel_bias - other.accel_bias])


@dataclass(frozen=True, slots=True)
class FixOutcome:
    """What became of a fix: whether ``used``, its squared Mahalanobis distance, and how far off it was [m].

    log_likelihood : how likely it was, less a constant; one that is refused is no less likely than the gate.
    """

    used: bool
    distance2: float
    off_m: float
    log_likelihood: float


def error_rates(state: InsState, rate: Array, force: Array, earth: Earth, bias_time_s: float) -> Array:
    """``F`` (15, 15) of Eq. 19, 20 at a state, with the measured rate and specific force (3,) less their biases."""
    F = np.zeros((DIM, DIM))
    F[ROTATION, ROTATION] = -skew(rate)
    F[ROTATION, GYRO_BIAS] = -np.eye(3)
    F[POSITION, VELOCITY] = np.eye(3)
    F[VELOCITY, ROTATION] = -state.R @ skew(force)
    F[VELOCITY, ACCEL_BIAS] = -state.R
    F[VELOCITY, VELOCITY] = -skew(2.0 * earth.rate + earth.transport @ state.v)
    F[GYRO_BIAS, GYRO_BIAS] = F[ACCEL_BIAS, ACCEL_BIAS] = -np.eye(3) / bias_time_s
    return F


def transition(state: InsState, rate: Array, force: Array, earth: Earth, bias_time_s: float, dt: float) -> Array:
    """Matrix (15, 15) that carries the error over ``dt`` [s] (Eq. 21), from the mean rate and specific force in it.

    Taken to the second order, with the attitude of the interval's middle: the print's first order leaves the position
    out of what a specific force's error does.
    """
    middle = InsState(state.R @ so3_exp(0.5 * dt * rate), state.p, state.v, state.gyro_bias, state.accel_bias)
    F = dt * error_rates(middle, rate, force, earth, bias_time_s)
    return np.asarray(np.eye(DIM) + F + 0.5 * F @ F)


def noise_rates(imu: ImuBlock) -> Array:
    """``G W Gᵀ`` (15, 15) of Eq. 19, 20, 21 from the rig's densities; white noise looks the same from all sides."""
    densities = [imu.gyro_noise, 0.0, imu.accel_noise, imu.gyro_bias_walk, imu.accel_bias_walk]
    return np.diag(np.repeat(np.square(densities), 3))


def prism_jacobian(state: InsState, p_imu_prism: Array) -> Array:
    """``H`` (3, 15) of the prism's position ``p + R l`` (Eq. 22; the print has two blocks too many)."""
    H = np.zeros((3, DIM))
    H[:, ROTATION] = -state.R @ skew(p_imu_prism)
    H[:, POSITION] = np.eye(3)
    return H


class InsTotalStationFilter:
    """State, covariance and time of the inertial navigation; `predict` carries them on, `update` takes a fix in.

    Parameters
    ----------
    state, P : at the start; P (15, 15) in the order rotation, position, velocity, gyroscope bias, accelerometer bias.
        The biases are Markov processes about those of the start.
    stamp_ns : their time.
    imu, station : noise densities; lever arm and noise of the prism.
    earth : in map axes.

    Attributes
    ----------
    refused : fixes that the gate kept out so far, of all and in a row.
    clock_offset : to be added to the total station's stamps, beside what the rig says [s].
    covariance : (16, 16) of all, the clock last.
    """

    def __init__(
        self,
        state: InsState,
        P: Array,
        stamp_ns: int,
        imu: ImuBlock,
        station: TotalStationBlock,
        earth: Earth,
        settings: InsTotalStationSettings | None = None,
    ) -> None:
        self.covariance = np.zeros((DIM + 1, DIM + 1))
        self.covariance[_CLOCK, _CLOCK] = station.time_offset_std**2
        self.P, self.stamp_ns, self.earth = P, stamp_ns, earth
        self.clock_offset = 0.0
        self._rate = np.zeros(3)
        self.settings = settings or InsTotalStationSettings()
        self.refused = self.refused_in_a_row = 0
        self._navigator = Navigator(state.R, state.v, state.p, earth)
        self._biases = np.concatenate([state.gyro_bias, state.accel_bias])
        self._mean_biases = self._biases.copy()
        self._noise = noise_rates(imu)
        self._p_imu_prism = np.array(station.p_imu_prism)
        self._point_variance = station.point_std**2

    @property
    def P(self) -> Array:
        """That of the state (15, 15)."""
        return self.covariance[:DIM, :DIM]

    @P.setter
    def P(self, P: Array) -> None:
        self.covariance[:DIM, :DIM] = P

    def placed_by_fixes(self) -> None:
        """The place was read from fixes on the way: it is off along that by what their clock is off by."""
        J = np.eye(DIM + 1)
        J[POSITION, _CLOCK] = -self._prism_speed(self.state)
        self.covariance = J @ self.covariance @ J.T

    @property
    def state(self) -> InsState:
        """The state now."""
        n = self._navigator
        return InsState(n.R, n.p, n.v, self._biases[:3].copy(), self._biases[3:].copy())

    def predict(self, stamps_ns: NDArray[np.int64], gyro: Array, accel: Array) -> NavigationTrack:
        """Navigate over samples (n,), (n, 3), (n, 3), the first at the present (Eq. 21); returns the track (n,).

        Raises
        ------
        MeasurementError
            Where the samples do not begin at the filter's time, or do not go on.
        """
        if len(stamps_ns) < 2 or stamps_ns[0] != self.stamp_ns or (np.diff(stamps_ns) <= 0).any():
            what = "samples do not begin at the filter's time and go on from there"
            raise MeasurementError(what, field="InsTotalStationFilter.predict", mend="interpolate one at stamp_ns")
        seconds = (stamps_ns - stamps_ns[0]) * 1e-9
        steps = np.searchsorted(seconds, np.arange(_COVARIANCE_STEP_S, seconds[-1], _COVARIANCE_STEP_S))
        cuts = np.unique([0, *steps, len(seconds) - 1])
        tracks = [self._step(stamps_ns[a : b + 1], gyro[a : b + 1], accel[a : b + 1]) for a, b in pairwise(cuts)]
        self.stamp_ns = int(stamps_ns[-1])
        first = tracks[0]
        joined = [np.concatenate([getattr(first, name), *(getattr(t, name)[1:] for t in tracks[1:])]) for name in "Rvp"]
        return NavigationTrack(stamps_ns, *joined)

    def _step(self, stamps_ns: NDArray[np.int64], gyro: Array, accel: Array) -> NavigationTrack:
        """A few samples: state by the navigator, covariance by their mean rate and force."""
        before, dt = self.state, float(stamps_ns[-1] - stamps_ns[0]) * 1e-9
        increments = Increments.of_samples(stamps_ns, gyro - before.gyro_bias, accel - before.accel_bias)
        track = self._navigator.run(increments)
        rate, force = increments.angle.sum(axis=0) / dt, increments.velocity.sum(axis=0) / dt
        Phi = transition(before, rate, force, self.earth, self.settings.bias_time_s, dt)
        self._rate = rate
        Phi = np.block([[Phi, np.zeros((DIM, 1))], [np.zeros(DIM), 1.0]])
        P = Phi @ self.covariance @ Phi.T
        P[:DIM, :DIM] += dt * self._noise
        self.covariance = 0.5 * (P + P.T)
        decay = np.exp(-dt / self.settings.bias_time_s)
        self._biases = self._mean_biases + decay * (self._biases - self._mean_biases)
        return track

    def update(self, fix: PrismFix) -> FixOutcome:
        """Take in a fix at the filter's time (Eq. 22 to 26).

        Raises
        ------
        MeasurementError
            Where the fix is of another time.
        """
        if fix.stamp_ns != self.stamp_ns:
            what = f"is {(fix.stamp_ns - self.stamp_ns) * 1e-9:.6g} s off the filter's time"
            raise MeasurementError(what, field="PrismFix.stamp_ns", mend="predict up to the fix first")
        state = self.state
        speed = self._prism_speed(state)
        residual = fix.p_map - (state.p + state.R @ self._p_imu_prism + speed * self.clock_offset)
        H = np.column_stack([prism_jacobian(state, self._p_imu_prism), speed])
        # a speed that is off puts the fix off by as long as its clock is
        H[:, VELOCITY] += self.clock_offset * np.eye(3)
        noise = self._point_variance * np.eye(3)
        S = H @ self.covariance @ H.T + noise
        distance2 = float(residual @ np.linalg.solve(S, residual))
        off_m = float(np.linalg.norm(residual))
        likely = -0.5 * (min(distance2, self.settings.gate) + float(np.log(np.linalg.det(S / self._point_variance))))
        if distance2 > self.settings.gate:
            self.refused, self.refused_in_a_row = self.refused + 1, self.refused_in_a_row + 1
            return FixOutcome(False, distance2, off_m, likely)
        self.refused_in_a_row = 0
        K = np.linalg.solve(S, H @ self.covariance).T
        delta = K @ residual
        self._put(state.boxplus(delta[:DIM]))
        self.clock_offset += float(delta[_CLOCK])
        # Joseph's form of Eq. 25 stays positive
        left = np.eye(DIM + 1) - K @ H
        self.covariance = left @ self.covariance @ left.T + K @ noise @ K.T
        return FixOutcome(True, distance2, off_m, likely)

    def prism(self) -> tuple[Array, Array]:
        """Where the prism is in the map (3,), and the covariance (3, 3) of that [m²]."""
        state = self.state
        H = prism_jacobian(state, self._p_imu_prism)
        return state.p + state.R @ self._p_imu_prism, H @ self.P @ H.T

    def _prism_speed(self, state: InsState) -> Array:
        """How fast the prism moves in the map (3,) [m/s]."""
        return np.asarray(state.v + state.R @ np.cross(self._rate, self._p_imu_prism))

    def _put(self, state: InsState) -> None:
        self._navigator.R, self._navigator.p, self._navigator.v = state.R, state.p, state.v
        self._biases = np.concatenate([state.gyro_bias, state.accel_bias])

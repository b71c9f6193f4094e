"""Roll, pitch and yaw with their rates; the body's rotation, angular velocity and acceleration from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from semmap.geometry import Array


@dataclass(frozen=True, slots=True, eq=False)
class Angles:
    """Angles (n, 3) in the order roll, pitch, yaw [rad], and their first and second time derivatives."""

    value: Array
    rate: Array
    acceleration: Array

    def __add__(self, other: Angles) -> Angles:
        return Angles(self.value + other.value, self.rate + other.rate, self.acceleration + other.acceleration)

    def rotation(self) -> Array:
        """``R_map_imu = Rz(yaw) Ry(pitch) Rx(roll)``, (n, 3, 3)."""
        (sr, sp, sy), (cr, cp, cy) = np.sin(self.value).T, np.cos(self.value).T
        rows = [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
        return np.moveaxis(np.array(rows), -1, 0)

    def angular_velocity(self) -> Array:
        """Angular velocity (n, 3) in the body frame [rad/s]."""
        E, _ = self._rate_matrices()
        return np.asarray((E @ self.rate[..., None])[..., 0])

    def angular_acceleration(self) -> Array:
        """Time derivative (n, 3) of the angular velocity in the body frame [rad/s²]."""
        E, E_dot = self._rate_matrices()
        return np.asarray((E @ self.acceleration[..., None] + E_dot @ self.rate[..., None])[..., 0])

    def _rate_matrices(self) -> tuple[Array, Array]:
        """``E`` with ``ω = E d(roll, pitch, yaw)/dt``, and its time derivative, both (n, 3, 3)."""
        (sr, sp, _), (cr, cp, _) = np.sin(self.value).T, np.cos(self.value).T
        r, p, _ = self.rate.T
        E, E_dot = np.zeros((2, len(self.value), 3, 3))
        E[:, 0, 0], E[:, 0, 2] = 1.0, -sp
        E[:, 1, 1], E[:, 1, 2] = cr, sr * cp
        E[:, 2, 1], E[:, 2, 2] = -sr, cr * cp
        E_dot[:, 0, 2] = -cp * p
        E_dot[:, 1, 1], E_dot[:, 1, 2] = -sr * r, cr * cp * r - sr * sp * p
        E_dot[:, 2, 1], E_dot[:, 2, 2] = -cr * r, -sr * cp * r - cr * sp * p
        return E, E_dot


def direction(x: tuple[Array, Array, Array], y: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
    """``atan2(y, x)`` and its two derivatives, from x and y with theirs; each (n,)."""
    (x0, x1, x2), (y0, y1, y2) = x, y
    square = x0 * x0 + y0 * y0
    turn, turn_rate = x0 * y1 - y0 * x1, x0 * y2 - y0 * x2
    square_rate = 2.0 * (x0 * x1 + y0 * y1)
    return np.arctan2(y0, x0), turn / square, (turn_rate * square - turn * square_rate) / square**2

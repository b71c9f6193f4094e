"""The turning earth as an IMU in the mine feels it, in map axes (east, north, up, turned by the grid's bearing).

Paper 002 writes north, east, down with the body forward, right, down; we have east, north, up and forward, left, up.
`enu_of_ned` and `flu_of_frd` are the only places where the two meet.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from semmap.geometry import Array, yaw_rotation
from semmap.rig import STANDARD_GRAVITY, EarthBlock

EARTH_RATE = 7.2921e-5
"""[rad/s], paper 002 Eq. 20."""
_EQUATOR_M, _FLATTENING = 6_378_137.0, 1.0 / 298.257223563
_ECCENTRICITY2 = _FLATTENING * (2.0 - _FLATTENING)
_NED_OF_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def enu_of_ned(v_ned: ArrayLike) -> Array:
    """Vectors (..., 3) from north, east, down to east, north, up; its own inverse."""
    v_enu: Array = np.asarray(v_ned, dtype=np.float64) @ _NED_OF_ENU.T
    return v_enu


def flu_of_frd(v_frd: ArrayLike) -> Array:
    """Vectors (..., 3) from forward, right, down to forward, left, up; its own inverse."""
    v_flu: Array = np.asarray(v_frd, dtype=np.float64) * np.array([1.0, -1.0, -1.0])
    return v_flu


def normal_gravity(latitude: float) -> float:
    """Gravity [m/s²] of the WGS 84 ellipsoid at sea level at a latitude [rad] (Somigliana's formula)."""
    s2 = np.sin(latitude) ** 2
    return float(9.7803253359 * (1.0 + 1.93185265241e-3 * s2) / np.sqrt(1.0 - _ECCENTRICITY2 * s2))


@dataclass(frozen=True, slots=True, eq=False)
class Earth:
    """Rotation and gravity in map axes.

    rate : (3,) of the earth [rad/s]; zero where the latitude is not known. gravity : [m/s²], along -z.
    transport : (3, 3) that takes a velocity to the rate at which level and north turn under it [rad/m].
    """

    rate: Array
    gravity: float
    transport: Array

    @classmethod
    def of(cls, block: EarthBlock | None) -> Self:
        """The earth at the rig's latitude; standing still, with standard gravity, where the rig does not say it."""
        if block is None:
            return cls(np.zeros(3), STANDARD_GRAVITY, np.zeros((3, 3)))
        latitude = np.radians(block.latitude_deg)
        sine, cosine = np.sin(latitude), np.cos(latitude)
        root = np.sqrt(1.0 - _ECCENTRICITY2 * sine**2)
        R_N, R_M = _EQUATOR_M / root, _EQUATOR_M * (1.0 - _ECCENTRICITY2) / root**3
        rate = EARTH_RATE * np.array([0.0, cosine, sine])
        transport = np.zeros((3, 3))
        transport[0, 1], transport[1, 0], transport[2, 0] = -1.0 / R_M, 1.0 / R_N, sine / cosine / R_N
        # a bearing counts clockwise from north, a yaw the other way round
        R_map_enu = yaw_rotation(np.radians(block.grid_bearing_deg))
        return cls(R_map_enu @ rate, normal_gravity(float(latitude)), R_map_enu @ transport @ R_map_enu.T)

    def navigation_rate(self, v_map: Array) -> Array:
        """``ω_in`` (3,) [rad/s]: earth rate and transport rate at a velocity (3,) (paper 002, under Eq. 20)."""
        return np.asarray(self.rate + self.transport @ v_map)

    def acceleration(self, v_map: Array) -> Array:
        """Gravity and Coriolis, (3,) [m/s²]: what the print of paper 002 Eq. 11 leaves out."""
        turning = 2.0 * self.rate + self.transport @ v_map
        return np.array([0.0, 0.0, -self.gravity]) - np.cross(turning, v_map)

    def rate_in_odom(self, up_odom: Array, T_map_odom: Array | None) -> Array:
        """What of the earth's rate (3,) is known in odom [rad/s]: all where the map lies, else its vertical."""
        if T_map_odom is None:
            return np.asarray(self.rate[2] * up_odom)
        return np.asarray(T_map_odom[:3, :3].T @ self.rate)

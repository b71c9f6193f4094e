"""Where the pose is not held: degenerate directions and how degenerate they are (paper 000 Eq. 15 to 17).

Two looks at it. The covariance tells what the pose as a whole is off by, whatever sensors there are; the information of
a scan tells in what direction the LiDAR itself is blind, long before the pose has slid (X-ICP; Zhang et al. 2016).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from localize.modes import Latch
from localize.odometry import OdometryPose
from localize.results import Event
from localize.settings import DegeneracySettings, KeyframeSettings, ModeSettings
from semmap.geometry import Array

_TURN_KNOWN = 1.0 / 0.05**2
"""What is known of the attitude without the scan: within 0.05 rad, per axis."""
_PLACE_KNOWN = 1.0
"""What is known of the place without the scan: within 1 m."""


class Weakest(NamedTuple):
    """The direction (3,) that is known worst, and by how much: ``degree``."""

    direction: Array
    degree: float


class Degrees(NamedTuple):
    """Of translation, in odom, and of rotation, in the imu's own axes."""

    translation: Weakest
    rotation: Weakest


def literal_degrees(B: Array) -> Degrees:
    """Paper 000 Eq. 15, 16 as printed: eigenvalues of the blocks of ``M = BᵀB``, B (6, 6) rotation first.

    M squares the covariance, and each block mixes in the coupling of rotation and translation; by what the eigenvalues
    are normalised is not said, and they are not.
    """
    M = B.T @ B
    return Degrees(_largest(M[3:, 3:]), _largest(M[:3, :3]))


def degrees_per_metre(link: Array, R_odom_imu: Array, metres: float) -> Degrees:
    """Standard deviation of a relative pose over its length: [m] and [rad] a metre.

    link : covariance (6, 6) of the pose relative to an earlier one, rotation first, perturbed on the right. What paper
    000 shows in its Fig. 8 is the plain covariance, which grows with the way wherever nothing holds the place; a
    metre's share of it does not depend on how long ago that began.
    """
    translation, rotation = _largest(link[3:, 3:]), _largest(link[:3, :3])
    return Degrees(
        Weakest(R_odom_imu @ translation.direction, float(np.sqrt(translation.degree)) / metres),
        Weakest(rotation.direction, float(np.sqrt(rotation.degree)) / metres),
    )


def weakest_of_scan(A: Array, R_odom_imu: Array) -> Weakest:
    """Direction in odom in which a scan alone places the LiDAR worst, and its standard deviation [m].

    A : information (6, 6) of the scan over rotation and position of the imu, in its own axes. The attitude is sought
    with it, so its share is taken off (Schur complement). 1 m where the scan says nothing.
    """
    turns = A[:3, :3] + _TURN_KNOWN * np.eye(3)
    marginal = A[3:, 3:] - A[3:, :3] @ np.linalg.solve(turns, A[:3, 3:])
    values, vectors = np.linalg.eigh(0.5 * (marginal + marginal.T))
    return Weakest(R_odom_imu @ vectors[:, 0], float(1.0 / np.sqrt(max(values[0], 0.0) + _PLACE_KNOWN)))


def _largest(covariance: Array) -> Weakest:
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return Weakest(vectors[:, -1], max(float(values[-1]), 0.0))


@dataclass(slots=True)
class _Spell:
    """A stretch in which one measure is beyond its threshold; its direction is the mean over it."""

    latch: Latch
    scatter: Array
    worst: float = 0.0
    begin_ns: int = 0

    def direction(self) -> Array:
        """The axis (3,), its largest component positive: a direction of sliding has no sign."""
        axis: Array = np.linalg.eigh(self.scatter)[1][:, -1]
        return np.asarray(axis * np.sign(axis[np.argmax(np.abs(axis))]))


class DegeneracyMonitor:
    """Follows the degrees pose by pose and tells when one begins and ends to be degenerate.

    Attributes
    ----------
    scan, translation, rotation : the latest degrees; NaN while unknown.
    """

    def __init__(self, settings: DegeneracySettings, keyframes: KeyframeSettings) -> None:
        self.settings, self.keyframes = settings, keyframes
        self.scan = self.translation = self.rotation = float("nan")
        self._spells = {name: _Spell(Latch(), np.zeros((3, 3))) for name in ("scan", "translation", "rotation")}

    @property
    def degree(self) -> float:
        """The largest of the degrees over their thresholds: degenerate from 1 on (Eq. 17; either is enough)."""
        s = self.settings
        shares = (self.scan / s.scan, self.translation / s.translation, self.rotation / s.rotation)
        return float(np.nanmax([*shares, 0.0]))

    @property
    def degenerate(self) -> bool:
        """Whether any measure is, with hysteresis."""
        return any(spell.latch.on for spell in self._spells.values())

    def watch(self, pose: OdometryPose, modes: ModeSettings) -> list[Event]:
        """Take a pose in; returns what begins and what ends with it."""
        s, R = self.settings, pose.state.R
        events = []
        if pose.scan_information is not None:
            weakest = weakest_of_scan(pose.scan_information, R)
            self.scan = weakest.degree
            events += self._follow("scan", weakest, s.scan, pose.stamp_ns, modes)
        degrees = self._of_covariance(pose)
        if degrees is not None:
            self.translation, self.rotation = degrees.translation.degree, degrees.rotation.degree
            for name, weakest, limit in zip(Degrees._fields, degrees, (s.translation, s.rotation), strict=True):
                events += self._follow(name, weakest, limit, pose.stamp_ns, modes)
        return events

    def _of_covariance(self, pose: OdometryPose) -> Degrees | None:
        if self.settings.measure == "paper":
            return literal_degrees(pose.covariance[:6, :6])
        if not pose.keyframe:
            return None
        return degrees_per_metre(pose.since_keyframe, pose.state.R, self.keyframes.distance)

    def _follow(self, name: str, weakest: Weakest, limit: float, stamp_ns: int, modes: ModeSettings) -> list[Event]:
        spell = self._spells[name]
        before = spell.latch
        beyond = weakest.degree >= (limit / (1.0 + modes.slack) if before.on else limit)
        spell.latch = before.seen(beyond, stamp_ns, modes.dwell_s)
        if beyond and not before.on and before.contrary_ns is None:
            spell.scatter, spell.worst, spell.begin_ns = np.zeros((3, 3)), 0.0, stamp_ns
        if beyond:
            spell.scatter = spell.scatter + np.outer(weakest.direction, weakest.direction)
            spell.worst = max(spell.worst, weakest.degree)
        if spell.latch.on == before.on:
            return []
        return [_event(name, spell, stamp_ns)]


def _event(name: str, spell: _Spell, stamp_ns: int) -> Event:
    return {
        "stamp_ns": int(stamp_ns),
        "kind": "degenerate",
        "of": name,
        "begun": spell.latch.on,
        "axis_imu" if name == "rotation" else "direction_odom": spell.direction().tolist(),
        "degree": spell.worst,
        "since_s": (stamp_ns - spell.begin_ns) * 1e-9,
    }

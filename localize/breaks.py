"""Notices that the odometry has broken off: the robot was carried away, or the recording has a hole."""

from __future__ import annotations

import numpy as np

from localize.odometry import OdometryPose
from localize.settings import BreakSettings

_MANY_POINTS = 100
"""A scan of fewer points, or one of dust, does not tell whether it meets the local map."""
_FEW_KEYFRAMES = 3
"""Before there are so many there is hardly a map to meet."""


class BreakWatch:
    """Watches the IMU's stamps, and how much of each scan meets the local map.

    Attributes
    ----------
    strayed : whether the last scan did not: one may be something in the way, two in a row are another place.
    """

    def __init__(self, settings: BreakSettings) -> None:
        self.settings = settings
        self.strayed = False
        self._met = (0, 0)
        self._imu_ns: int | None = None

    def silence_s(self, stamp_ns: int) -> float:
        """How long nothing came from the IMU until now [s], if that is too long to be bridged; 0 otherwise."""
        since_s = (stamp_ns - self._imu_ns) * 1e-9 if self._imu_ns is not None else 0.0
        self._imu_ns = max(stamp_ns, self._imu_ns or stamp_ns)
        return since_s if since_s > self.settings.gap_s else 0.0

    def leaves_map(self, pose: OdometryPose, keyframes: int) -> bool:
        """Whether the scans have left the local map of so many keyframes."""
        before, self._met = self._met, (pose.matched, 0 if pose.dust else pose.considered)
        least, both = self.settings.least_match, np.add(before, self._met)
        tells = keyframes >= _FEW_KEYFRAMES and min(before[1], self._met[1]) >= _MANY_POINTS
        self.strayed = tells and pose.matched < least * pose.considered
        return bool(tells and both[0] < least * both[1])

    def begin_again(self) -> None:
        """With a new local map."""
        self.strayed, self._met = False, (0, 0)

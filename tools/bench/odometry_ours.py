"""semmap's own odometry for the benchmark: LiDAR and IMU only, no wheel, no map."""

from __future__ import annotations

from localize.odometry import OdometryPose
from localize.settings import KeyframeSettings, OdometrySettings
from localize.start import StartingOdometry
from semmap.errors import SettingsError
from semmap.measurements import ImuSample, Scan
from semmap.rig import Rig
from semmap.settings import validate
from tools.bench.odometry_cache import Array, OrganisedScan, Recorded
from tools.bench.peers import Estimate


class Ours:
    """The filter as `Localizer` runs it; a scan is used in the call that hands it over, since the IMU covers it."""

    def __init__(self, recorded: Recorded, settings: OdometrySettings) -> None:
        self._odometry = StartingOdometry(Rig.model_validate(recorded.about["rig"]), settings, KeyframeSettings())
        self._new: list[OdometryPose] = []

    def imu(self, stamp_ns: int, gyro: Array, accel: Array) -> None:
        self._new += self._odometry.add(ImuSample(stamp_ns, gyro, accel))

    def prepare(self, scan: OrganisedScan) -> Scan:
        points, offsets_ns, ring = scan.returns()
        return Scan(scan.stamp_ns, points, offsets_ns, ring)

    def scan(self, prepared: Scan) -> None:
        self._new += self._odometry.add(prepared)

    def estimates(self) -> list[Estimate]:
        new, self._new = self._new, []
        return [Estimate(pose.stamp_ns, pose.T_odom_imu, pose.covariance[:6, :6].copy()) for pose in new]


def settings_of(chosen: str) -> OdometrySettings:
    """Settings of the odometry from ``name=value`` pairs joined by ``+``. Raises `SettingsError`."""
    values = dict(pair.partition("=")[::2] for pair in chosen.split("+") if pair)
    return validate(OdometrySettings, values, file="--systems", error=SettingsError)

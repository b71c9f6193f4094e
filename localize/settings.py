"""Settings of the online side, one small model a step."""

from __future__ import annotations

from pydantic import Field, PositiveFloat, PositiveInt

from semmap.settings import Settings


class OdometrySettings(Settings):
    """The LiDAR-inertial filter."""

    voxel_size: PositiveFloat = 0.5
    """Edge of the local map's voxels [m]."""
    voxel_points: PositiveInt = 60
    """Points after which a voxel stays as it is."""
    scan_voxel: PositiveFloat = 0.4
    """Scan points are averaged over voxels of this edge [m] before matching."""
    iterations: PositiveInt = 4
    gate: PositiveFloat = 4.0
    """Point-to-plane residuals beyond this many sigmas are left out."""
    correlation: PositiveFloat = 4.0
    """How many matched points share one error of the local map."""
    min_matches: PositiveInt = 30
    wheel_interval_s: PositiveFloat = 0.1
    """Wheel readings closer than this are skipped: their errors repeat."""
    wheel_scale_std: PositiveFloat = 0.01
    """Unknown scale of the wheel, relative."""
    sideways_std: PositiveFloat = 0.1
    """How well the non-holonomic constraint holds, sideways and upward [m/s]."""
    slip_gate: PositiveFloat = 16.0
    """Squared Mahalanobis distance of the forward speed beyond which the wheel slips."""
    start_s: PositiveFloat = 1.0
    """The first stretch, run several times to find speed and tilt [s]."""
    start_velocity_std: PositiveFloat = 2.0
    """What is known of the speed at the start without a wheel [m/s]."""
    start_tilt_std: PositiveFloat = 0.03
    """What is known of the vertical from the first stretch's accelerometer [rad]."""


class LocalizeSettings(Settings):
    """All of the online side."""

    odometry: OdometrySettings = Field(default_factory=OdometrySettings)

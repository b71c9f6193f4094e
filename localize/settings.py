"""Settings of the online side, one small model a step."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt

from semmap.settings import Settings


class MountingSettings(Settings):
    """How far off a sensor's place on the robot may be; 0 takes the rig at its word and does not estimate it."""

    rotation_std: NonNegativeFloat = 0.0
    """Of the attitude, per axis [rad]."""
    position_std: NonNegativeFloat = 0.0
    """Of the position, per axis [m]."""


class ExtrinsicSettings(Settings):
    """Which mountings the filter estimates on the way, each for itself."""

    lidar: MountingSettings = Field(default_factory=MountingSettings)
    tag: MountingSettings = Field(default_factory=MountingSettings)
    wheel: MountingSettings = Field(default_factory=MountingSettings)


class OdometrySettings(Settings):
    """The LiDAR-inertial filter."""

    voxel_size: PositiveFloat = 0.5
    """Edge of the local map's voxels [m]."""
    voxel_points: PositiveInt = 60
    """Points after which a voxel stays as it is."""
    max_voxels: PositiveInt = 500_000
    """When the local map holds more, the farther half of it is forgotten (some 15 km of roadway)."""
    features: Literal["planes", "eigenvalues", "curvature"] = "planes"
    """What scans are matched by: planes; planes and edges told apart in the map (paper 002 Eq. 30); or in the scan, by
    the curvature of its rings (LOAM)."""
    scan_points: PositiveInt = 8000
    """A scan of more points is thinned evenly to so many; keyframes keep all."""
    scan_voxel: PositiveFloat = 0.4
    """Scan points are averaged over voxels of this edge [m] before matching."""
    iterations: PositiveInt = 4
    gate: PositiveFloat = 4.0
    """Point-to-plane residuals beyond this many sigmas are left out."""
    correlation: PositiveFloat = 2.0
    """How many matched points share one error of the local map."""
    min_matches: PositiveInt = 30
    wheel_interval_s: PositiveFloat = 0.1
    """Wheel readings over this long are averaged into one."""
    wheel_scale_std: NonNegativeFloat = 0.01
    """How far off the wheel's scale may be, relative; it is estimated. 0 takes the wheel at its word."""
    sideways_std: PositiveFloat = 0.1
    """How well the non-holonomic constraint holds, sideways and upward [m/s]."""
    start_s: PositiveFloat = 2.0
    """The first stretch, run several times to find speed and tilt [s]."""
    start_velocity_std: PositiveFloat = 2.0
    """What is known of the speed at the start without a wheel [m/s]."""
    start_tilt_std: PositiveFloat = 0.03
    """What is known of the vertical from the first stretch's accelerometer [rad]."""
    extrinsics: ExtrinsicSettings = Field(default_factory=ExtrinsicSettings)


class DenoiseSettings(Settings):
    """The filter that takes engine vibration out of an IMU (`imu.engines` in the rig)."""

    motion_hz: PositiveFloat = 2.0
    """What is slower than this is motion and stays [Hz]."""
    window_s: PositiveFloat = 8.0
    """Recordings are sifted in windows of this length, half over half [s]."""
    sifts: PositiveInt = 4
    """Siftings of a mode."""
    online_window_s: PositiveFloat = 3.0
    """Online, what is sifted at a time [s]."""
    online_step_s: PositiveFloat = 1.0
    """Online, how often [s]; with `motion_hz` it makes the latency."""

    @property
    def margin_s(self) -> float:
        """Half the slow part's window [s]: nearer than this to an end of the signal it is not known well."""
        return 0.5 / self.motion_hz

    @property
    def latency_s(self) -> float:
        """How old a sample is, at the most, when the online filter gives it back, less one sample [s]."""
        return self.margin_s + self.online_step_s


class PrismSettings(Settings):
    """Prism fixes on their way into the filter."""

    gate: PositiveFloat = 16.27
    """A fix whose squared Mahalanobis distance is beyond this is refused (one of a thousand good ones)."""
    contradicting: PositiveInt = 8
    """So many refused fixes in a row that belong together say that the filter is wrong."""


class KeyframeSettings(Settings):
    """When a scan becomes a keyframe (paper 004 Eq. 8, 9), and how many are stacked (Eq. 20)."""

    distance: PositiveFloat = 1.0
    """Least distance to the last keyframe, ε_t [m]."""
    angle: PositiveFloat = 0.35
    """Least angle to the last keyframe, ε_θ [rad]."""
    stacked: PositiveInt = 15
    """Keyframes stacked for the descriptors, N_his, at the most."""
    stacked_std: PositiveFloat = 0.15
    """The way from the oldest of them is known this well; where odometry slides, older ones would blur it [m]."""
    voxel: PositiveFloat = 0.15
    """Keyframe clouds are averaged over voxels of this edge [m]."""


class MatcherSettings(Settings):
    """From an observed intersection to one of the database (paper 004 section 3.2, steps 3 to 8)."""

    min_pwcv: float = Field(0.7, ge=0.0, le=1.0)
    """Least PWCV similarity of a candidate, ε_pwcv."""
    candidates: PositiveInt = 5
    """Candidates that go on to the CWC comparison, at the most."""
    min_cwc: float = Field(0.5, ge=0.0, le=1.0)
    """Least CWC similarity of a match."""
    consecutive: PositiveInt = 3
    """Keyframes that must agree on one intersection, ε_same."""
    lag_scans: NonNegativeInt = 5
    """Scans after which what a keyframe saw counts: recognition works beside the odometry meanwhile; 0 waits for it."""
    search_radius: PositiveFloat = 15.0
    """With a pose known, candidates lie within this of where the intersection is seen, beside 3 sigma [m]."""


class VerificationSettings(Settings):
    """The ICP check (paper 004 section 3.2, step 9)."""

    radius: PositiveFloat = 12.0
    """Points around the intersection that are compared [m]."""
    voxel: PositiveFloat = 0.4
    """Points are averaged over voxels of this edge before they are compared [m]."""
    min_points: PositiveInt = 150
    """Fewer points prove nothing."""
    max_distance: PositiveFloat = 0.3
    """A point further than this from the map does not fit [m]."""
    min_fit: float = Field(0.85, ge=0.0, le=1.0)
    """Least part of the points that fits."""
    max_icp_distance: PositiveFloat = 0.15
    """ε_icp: greatest root mean square distance of the points that fit [m]."""
    point_std: PositiveFloat = 0.05
    """Sensor and map noise of one pair of points [m]; likeness is measured by it."""


class ProofSettings(Settings):
    """When matched intersections prove where the robot is: what paper 004 leaves to ICP alone."""

    no_likeness: float = Field(0.6, ge=0.0, le=1.0)
    """A place as like what is seen as this speaks neither for nor against being there; less speaks against it."""
    sure_likeness: float = Field(0.85, ge=0.0, le=1.0)
    """A place as like as this proves it alone; of those less like it takes several, each counting by its likeness."""
    lead: float = Field(0.3, ge=0.0)
    """By how much the evidence must lead that for any other place; 1 is a proof."""
    apart: PositiveFloat = 2.0
    """Keyframes at least this far apart count as independent views, and a proof takes two [m]."""
    position_std: PositiveFloat = 0.2
    """What two proofs of one place may differ by, beyond their covariance and the odometry's between them [m]."""
    rotation_std: PositiveFloat = 0.03
    """The same of their attitude [rad]."""
    max_position_std: PositiveFloat = 1.0
    """With its place known less well than this, one fitting intersection is no proof, though it agrees [m]."""


class DegeneracySettings(Settings):
    """When the pose counts as degenerate, in some direction (paper 000 Eq. 15 to 17)."""

    measure: Literal["per metre", "paper"] = "per metre"
    """What of the covariance is compared: standard deviation of the way from keyframe to keyframe over its length, or
    the eigenvalues of paper 000's M = BᵀB as printed."""
    translation: PositiveFloat = 0.05
    """Threshold D_p: [m] a metre, or as printed."""
    rotation: PositiveFloat = 0.05
    """Threshold D_r: [rad] a metre, or as printed."""
    scan: PositiveFloat = 0.05
    """A scan alone that places the LiDAR no better than this in some direction is weak there [m]."""


class ModeSettings(Settings):
    """When the motion mode changes (paper 000 Eq. 18, 19)."""

    hold_s: PositiveFloat = 2.0
    """A sensor that said nothing for this long no longer counts [s]."""
    dwell_s: PositiveFloat = 1.0
    """Evidence must last this long before it counts [s]."""
    slack: PositiveFloat = 0.25
    """How far back beyond its limit a conclusion must be before it is given up, relative."""
    min_anchors: PositiveInt = 2
    """Anchors that must be heard before UWB holds the place; it does until none is."""


class SightingSettings(Settings):
    """UWB ranges and prism fixes."""

    interval_s: PositiveFloat = 0.5
    """Readings of one anchor, or of the prism, closer than this share one error [s]."""
    window: PositiveInt = 400
    """Sightings that the first alignment looks at, at the most."""
    align_yaw_std: PositiveFloat = 0.03
    """The first alignment must be this sure of the heading [rad]."""
    align_position_std: PositiveFloat = 0.3
    """The first alignment must be this sure of the place [m]."""


class RangeSettings(Settings):
    """The check of UWB ranges, and of prism fixes, before filter or graph takes them."""

    max_innovation: PositiveFloat = 4.0
    """What is off by more sigmas than this is refused."""
    min_gate: PositiveFloat = 0.3
    """A range off by less than this is not refused [m]."""
    min_prism_gate: PositiveFloat = 0.02
    """A prism fix off by less than this is not refused [m]."""
    huber_sigmas: PositiveFloat = 2.0
    """Beyond this many sigmas a range weighs less."""
    max_speed: PositiveFloat = 3.0
    """A range that changes faster than the robot moves has jumped [m/s]."""
    memory_s: PositiveFloat = 2.0
    """What an anchor read longer ago than this tells nothing of its next reading [s]."""
    together_s: PositiveFloat = 1.0
    """Ranges of this long a time make one fix where there is nothing but ranges [s]."""
    in_row: PositiveInt = 3
    """Readings in a row after which an anchor is taken to be blocked, or to be heard again."""
    bias_walk: NonNegativeFloat = 0.003
    """How fast what an anchor reads too long wanders [m/√s]."""


class BreakSettings(Settings):
    """When the odometry has broken off: the robot was carried away, or the recording has a hole."""

    least_match: float = Field(0.4, ge=0.0, le=1.0)
    """Least share of the points of two scans in a row that meet the local map; with less the robot is elsewhere."""
    gap_s: PositiveFloat = 1.0
    """Nothing bridges a longer silence of the IMU [s]."""


class LoopSettings(Settings):
    """Without a map: intersections found on the way, and seen again."""

    close: bool = True
    """Whether they correct the track; false leaves it to the odometry, and to ranges and fixes."""
    left: PositiveFloat = 12.0
    """An intersection farther away than this is left behind, and can be recognised when it is seen again [m]."""


class GraphSettings(Settings):
    """The pose graph."""

    link_correlation: PositiveFloat = 4.0
    """Keyframes in a row whose odometry errs the same way: multiplies the variance of relative positions."""
    drift_position: PositiveFloat = 0.0005
    """Least error of a relative pose [m]."""
    drift_rotation: PositiveFloat = 0.00005
    """The same of its attitude [rad]."""
    intersections: Literal["poses", "points"] = "poses"
    """What an intersection ties a keyframe by: the pose that ICP finds, or its position (paper 004 Eq. 22)."""
    pin_position: PositiveFloat = 0.005
    """Least standard deviation of a pin by itself [m]: what scan and odometry can do."""
    pin_rotation: PositiveFloat = 0.001
    """Least standard deviation of a pin by itself [rad]."""
    survey_position: PositiveFloat = 0.01
    """Survey of the intersections in the map [m]."""
    survey_rotation: PositiveFloat = 0.001
    """The same of how each is turned [rad]."""
    vertical_std: PositiveFloat = 0.03
    """The filter's vertical at one keyframe is known no worse than this [rad]."""
    anchor_std: PositiveFloat = 0.01
    """Survey of the UWB anchors [m]."""
    huber_sigmas: PositiveFloat = 1.5


class LocalizeSettings(Settings):
    """All of the online side."""

    odometry: OdometrySettings = Field(default_factory=OdometrySettings)
    denoise: DenoiseSettings = Field(default_factory=DenoiseSettings)
    prism: PrismSettings = Field(default_factory=PrismSettings)
    keyframes: KeyframeSettings = Field(default_factory=KeyframeSettings)
    matcher: MatcherSettings = Field(default_factory=MatcherSettings)
    verification: VerificationSettings = Field(default_factory=VerificationSettings)
    proof: ProofSettings = Field(default_factory=ProofSettings)
    sightings: SightingSettings = Field(default_factory=SightingSettings)
    degeneracy: DegeneracySettings = Field(default_factory=DegeneracySettings)
    modes: ModeSettings = Field(default_factory=ModeSettings)
    ranges: RangeSettings = Field(default_factory=RangeSettings)
    breaks: BreakSettings = Field(default_factory=BreakSettings)
    loops: LoopSettings = Field(default_factory=LoopSettings)
    graph: GraphSettings = Field(default_factory=GraphSettings)

    def without_loops(self) -> LocalizeSettings:
        """The same, but that intersections found on the way do not correct the track."""
        return self.model_copy(update={"loops": LoopSettings(close=False)})

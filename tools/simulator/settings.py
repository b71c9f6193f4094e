"""Settings of a simulation: how the robot moves, what is wrong with its sensors, what is recorded and surveyed."""

from __future__ import annotations

from pydantic import Field, FiniteFloat, NonNegativeFloat, NonNegativeInt, PositiveFloat

from semmap.settings import Settings


class MotionSettings(Settings):
    """How the route is driven or flown.

    speed : cruising speed [m/s]; height : of the IMU above the route's floor points [m].
    still_s : time at rest before the start [s]; corner : how far the route is smoothed, 1σ [m].
    max_accel, max_yaw_rate : limits along the path [m/s²] and in bends [rad/s]; the speed drops to keep them.
    wobble_deg : RMS of the slow roll and pitch motion over the path [deg].
    follow_slope : the body pitches with the path (a vehicle) or stays level (a multirotor).
    vibration_accel, vibration_gyro : RMS of the engine's shaking, 15 to 60 Hz [m/s², rad/s].
    pumps : it is that of two oil pumps with their harmonics, see `tools.simulator.vibration`.
    schedule : (metres along the route, seconds of rest there) one after the other, forwards or in reverse; once to the
        end where there are none.
    """

    speed: PositiveFloat = Field(2.0, le=30.0)
    height: NonNegativeFloat = 1.3
    still_s: NonNegativeFloat = 2.0
    corner: PositiveFloat = Field(2.0, le=20.0)
    max_accel: PositiveFloat = 0.5
    max_yaw_rate: PositiveFloat = 0.6
    wobble_deg: NonNegativeFloat = Field(1.0, le=15.0)
    follow_slope: bool = True
    vibration_accel: NonNegativeFloat = 0.0
    vibration_gyro: NonNegativeFloat = 0.0
    pumps: bool = False
    schedule: tuple[tuple[NonNegativeFloat, NonNegativeFloat], ...] = ()


class SensorFaults(Settings):
    """What goes wrong beyond the noise that the rig declares.

    noise : factor on every noise and bias of the rig; 0 makes perfect sensors.
    lidar_dropout : share of returns lost at random.
    lidar_grazing : cosine of incidence at which 63 % still return.
    lidar_far_loss : share lost at the maximum range (it grows with the sixth power of the range).
    dust : concentration in the air [mg/m³]: near returns, far ones lost; see `tools.simulator.dust`.
    wheel_scale_std : 1σ of the constant scale error.
    wheel_slips_per_min, wheel_slip : how often the wheel slips, for about a second, and by how much on average.
    wheel_slip_s : from when to when it slips for long, by ``wheel_slip`` [s since the motion's beginning].
    uwb_nlos_bias : mean excess of a range through rock, or by a detour [m].
    uwb_nlos_rate : share of ranges that come by a detour though the way is free.
    uwb_outlier_rate : share of ranges that are anything.
    uwb_dead : anchors that never answer. uwb_silent_s : from when to when none does [s since the motion's beginning].
    prism_hidden_s : from when to when the total station does not see the prism. prism_outlier_rate : share of fixes of
        something else that shines, up to a metre off. prism_clock_s : the instrument's clock less the robot's [s].
    """

    noise: NonNegativeFloat = 1.0
    lidar_dropout: FiniteFloat = Field(0.005, ge=0.0, le=1.0)
    lidar_grazing: NonNegativeFloat = 0.02
    lidar_far_loss: FiniteFloat = Field(0.5, ge=0.0, le=1.0)
    dust: NonNegativeFloat = 0.0
    wheel_scale_std: NonNegativeFloat = 0.005
    wheel_slips_per_min: NonNegativeFloat = 0.5
    wheel_slip: NonNegativeFloat = 0.2
    wheel_slip_s: tuple[NonNegativeFloat, NonNegativeFloat] | None = None
    uwb_nlos_bias: NonNegativeFloat = 0.6
    uwb_nlos_rate: FiniteFloat = Field(0.0, ge=0.0, le=1.0)
    uwb_outlier_rate: FiniteFloat = Field(0.01, ge=0.0, le=1.0)
    uwb_dead: tuple[int, ...] = ()
    uwb_silent_s: tuple[NonNegativeFloat, NonNegativeFloat] | None = None
    prism_hidden_s: tuple[NonNegativeFloat, NonNegativeFloat] | None = None
    prism_outlier_rate: FiniteFloat = Field(0.0, ge=0.0, le=1.0)
    prism_clock_s: FiniteFloat = 0.0

    @classmethod
    def none(cls) -> SensorFaults:
        """Perfect sensors: no noise, no bias, nothing lost."""
        return cls(**{name: 0.0 for name, field in cls.model_fields.items() if isinstance(field.default, float)})


class SurveySettings(Settings):
    """What the prior map shows of the mine. The robot meets none of what is missing or stands about in it.

    spacing, noise : of the points, and of each of their coordinates, 1σ [m].
    open_top : rock more than 2.2 m above the floor is missing, as in models that are made to be looked into.
    vehicles, pallets, posts : how many stand about in the roadways; posts reach the roof.
    conveyors : how many, each along a wall of one roadway.
    """

    spacing: PositiveFloat = 0.1
    noise: NonNegativeFloat = 0.01
    open_top: bool = False
    vehicles: NonNegativeInt = 0
    pallets: NonNegativeInt = 0
    posts: NonNegativeInt = 0
    conveyors: NonNegativeInt = 0


class SimulationSettings(Settings):
    """Everything `simulate` can be told.

    start_s : what is cut off the beginning; more than the time at rest, and the recording starts in motion.
    duration_s : length of the recording, to the end of the route if None.
    rolling : the robot stands on its wheel, see `Motion`.
    map : of the prior map.
    """

    motion: MotionSettings = MotionSettings()
    faults: SensorFaults = SensorFaults()
    start_s: NonNegativeFloat = 0.0
    duration_s: PositiveFloat | None = None
    rolling: bool = False
    map: SurveySettings = SurveySettings()

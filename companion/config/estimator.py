"""Configuration of the estimator: what the sensors are and how the engine treats them.

These sections are all that the engine sees; they alone decide the bits of a solution.
"""

from __future__ import annotations

from typing import Literal

from companion.config.section import Section


class Vehicle(Section):
    """The vehicle that carries it all."""

    name: str = "vehicle"
    """Part of every zenoh key, of log and state file names."""
    kind: Literal["multirotor", "fixed-wing", "ground", "handheld", "unknown"] = "unknown"
    """For people and programs that read the configuration: no estimate depends on it."""


class Imu(Section):
    """Inertial sensor: as its datasheet gives it. Defaults: a consumer MEMS on a vibrating body."""

    source: str = "auto"
    """Stream name, or ``auto`` for the best one in the log."""
    latency_ms: float = 0.0
    """Stamp − validity: a filtered IMU is late by the delay of its filter."""
    axes: tuple[tuple[float, float, float], ...] = (
        (1.0, 0.0, 0.0),
        (0.0, 1.0, 0.0),
        (0.0, 0.0, 1.0),
    )
    """Rotation from the sensor's axes to body FRD, row by row."""
    gyro_noise_dps_rthz: float = 0.02
    """Angle random walk as noise density [deg/s/√Hz]; deg/√h ÷ 60."""
    gyro_bias_sd_dps: float = 0.5
    """Turn-on bias, or what is left of it beyond ``gyro_bias_dps``, 1σ [deg/s]."""
    gyro_bias_dps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Bias to start with, body FRD [deg/s]: where an earlier run or a calibration left it."""
    gyro_bias_walk_dps_rts: float = 0.001
    """Rate random walk [deg/s/√s]."""
    gyro_bias_tau_s: float = 0.0
    """Correlation time of the bias [s]; 0: a random walk."""
    accel_noise_mps2_rthz: float = 0.01
    """Velocity random walk as noise density [m/s²/√Hz]; m/s/√h ÷ 60."""
    accel_bias_sd_mps2: float = 0.2
    """Turn-on bias of the accelerometer, or what is left of it, 1σ [m/s²]."""
    accel_bias_mps2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The same for the accelerometer, body FRD [m/s²]."""
    accel_bias_walk_mps2_rts: float = 0.0005
    """Random walk of the bias [m/s²/√s]."""
    accel_bias_tau_s: float = 0.0
    """Correlation time of the bias [s]; 0: a random walk."""
    vibration_gain_rthz: float = 0.05
    """Further accelerometer noise density per m/s² of vibration (1σ over a quarter of the
    standstill window) [1/√Hz]; rectification and aliasing grow with what shakes the sensor."""
    gyro_vibration_gain_rthz: float = 0.0
    """Further gyro noise density, axis by axis, per rate of vibration (1σ, as above) [1/√Hz]."""
    gyro_range_dps: float = 0.0
    """Full scale [deg/s]: a sample that reaches it is counted, trusted less, and speaks for a bad
    unit instead of a bad receiver. 0: not known."""
    accel_range_mps2: float = 0.0
    """The same of the accelerometer [m/s²]."""
    scale_factor_states: bool = False
    """Estimate scale factors of gyro and accelerometer, six more states; they show in turns and
    accelerations only."""
    gyro_scale_sd_ppm: float = 5000.0
    """Scale factor error at the start, 1σ, with ``scale_factor_states``."""
    accel_scale_sd_ppm: float = 5000.0
    """The same for the accelerometer."""


class FurtherImu(Section):
    """One more inertial unit beside the first, as noisy as that unless something else is said."""

    source: str
    """Stream name, such as ``imu2``."""
    lever_arm_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """From the first unit to this one, body FRD [m]."""
    axes: tuple[tuple[float, float, float], ...] = (
        (1.0, 0.0, 0.0),
        (0.0, 1.0, 0.0),
        (0.0, 0.0, 1.0),
    )
    """Rotation from this unit's axes to those of the first unit, row by row; ``imu.axes`` then
    turns both to body FRD."""
    latency_ms: float | None = None
    """Stamp − validity; absent: as the first unit's."""
    gyro_range_dps: float = 0.0
    """Full scale [deg/s]; 0: not known."""
    accel_range_mps2: float = 0.0
    """The same for the accelerometer [m/s²]."""
    gyro_noise_dps_rthz: float | None = None
    """Gyro noise density [deg/s/√Hz]; absent: as the first unit's. Of two units, nothing measured
    says whose the noise is: how they are weighed is what is said here and of the first."""
    accel_noise_mps2_rthz: float | None = None
    """The same for the accelerometer [m/s²/√Hz]."""


class ImuFusion(Section):
    """How the error-state filter takes several units (``[[further_imu]]``): as one, fused."""

    exclude: bool = True
    """Find units that have gone wrong and do without them; false: all are used at all times."""
    wait_ms: float = 30.0
    """An epoch waits this long, by the other units' stamps, for a unit that is late."""
    proof_s: float = 10.0
    """A unit that was excluded has to agree with the others for this long before it is used again;
    twice as long each further time, up to ten minutes."""
    mismatch_percent: float = 0.5
    """Scale error and misalignment of a unit against the others, 1σ, as a share of what is
    measured: calibrated units have 0.2, ones mounted by eye 2. Learned in flight."""


class Gnss(Section):
    """The GNSS receiver: what its fixes are worth, how late they are, where the antenna is."""

    source: str = "auto"
    """Stream name of the receiver, or ``auto`` for the best one."""
    latency_ms: float = 0.0
    """Stamp (or arrival) − validity of a fix."""
    latency_sd_ms: float = 10.0
    """Scatter of that latency, 1σ: counts as velocity error in proportion to acceleration and as
    position error in proportion to speed."""
    lever_arm_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """From the IMU to the antenna, body FRD [m]."""
    position: bool = True
    """Use its position."""
    velocity: bool = True
    """Use its velocity."""
    sd_position_m: float = 1.5
    """Used where the source reports none, and as the floor of a reported one: horizontal, 1σ."""
    sd_height_m: float = 3.0
    """The same for its height."""
    sd_velocity_mps: float = 0.2
    """The same for its horizontal velocity."""
    sd_velocity_down_mps: float = 0.3
    """The same for its vertical velocity."""
    sd_reported: Literal["use", "floor", "ignore"] = "floor"
    """``use``: as reported; ``floor``: the larger of reported and configured; ``ignore``."""

    max_sd_position_m: float = 50.0
    """A fix that reports worse is refused."""
    min_fix_type: int = 3
    """A fix of a lower type is refused: 2 is 2-D, 3 is 3-D, 4 differential, 5 and 6 RTK."""
    lever_arm_sd_m: float = 0.0
    """Uncertainty of the lever arm; above 0 it becomes three states of the filter."""
    slow_error_sd_m: float = 0.0
    """Slow (first-order Gauss-Markov) error of the receiver's horizontal position, 1σ. Where this
    or the next is above 0 it is three states, and the deviations above are the white part."""
    slow_error_height_sd_m: float = 0.0
    """The same for its height."""
    slow_error_tau_s: float = 120.0
    """How long the slow error stays much the same."""

    @property
    def configured_sd(self) -> tuple[float, float, float, float]:
        """Of position [m] and velocity [m/s], horizontal and vertical, without any report, 1σ."""
        return (
            self.sd_position_m,
            self.sd_height_m,
            self.sd_velocity_mps,
            self.sd_velocity_down_mps,
        )


class Baro(Section):
    """The barometer."""

    use: bool = True
    """Use the barometer."""
    latency_ms: float = 0.0
    """Stamp − validity of a sample."""
    sd_m: float = 1.0
    """Pressure height from sample to sample, 1σ."""
    bias_walk_m_rts: float = 0.03
    """Random walk of the offset between pressure height and the GNSS datum [m/√s]."""


class Mag(Section):
    """The magnetometer."""

    use: bool = False
    """Use the magnetometer as a heading; off, because most are badly calibrated."""
    latency_ms: float = 0.0
    """Stamp − validity of a sample."""
    sd_deg: float = 5.0
    """Heading, 1σ."""
    max_rate_hz: float = 10.0
    """Faster streams are thinned: neighbouring magnetometer errors are not independent."""
    declination_deg: float | None = None
    """Absent: World Magnetic Model at the place and date."""
    hard_iron_t: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Constant field of the vehicle, sensor's axes [T]: subtracted."""


class Constraints(Section):
    """Pseudo-measurements that follow from what the vehicle is."""

    zero_velocity: bool = True
    """At a standstill, velocity and turn rate are zero."""
    zero_velocity_sd_mps: float = 0.03
    """Velocity of a vehicle that stands, 1σ."""
    zero_rate_sd_dps: float = 0.05
    """Its turn rate, 1σ."""
    standstill_window_s: float = 1.0
    """A standstill is looked for over this time."""
    standstill_gyro_dps: float = 0.5
    """Largest spread of the gyro's means over the window's quarters that counts as standing."""
    standstill_accel_mps2: float = 0.12
    """The same for the accelerometer."""
    standstill_speed_mps: float = 0.3
    """A standstill is never declared while a recent GNSS velocity exceeds this (plus 2σ)."""
    non_holonomic: bool = False
    """A vehicle on wheels does not slip sideways or leave the ground."""
    non_holonomic_sd_mps: float = 0.1
    """Velocity sideways and up, 1σ."""
    non_holonomic_rate_hz: float = 2.0
    """Springs and tyres make errors that last for half a second: more often is no news."""
    non_holonomic_lever_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """From the IMU to the point that does not slip sideways (the rear axle)."""
    course: bool = False
    """Heading from GNSS course, for vehicles that point where they go."""
    course_min_speed_mps: float = 3.0
    """Slower, course says nothing."""
    course_sd_deg: float = 3.0
    """Heading against course, 1σ."""


class LastHeading(Section):
    """Heading in which an earlier run left a vehicle that stood; a warm start writes it."""

    heading_deg: float
    """Clockwise from true north."""
    sd_deg: float
    """1σ, at ``t_ns``."""
    t_ns: int
    """UTC [ns]."""


class Alignment(Section):
    """How a solution begins: level from gravity, heading from what there is."""

    heading: Literal["auto", "magnetometer", "course", "unknown", "fixed"] = "auto"
    """``auto``: magnetometer with ``mag.use``, course with ``constraints.course``, else unknown."""
    fixed_heading_deg: float = 0.0
    """With ``fixed``: clockwise from true north."""
    window_s: float = 1.0
    """Length of the accelerometer and gyro means for levelling [s]."""
    hypotheses: int = 12
    """Filters in the bank over an unknown heading."""
    heading_found_sd_deg: float = 8.0
    """The bank's heading counts as found below this deviation, 1σ."""
    last_heading: LastHeading | None = None
    """Used with ``auto`` where the vehicle still stands and, widened by its age, it is better than
    what else there is."""


class Direct(Section):
    """The direct kinematic filter (``engine.estimator = "direct"``): how the vehicle moves."""

    jerk_mps3_rthz: tuple[float, float, float] = (8.0, 8.0, 8.0)
    """White jerk, density on body x, y, z [m/s³/√Hz]: a steady spread of acceleration σ that lasts
    τ is σ √(2/τ)."""
    acceleration_tau_s: float = 1.5
    """Acceleration fades to zero with this time where nothing is measured [s]; 0: it stays."""
    angular_acceleration_dps2_rthz: tuple[float, float, float] = (80.0, 80.0, 80.0)
    """The same for the turn rate [deg/s²/√Hz]."""
    rate_tau_s: float = 0.5
    """Turn rate fades to zero with this time [s]; 0: it stays."""
    gyro_sample_sd_dps: float = 0.0
    """Vibration that a single sample carries beside the density of ``imu``, 1σ [deg/s]."""
    accel_sample_sd_mps2: float = 0.0
    """The same for the accelerometer [m/s²]."""
    max_gap_s: float = 10.0
    """A longer silence of the IMU is a declared reset; through a shorter one the model carries."""
    attitude: bool = False
    """Use the attitude of another estimator in the log (the autopilot's ATTITUDE)."""
    attitude_sd_deg: float = 1.0
    """Roll and pitch of it, what changes from message to message, 1σ."""
    attitude_yaw_sd_deg: float = 2.0
    """The same for heading."""
    attitude_slow_sd_deg: float = 1.0
    """Roll and pitch of it, what lasts for ``attitude_tau_s``, 1σ."""
    attitude_slow_yaw_sd_deg: float = 5.0
    """The same for heading."""
    attitude_tau_s: float = 60.0
    """How long the other estimator's error stays much the same."""
    transitions: bool = False
    """Mechanisms for smooth transitions (Yu et al. 2018): on a step of specific force the
    acceleration is taken from the IMU at once. For vehicles that point where they go, with little
    vibration."""
    transition_sigmas: float = 5.0
    """Step that counts, in deviations of the difference of two samples."""
    transition_sd_mps2: float = 3.0
    """How far a step may go, 1σ: added to the acceleration's own uncertainty on its axis."""
    circular_sd_mps2: float = 0.3
    """Of lateral acceleration = turn rate times speed, while turning, 1σ."""


class EngineConfig(Section):
    """The estimator as a whole: which, at what rates, with what gates and limits."""

    estimator: Literal["auto", "error-state", "direct"] = "auto"
    """``auto``: error-state; in replay direct where the best IMU is slower than 20 Hz."""
    correction: Literal["feedback", "feedforward"] = "feedback"
    """``feedback``: estimated errors are taken out of the inertial solution at once;
    ``feedforward``: it runs free, and they are carried beside it."""
    covariance_rate_hz: float = 50.0
    """Covariance propagation; the state itself runs at the IMU's rate."""
    output_rate_hz: float = 50.0
    """Published epochs a second."""
    delay_ring_s: float = 0.5
    """Aiding may arrive this late; older is refused and reported."""
    gate_probability: float = 0.9999
    """Two-sided: a good measurement passes with this probability."""
    imu_gap_bridge_s: float = 0.5
    """A longer silence of the IMU is a declared reset."""
    coasting_after_s: float = 2.0
    """Without position and velocity aiding for this long the solution is called coasting."""
    diverged_position_sd_m: float = 5000.0
    """Beyond it the solution is worthless: declared reset at the next fix."""
    gate_relock_s: float = 10.0
    """Position aiding rejected by the gate for this long: declared reset of position and velocity
    to several mutually consistent fixes. Where velocity fits, ``source_faults.patience_s``."""


class Bank(Section):
    """Several estimators on one stream of events, of which the consistent one is published."""

    estimators: tuple[str, ...] = ()
    """Words of ``companion compare`` joined by ``+``, the preferred one first, such as
    ``["error-state", "direct", "error-state+no-mag"]``; empty: one estimator, as configured. What
    no sensor word takes away, each gets."""


class SourceFaults(Section):
    """Positions that contradict the velocities of the receiver they come from."""

    detect: bool = True
    """Step or drift of position alone: none of it is fused until it agrees again."""
    patience_s: float = 60.0
    """A faulty source that has told one place for this long (or for as long as it had been good, if
    that is shorter) is believed in the end; at least ``engine.gate_relock_s``."""


class Smoothing(Section):
    """Smoothing on line: estimates that come later than the filter's, from what came after them."""

    enabled: bool = False
    """Smooth while running, live or in replay."""
    window: int = 1
    """Update intervals (from one accepted fix to the next) looked back over at each fix. An epoch
    is given out once so many more intervals are complete: more is better, later, and costs more."""
    rate_hz: float = 10.0
    """Smoothed epochs a second; at most ``engine.output_rate_hz``."""
    mixed: bool = False
    """Give out the filter's epochs between the smoothed ones as well."""
    longest_interval_s: float = 60.0
    """Without a fix for this long an interval ends all the same: bounds lag and memory."""
    load_limit: float = 0.7
    """Live: share of a core that filter and smoother may take together; beyond it the smoother
    gives way for a while."""

"""The vocabulary that every package shares: samples, solutions, reports, events, errors.

Conventions (the contract of the whole project)
-----------------------------------------------
- Frames: ``e`` ECEF (WGS-84), ``n`` local north-east-down at the vehicle, ``b`` body
  forward-right-down. ``C_nb`` and ``q_nb`` (Hamilton, scalar first) take body vectors to ``n``.
- Units are SI and radians. Names that carry another unit say so (``_deg``, ``_ms``) and live only
  in drivers, configuration keys and what people read.
- Time is int64 nanoseconds on one clock per recording. ``t_ns`` is the time of validity,
  ``t_rx_ns`` the time of arrival, ``seq`` the arrival number across all sensors of a vehicle.
- Samples are columns: one frozen object holds many samples of one sensor. A missing value is NaN.
  A single live sample is a block of length one.
"""

from companion.types.arrays import (
    F64,
    I64,
    NS,
    Flags,
    Rows,
)
from companion.types.errors import (
    CompanionError,
    ConfigError,
    ImuTooSlowError,
    LinkLost,
    LogFormatError,
)
from companion.types.health import (
    Health,
    LinkHealth,
    LinkState,
    LogHealth,
    LogState,
    LoopHealth,
    SensorHealth,
    SensorState,
)
from companion.types.outputs import (
    NO_DOP,
    NO_SATELLITES,
    NO_SMOOTHED,
    SMOOTHING_GAVE_WAY,
    SMOOTHING_RESUMED,
    Event,
    Outputs,
    Satellites,
)
from companion.types.recording import (
    Recording,
    StreamInfo,
    VehicleRecording,
)
from companion.types.samples import (
    SATELLITES,
    AidingSamples,
    AnySamples,
    AttitudeSamples,
    BaroSamples,
    BroadcastSamples,
    GnssSamples,
    ImuSamples,
    MagSamples,
    RawGnssSamples,
    ReferenceSamples,
    Samples,
)
from companion.types.solution import (
    COV_ACCEL_BIAS,
    COV_ATT,
    COV_GYRO_BIAS,
    COV_POS,
    COV_VEL,
    Mode,
    Smoothed,
    Solution,
)
from companion.types.updates import (
    AdaptationTrace,
    AidingReports,
    Channel,
    Rule,
    Verdict,
)

__all__ = [
    "COV_ACCEL_BIAS",
    "COV_ATT",
    "COV_GYRO_BIAS",
    "COV_POS",
    "COV_VEL",
    "F64",
    "I64",
    "NO_DOP",
    "NO_SATELLITES",
    "NO_SMOOTHED",
    "NS",
    "SATELLITES",
    "SMOOTHING_GAVE_WAY",
    "SMOOTHING_RESUMED",
    "AdaptationTrace",
    "AidingReports",
    "AidingSamples",
    "AnySamples",
    "AttitudeSamples",
    "BaroSamples",
    "BroadcastSamples",
    "Channel",
    "CompanionError",
    "ConfigError",
    "Event",
    "Flags",
    "GnssSamples",
    "Health",
    "ImuSamples",
    "ImuTooSlowError",
    "LinkHealth",
    "LinkLost",
    "LinkState",
    "LogFormatError",
    "LogHealth",
    "LogState",
    "LoopHealth",
    "MagSamples",
    "Mode",
    "Outputs",
    "RawGnssSamples",
    "Recording",
    "ReferenceSamples",
    "Rows",
    "Rule",
    "Samples",
    "Satellites",
    "SensorHealth",
    "SensorState",
    "Smoothed",
    "Solution",
    "StreamInfo",
    "VehicleRecording",
    "Verdict",
]

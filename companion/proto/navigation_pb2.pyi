from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Iterable as _Iterable, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class NavState(_message.Message):
    __slots__ = ("t_ns", "mode", "resets", "lat", "lon", "height", "vel_n", "q_nb", "accel_bias_b", "gyro_bias_b", "cov_pos", "cov_vel", "cov_att", "cov_accel_bias", "cov_gyro_bias", "sd_pos_m", "sd_vel_mps", "sd_att_deg", "roll_deg", "pitch_deg", "yaw_deg", "arrival_monotonic_ns", "lag_s", "as_filtered")
    class Mode(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        ALIGNING: _ClassVar[NavState.Mode]
        HEADING_UNKNOWN: _ClassVar[NavState.Mode]
        NAVIGATING: _ClassVar[NavState.Mode]
        COASTING: _ClassVar[NavState.Mode]
    ALIGNING: NavState.Mode
    HEADING_UNKNOWN: NavState.Mode
    NAVIGATING: NavState.Mode
    COASTING: NavState.Mode
    T_NS_FIELD_NUMBER: _ClassVar[int]
    MODE_FIELD_NUMBER: _ClassVar[int]
    RESETS_FIELD_NUMBER: _ClassVar[int]
    LAT_FIELD_NUMBER: _ClassVar[int]
    LON_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    VEL_N_FIELD_NUMBER: _ClassVar[int]
    Q_NB_FIELD_NUMBER: _ClassVar[int]
    ACCEL_BIAS_B_FIELD_NUMBER: _ClassVar[int]
    GYRO_BIAS_B_FIELD_NUMBER: _ClassVar[int]
    COV_POS_FIELD_NUMBER: _ClassVar[int]
    COV_VEL_FIELD_NUMBER: _ClassVar[int]
    COV_ATT_FIELD_NUMBER: _ClassVar[int]
    COV_ACCEL_BIAS_FIELD_NUMBER: _ClassVar[int]
    COV_GYRO_BIAS_FIELD_NUMBER: _ClassVar[int]
    SD_POS_M_FIELD_NUMBER: _ClassVar[int]
    SD_VEL_MPS_FIELD_NUMBER: _ClassVar[int]
    SD_ATT_DEG_FIELD_NUMBER: _ClassVar[int]
    ROLL_DEG_FIELD_NUMBER: _ClassVar[int]
    PITCH_DEG_FIELD_NUMBER: _ClassVar[int]
    YAW_DEG_FIELD_NUMBER: _ClassVar[int]
    ARRIVAL_MONOTONIC_NS_FIELD_NUMBER: _ClassVar[int]
    LAG_S_FIELD_NUMBER: _ClassVar[int]
    AS_FILTERED_FIELD_NUMBER: _ClassVar[int]
    t_ns: int
    mode: NavState.Mode
    resets: int
    lat: float
    lon: float
    height: float
    vel_n: _containers.RepeatedScalarFieldContainer[float]
    q_nb: _containers.RepeatedScalarFieldContainer[float]
    accel_bias_b: _containers.RepeatedScalarFieldContainer[float]
    gyro_bias_b: _containers.RepeatedScalarFieldContainer[float]
    cov_pos: _containers.RepeatedScalarFieldContainer[float]
    cov_vel: _containers.RepeatedScalarFieldContainer[float]
    cov_att: _containers.RepeatedScalarFieldContainer[float]
    cov_accel_bias: _containers.RepeatedScalarFieldContainer[float]
    cov_gyro_bias: _containers.RepeatedScalarFieldContainer[float]
    sd_pos_m: _containers.RepeatedScalarFieldContainer[float]
    sd_vel_mps: _containers.RepeatedScalarFieldContainer[float]
    sd_att_deg: _containers.RepeatedScalarFieldContainer[float]
    roll_deg: float
    pitch_deg: float
    yaw_deg: float
    arrival_monotonic_ns: int
    lag_s: float
    as_filtered: int
    def __init__(self, t_ns: _Optional[int] = ..., mode: _Optional[_Union[NavState.Mode, str]] = ..., resets: _Optional[int] = ..., lat: _Optional[float] = ..., lon: _Optional[float] = ..., height: _Optional[float] = ..., vel_n: _Optional[_Iterable[float]] = ..., q_nb: _Optional[_Iterable[float]] = ..., accel_bias_b: _Optional[_Iterable[float]] = ..., gyro_bias_b: _Optional[_Iterable[float]] = ..., cov_pos: _Optional[_Iterable[float]] = ..., cov_vel: _Optional[_Iterable[float]] = ..., cov_att: _Optional[_Iterable[float]] = ..., cov_accel_bias: _Optional[_Iterable[float]] = ..., cov_gyro_bias: _Optional[_Iterable[float]] = ..., sd_pos_m: _Optional[_Iterable[float]] = ..., sd_vel_mps: _Optional[_Iterable[float]] = ..., sd_att_deg: _Optional[_Iterable[float]] = ..., roll_deg: _Optional[float] = ..., pitch_deg: _Optional[float] = ..., yaw_deg: _Optional[float] = ..., arrival_monotonic_ns: _Optional[int] = ..., lag_s: _Optional[float] = ..., as_filtered: _Optional[int] = ...) -> None: ...

class SolutionBatch(_message.Message):
    __slots__ = ("source", "t_ns", "lat", "lon", "height", "vel_n", "q_nb", "accel_bias_b", "gyro_bias_b", "cov", "mode", "resets")
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    T_NS_FIELD_NUMBER: _ClassVar[int]
    LAT_FIELD_NUMBER: _ClassVar[int]
    LON_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    VEL_N_FIELD_NUMBER: _ClassVar[int]
    Q_NB_FIELD_NUMBER: _ClassVar[int]
    ACCEL_BIAS_B_FIELD_NUMBER: _ClassVar[int]
    GYRO_BIAS_B_FIELD_NUMBER: _ClassVar[int]
    COV_FIELD_NUMBER: _ClassVar[int]
    MODE_FIELD_NUMBER: _ClassVar[int]
    RESETS_FIELD_NUMBER: _ClassVar[int]
    source: str
    t_ns: _containers.RepeatedScalarFieldContainer[int]
    lat: _containers.RepeatedScalarFieldContainer[float]
    lon: _containers.RepeatedScalarFieldContainer[float]
    height: _containers.RepeatedScalarFieldContainer[float]
    vel_n: _containers.RepeatedScalarFieldContainer[float]
    q_nb: _containers.RepeatedScalarFieldContainer[float]
    accel_bias_b: _containers.RepeatedScalarFieldContainer[float]
    gyro_bias_b: _containers.RepeatedScalarFieldContainer[float]
    cov: _containers.RepeatedScalarFieldContainer[float]
    mode: _containers.RepeatedScalarFieldContainer[int]
    resets: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, source: _Optional[str] = ..., t_ns: _Optional[_Iterable[int]] = ..., lat: _Optional[_Iterable[float]] = ..., lon: _Optional[_Iterable[float]] = ..., height: _Optional[_Iterable[float]] = ..., vel_n: _Optional[_Iterable[float]] = ..., q_nb: _Optional[_Iterable[float]] = ..., accel_bias_b: _Optional[_Iterable[float]] = ..., gyro_bias_b: _Optional[_Iterable[float]] = ..., cov: _Optional[_Iterable[float]] = ..., mode: _Optional[_Iterable[int]] = ..., resets: _Optional[_Iterable[int]] = ...) -> None: ...

class AidingReport(_message.Message):
    __slots__ = ("t_ns", "channel", "verdict", "source", "dof", "innovation", "innovation_sd", "nis", "gate", "scale")
    class Channel(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        GNSS_POSITION_H: _ClassVar[AidingReport.Channel]
        GNSS_POSITION_V: _ClassVar[AidingReport.Channel]
        GNSS_VELOCITY_H: _ClassVar[AidingReport.Channel]
        GNSS_VELOCITY_V: _ClassVar[AidingReport.Channel]
        BARO: _ClassVar[AidingReport.Channel]
        MAG: _ClassVar[AidingReport.Channel]
        COURSE: _ClassVar[AidingReport.Channel]
        ZERO_VELOCITY: _ClassVar[AidingReport.Channel]
        ZERO_RATE: _ClassVar[AidingReport.Channel]
        NON_HOLONOMIC: _ClassVar[AidingReport.Channel]
        ATTITUDE: _ClassVar[AidingReport.Channel]
        GYRO: _ClassVar[AidingReport.Channel]
        ACCELEROMETER: _ClassVar[AidingReport.Channel]
        SOURCE_H: _ClassVar[AidingReport.Channel]
        SOURCE_V: _ClassVar[AidingReport.Channel]
        RANGE_GPS: _ClassVar[AidingReport.Channel]
        RANGE_GALILEO: _ClassVar[AidingReport.Channel]
        RANGE_BEIDOU: _ClassVar[AidingReport.Channel]
        RATE_GPS: _ClassVar[AidingReport.Channel]
        RATE_GALILEO: _ClassVar[AidingReport.Channel]
        RATE_BEIDOU: _ClassVar[AidingReport.Channel]
    GNSS_POSITION_H: AidingReport.Channel
    GNSS_POSITION_V: AidingReport.Channel
    GNSS_VELOCITY_H: AidingReport.Channel
    GNSS_VELOCITY_V: AidingReport.Channel
    BARO: AidingReport.Channel
    MAG: AidingReport.Channel
    COURSE: AidingReport.Channel
    ZERO_VELOCITY: AidingReport.Channel
    ZERO_RATE: AidingReport.Channel
    NON_HOLONOMIC: AidingReport.Channel
    ATTITUDE: AidingReport.Channel
    GYRO: AidingReport.Channel
    ACCELEROMETER: AidingReport.Channel
    SOURCE_H: AidingReport.Channel
    SOURCE_V: AidingReport.Channel
    RANGE_GPS: AidingReport.Channel
    RANGE_GALILEO: AidingReport.Channel
    RANGE_BEIDOU: AidingReport.Channel
    RATE_GPS: AidingReport.Channel
    RATE_GALILEO: AidingReport.Channel
    RATE_BEIDOU: AidingReport.Channel
    class Verdict(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        ACCEPTED: _ClassVar[AidingReport.Verdict]
        REJECTED_GATE: _ClassVar[AidingReport.Verdict]
        REFUSED_LATE: _ClassVar[AidingReport.Verdict]
        REFUSED_NO_FIX: _ClassVar[AidingReport.Verdict]
        REFUSED_INVALID: _ClassVar[AidingReport.Verdict]
        REFUSED_NOT_ALIGNED: _ClassVar[AidingReport.Verdict]
        REFUSED_CLOCK: _ClassVar[AidingReport.Verdict]
        REJECTED_SOURCE: _ClassVar[AidingReport.Verdict]
        REJECTED_UNCONFIRMED: _ClassVar[AidingReport.Verdict]
    ACCEPTED: AidingReport.Verdict
    REJECTED_GATE: AidingReport.Verdict
    REFUSED_LATE: AidingReport.Verdict
    REFUSED_NO_FIX: AidingReport.Verdict
    REFUSED_INVALID: AidingReport.Verdict
    REFUSED_NOT_ALIGNED: AidingReport.Verdict
    REFUSED_CLOCK: AidingReport.Verdict
    REJECTED_SOURCE: AidingReport.Verdict
    REJECTED_UNCONFIRMED: AidingReport.Verdict
    T_NS_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    DOF_FIELD_NUMBER: _ClassVar[int]
    INNOVATION_FIELD_NUMBER: _ClassVar[int]
    INNOVATION_SD_FIELD_NUMBER: _ClassVar[int]
    NIS_FIELD_NUMBER: _ClassVar[int]
    GATE_FIELD_NUMBER: _ClassVar[int]
    SCALE_FIELD_NUMBER: _ClassVar[int]
    t_ns: int
    channel: AidingReport.Channel
    verdict: AidingReport.Verdict
    source: int
    dof: int
    innovation: _containers.RepeatedScalarFieldContainer[float]
    innovation_sd: _containers.RepeatedScalarFieldContainer[float]
    nis: float
    gate: float
    scale: float
    def __init__(self, t_ns: _Optional[int] = ..., channel: _Optional[_Union[AidingReport.Channel, str]] = ..., verdict: _Optional[_Union[AidingReport.Verdict, str]] = ..., source: _Optional[int] = ..., dof: _Optional[int] = ..., innovation: _Optional[_Iterable[float]] = ..., innovation_sd: _Optional[_Iterable[float]] = ..., nis: _Optional[float] = ..., gate: _Optional[float] = ..., scale: _Optional[float] = ...) -> None: ...

class Satellites(_message.Message):
    __slots__ = ("t_ns", "used", "excluded", "gdop", "pdop", "hdop", "vdop", "tdop")
    T_NS_FIELD_NUMBER: _ClassVar[int]
    USED_FIELD_NUMBER: _ClassVar[int]
    EXCLUDED_FIELD_NUMBER: _ClassVar[int]
    GDOP_FIELD_NUMBER: _ClassVar[int]
    PDOP_FIELD_NUMBER: _ClassVar[int]
    HDOP_FIELD_NUMBER: _ClassVar[int]
    VDOP_FIELD_NUMBER: _ClassVar[int]
    TDOP_FIELD_NUMBER: _ClassVar[int]
    t_ns: int
    used: int
    excluded: int
    gdop: float
    pdop: float
    hdop: float
    vdop: float
    tdop: float
    def __init__(self, t_ns: _Optional[int] = ..., used: _Optional[int] = ..., excluded: _Optional[int] = ..., gdop: _Optional[float] = ..., pdop: _Optional[float] = ..., hdop: _Optional[float] = ..., vdop: _Optional[float] = ..., tdop: _Optional[float] = ...) -> None: ...

from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Iterable as _Iterable, Optional as _Optional

DESCRIPTOR: _descriptor.FileDescriptor

class ImuBatch(_message.Message):
    __slots__ = ("source", "t_ns", "t_rx_ns", "seq", "gyro_b", "accel_b", "interval_s", "clipped")
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    T_NS_FIELD_NUMBER: _ClassVar[int]
    T_RX_NS_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    GYRO_B_FIELD_NUMBER: _ClassVar[int]
    ACCEL_B_FIELD_NUMBER: _ClassVar[int]
    INTERVAL_S_FIELD_NUMBER: _ClassVar[int]
    CLIPPED_FIELD_NUMBER: _ClassVar[int]
    source: str
    t_ns: _containers.RepeatedScalarFieldContainer[int]
    t_rx_ns: _containers.RepeatedScalarFieldContainer[int]
    seq: _containers.RepeatedScalarFieldContainer[int]
    gyro_b: _containers.RepeatedScalarFieldContainer[float]
    accel_b: _containers.RepeatedScalarFieldContainer[float]
    interval_s: _containers.RepeatedScalarFieldContainer[float]
    clipped: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, source: _Optional[str] = ..., t_ns: _Optional[_Iterable[int]] = ..., t_rx_ns: _Optional[_Iterable[int]] = ..., seq: _Optional[_Iterable[int]] = ..., gyro_b: _Optional[_Iterable[float]] = ..., accel_b: _Optional[_Iterable[float]] = ..., interval_s: _Optional[_Iterable[float]] = ..., clipped: _Optional[_Iterable[float]] = ...) -> None: ...

class GnssBatch(_message.Message):
    __slots__ = ("source", "t_ns", "t_rx_ns", "seq", "lat", "lon", "height", "vel_n", "sd_pos", "sd_vel", "num_sats", "fix_type", "interference")
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    T_NS_FIELD_NUMBER: _ClassVar[int]
    T_RX_NS_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    LAT_FIELD_NUMBER: _ClassVar[int]
    LON_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    VEL_N_FIELD_NUMBER: _ClassVar[int]
    SD_POS_FIELD_NUMBER: _ClassVar[int]
    SD_VEL_FIELD_NUMBER: _ClassVar[int]
    NUM_SATS_FIELD_NUMBER: _ClassVar[int]
    FIX_TYPE_FIELD_NUMBER: _ClassVar[int]
    INTERFERENCE_FIELD_NUMBER: _ClassVar[int]
    source: str
    t_ns: _containers.RepeatedScalarFieldContainer[int]
    t_rx_ns: _containers.RepeatedScalarFieldContainer[int]
    seq: _containers.RepeatedScalarFieldContainer[int]
    lat: _containers.RepeatedScalarFieldContainer[float]
    lon: _containers.RepeatedScalarFieldContainer[float]
    height: _containers.RepeatedScalarFieldContainer[float]
    vel_n: _containers.RepeatedScalarFieldContainer[float]
    sd_pos: _containers.RepeatedScalarFieldContainer[float]
    sd_vel: _containers.RepeatedScalarFieldContainer[float]
    num_sats: _containers.RepeatedScalarFieldContainer[int]
    fix_type: _containers.RepeatedScalarFieldContainer[int]
    interference: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, source: _Optional[str] = ..., t_ns: _Optional[_Iterable[int]] = ..., t_rx_ns: _Optional[_Iterable[int]] = ..., seq: _Optional[_Iterable[int]] = ..., lat: _Optional[_Iterable[float]] = ..., lon: _Optional[_Iterable[float]] = ..., height: _Optional[_Iterable[float]] = ..., vel_n: _Optional[_Iterable[float]] = ..., sd_pos: _Optional[_Iterable[float]] = ..., sd_vel: _Optional[_Iterable[float]] = ..., num_sats: _Optional[_Iterable[int]] = ..., fix_type: _Optional[_Iterable[int]] = ..., interference: _Optional[_Iterable[float]] = ...) -> None: ...

class BaroBatch(_message.Message):
    __slots__ = ("source", "t_ns", "t_rx_ns", "seq", "pressure")
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    T_NS_FIELD_NUMBER: _ClassVar[int]
    T_RX_NS_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    PRESSURE_FIELD_NUMBER: _ClassVar[int]
    source: str
    t_ns: _containers.RepeatedScalarFieldContainer[int]
    t_rx_ns: _containers.RepeatedScalarFieldContainer[int]
    seq: _containers.RepeatedScalarFieldContainer[int]
    pressure: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, source: _Optional[str] = ..., t_ns: _Optional[_Iterable[int]] = ..., t_rx_ns: _Optional[_Iterable[int]] = ..., seq: _Optional[_Iterable[int]] = ..., pressure: _Optional[_Iterable[float]] = ...) -> None: ...

class MagBatch(_message.Message):
    __slots__ = ("source", "t_ns", "t_rx_ns", "seq", "field_b")
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    T_NS_FIELD_NUMBER: _ClassVar[int]
    T_RX_NS_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    FIELD_B_FIELD_NUMBER: _ClassVar[int]
    source: str
    t_ns: _containers.RepeatedScalarFieldContainer[int]
    t_rx_ns: _containers.RepeatedScalarFieldContainer[int]
    seq: _containers.RepeatedScalarFieldContainer[int]
    field_b: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, source: _Optional[str] = ..., t_ns: _Optional[_Iterable[int]] = ..., t_rx_ns: _Optional[_Iterable[int]] = ..., seq: _Optional[_Iterable[int]] = ..., field_b: _Optional[_Iterable[float]] = ...) -> None: ...

class AttitudeBatch(_message.Message):
    __slots__ = ("source", "t_ns", "t_rx_ns", "seq", "rpy")
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    T_NS_FIELD_NUMBER: _ClassVar[int]
    T_RX_NS_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    RPY_FIELD_NUMBER: _ClassVar[int]
    source: str
    t_ns: _containers.RepeatedScalarFieldContainer[int]
    t_rx_ns: _containers.RepeatedScalarFieldContainer[int]
    seq: _containers.RepeatedScalarFieldContainer[int]
    rpy: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, source: _Optional[str] = ..., t_ns: _Optional[_Iterable[int]] = ..., t_rx_ns: _Optional[_Iterable[int]] = ..., seq: _Optional[_Iterable[int]] = ..., rpy: _Optional[_Iterable[float]] = ...) -> None: ...

class RawGnssBatch(_message.Message):
    __slots__ = ("source", "t_ns", "t_rx_ns", "seq", "week", "tow", "sat", "signal", "pseudorange", "rate", "cn0", "sd_range", "sd_rate")
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    T_NS_FIELD_NUMBER: _ClassVar[int]
    T_RX_NS_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    WEEK_FIELD_NUMBER: _ClassVar[int]
    TOW_FIELD_NUMBER: _ClassVar[int]
    SAT_FIELD_NUMBER: _ClassVar[int]
    SIGNAL_FIELD_NUMBER: _ClassVar[int]
    PSEUDORANGE_FIELD_NUMBER: _ClassVar[int]
    RATE_FIELD_NUMBER: _ClassVar[int]
    CN0_FIELD_NUMBER: _ClassVar[int]
    SD_RANGE_FIELD_NUMBER: _ClassVar[int]
    SD_RATE_FIELD_NUMBER: _ClassVar[int]
    source: str
    t_ns: _containers.RepeatedScalarFieldContainer[int]
    t_rx_ns: _containers.RepeatedScalarFieldContainer[int]
    seq: _containers.RepeatedScalarFieldContainer[int]
    week: _containers.RepeatedScalarFieldContainer[int]
    tow: _containers.RepeatedScalarFieldContainer[float]
    sat: _containers.RepeatedScalarFieldContainer[int]
    signal: _containers.RepeatedScalarFieldContainer[int]
    pseudorange: _containers.RepeatedScalarFieldContainer[float]
    rate: _containers.RepeatedScalarFieldContainer[float]
    cn0: _containers.RepeatedScalarFieldContainer[float]
    sd_range: _containers.RepeatedScalarFieldContainer[float]
    sd_rate: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, source: _Optional[str] = ..., t_ns: _Optional[_Iterable[int]] = ..., t_rx_ns: _Optional[_Iterable[int]] = ..., seq: _Optional[_Iterable[int]] = ..., week: _Optional[_Iterable[int]] = ..., tow: _Optional[_Iterable[float]] = ..., sat: _Optional[_Iterable[int]] = ..., signal: _Optional[_Iterable[int]] = ..., pseudorange: _Optional[_Iterable[float]] = ..., rate: _Optional[_Iterable[float]] = ..., cn0: _Optional[_Iterable[float]] = ..., sd_range: _Optional[_Iterable[float]] = ..., sd_rate: _Optional[_Iterable[float]] = ...) -> None: ...

class BroadcastBatch(_message.Message):
    __slots__ = ("source", "t_ns", "t_rx_ns", "seq", "sat", "values")
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    T_NS_FIELD_NUMBER: _ClassVar[int]
    T_RX_NS_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    SAT_FIELD_NUMBER: _ClassVar[int]
    VALUES_FIELD_NUMBER: _ClassVar[int]
    source: str
    t_ns: _containers.RepeatedScalarFieldContainer[int]
    t_rx_ns: _containers.RepeatedScalarFieldContainer[int]
    seq: _containers.RepeatedScalarFieldContainer[int]
    sat: _containers.RepeatedScalarFieldContainer[int]
    values: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, source: _Optional[str] = ..., t_ns: _Optional[_Iterable[int]] = ..., t_rx_ns: _Optional[_Iterable[int]] = ..., seq: _Optional[_Iterable[int]] = ..., sat: _Optional[_Iterable[int]] = ..., values: _Optional[_Iterable[float]] = ...) -> None: ...

class ReferenceBatch(_message.Message):
    __slots__ = ("source", "t_ns", "t_rx_ns", "seq", "lat", "lon", "height", "vel_n", "rpy")
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    T_NS_FIELD_NUMBER: _ClassVar[int]
    T_RX_NS_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    LAT_FIELD_NUMBER: _ClassVar[int]
    LON_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    VEL_N_FIELD_NUMBER: _ClassVar[int]
    RPY_FIELD_NUMBER: _ClassVar[int]
    source: str
    t_ns: _containers.RepeatedScalarFieldContainer[int]
    t_rx_ns: _containers.RepeatedScalarFieldContainer[int]
    seq: _containers.RepeatedScalarFieldContainer[int]
    lat: _containers.RepeatedScalarFieldContainer[float]
    lon: _containers.RepeatedScalarFieldContainer[float]
    height: _containers.RepeatedScalarFieldContainer[float]
    vel_n: _containers.RepeatedScalarFieldContainer[float]
    rpy: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, source: _Optional[str] = ..., t_ns: _Optional[_Iterable[int]] = ..., t_rx_ns: _Optional[_Iterable[int]] = ..., seq: _Optional[_Iterable[int]] = ..., lat: _Optional[_Iterable[float]] = ..., lon: _Optional[_Iterable[float]] = ..., height: _Optional[_Iterable[float]] = ..., vel_n: _Optional[_Iterable[float]] = ..., rpy: _Optional[_Iterable[float]] = ...) -> None: ...

class RawBatch(_message.Message):
    __slots__ = ("link", "t_rx_ns", "seq", "size", "data")
    LINK_FIELD_NUMBER: _ClassVar[int]
    T_RX_NS_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    SIZE_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    link: str
    t_rx_ns: _containers.RepeatedScalarFieldContainer[int]
    seq: _containers.RepeatedScalarFieldContainer[int]
    size: _containers.RepeatedScalarFieldContainer[int]
    data: bytes
    def __init__(self, link: _Optional[str] = ..., t_rx_ns: _Optional[_Iterable[int]] = ..., seq: _Optional[_Iterable[int]] = ..., size: _Optional[_Iterable[int]] = ..., data: _Optional[bytes] = ...) -> None: ...

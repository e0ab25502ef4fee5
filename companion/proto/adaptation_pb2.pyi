from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Iterable as _Iterable, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class AdaptationTrace(_message.Message):
    __slots__ = ("t_ns", "channel", "source", "rule", "mean", "spread", "correlation", "to_model", "to_source", "firing", "r_scale", "q_scale", "alpha")
    class Channel(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        GNSS_POSITION_H: _ClassVar[AdaptationTrace.Channel]
        GNSS_POSITION_V: _ClassVar[AdaptationTrace.Channel]
        GNSS_VELOCITY_H: _ClassVar[AdaptationTrace.Channel]
        GNSS_VELOCITY_V: _ClassVar[AdaptationTrace.Channel]
        BARO: _ClassVar[AdaptationTrace.Channel]
        MAG: _ClassVar[AdaptationTrace.Channel]
        RANGE_GPS: _ClassVar[AdaptationTrace.Channel]
        RANGE_GALILEO: _ClassVar[AdaptationTrace.Channel]
        RANGE_BEIDOU: _ClassVar[AdaptationTrace.Channel]
        RATE_GPS: _ClassVar[AdaptationTrace.Channel]
        RATE_GALILEO: _ClassVar[AdaptationTrace.Channel]
        RATE_BEIDOU: _ClassVar[AdaptationTrace.Channel]
    GNSS_POSITION_H: AdaptationTrace.Channel
    GNSS_POSITION_V: AdaptationTrace.Channel
    GNSS_VELOCITY_H: AdaptationTrace.Channel
    GNSS_VELOCITY_V: AdaptationTrace.Channel
    BARO: AdaptationTrace.Channel
    MAG: AdaptationTrace.Channel
    RANGE_GPS: AdaptationTrace.Channel
    RANGE_GALILEO: AdaptationTrace.Channel
    RANGE_BEIDOU: AdaptationTrace.Channel
    RATE_GPS: AdaptationTrace.Channel
    RATE_GALILEO: AdaptationTrace.Channel
    RATE_BEIDOU: AdaptationTrace.Channel
    class Rule(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        NO_RULE: _ClassVar[AdaptationTrace.Rule]
        SPREAD_LOW_MEAN_ZERO: _ClassVar[AdaptationTrace.Rule]
        SPREAD_LOW_MEAN_SMALL: _ClassVar[AdaptationTrace.Rule]
        SPREAD_LOW_MEAN_LARGE: _ClassVar[AdaptationTrace.Rule]
        SPREAD_USUAL_MEAN_ZERO: _ClassVar[AdaptationTrace.Rule]
        SPREAD_USUAL_MEAN_SMALL: _ClassVar[AdaptationTrace.Rule]
        SPREAD_USUAL_MEAN_LARGE: _ClassVar[AdaptationTrace.Rule]
        SPREAD_HIGH_MEAN_ZERO: _ClassVar[AdaptationTrace.Rule]
        SPREAD_HIGH_MEAN_SMALL: _ClassVar[AdaptationTrace.Rule]
        SPREAD_HIGH_MEAN_LARGE: _ClassVar[AdaptationTrace.Rule]
    NO_RULE: AdaptationTrace.Rule
    SPREAD_LOW_MEAN_ZERO: AdaptationTrace.Rule
    SPREAD_LOW_MEAN_SMALL: AdaptationTrace.Rule
    SPREAD_LOW_MEAN_LARGE: AdaptationTrace.Rule
    SPREAD_USUAL_MEAN_ZERO: AdaptationTrace.Rule
    SPREAD_USUAL_MEAN_SMALL: AdaptationTrace.Rule
    SPREAD_USUAL_MEAN_LARGE: AdaptationTrace.Rule
    SPREAD_HIGH_MEAN_ZERO: AdaptationTrace.Rule
    SPREAD_HIGH_MEAN_SMALL: AdaptationTrace.Rule
    SPREAD_HIGH_MEAN_LARGE: AdaptationTrace.Rule
    T_NS_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    RULE_FIELD_NUMBER: _ClassVar[int]
    MEAN_FIELD_NUMBER: _ClassVar[int]
    SPREAD_FIELD_NUMBER: _ClassVar[int]
    CORRELATION_FIELD_NUMBER: _ClassVar[int]
    TO_MODEL_FIELD_NUMBER: _ClassVar[int]
    TO_SOURCE_FIELD_NUMBER: _ClassVar[int]
    FIRING_FIELD_NUMBER: _ClassVar[int]
    R_SCALE_FIELD_NUMBER: _ClassVar[int]
    Q_SCALE_FIELD_NUMBER: _ClassVar[int]
    ALPHA_FIELD_NUMBER: _ClassVar[int]
    t_ns: int
    channel: AdaptationTrace.Channel
    source: int
    rule: AdaptationTrace.Rule
    mean: float
    spread: float
    correlation: float
    to_model: float
    to_source: float
    firing: _containers.RepeatedScalarFieldContainer[float]
    r_scale: float
    q_scale: float
    alpha: float
    def __init__(self, t_ns: _Optional[int] = ..., channel: _Optional[_Union[AdaptationTrace.Channel, str]] = ..., source: _Optional[int] = ..., rule: _Optional[_Union[AdaptationTrace.Rule, str]] = ..., mean: _Optional[float] = ..., spread: _Optional[float] = ..., correlation: _Optional[float] = ..., to_model: _Optional[float] = ..., to_source: _Optional[float] = ..., firing: _Optional[_Iterable[float]] = ..., r_scale: _Optional[float] = ..., q_scale: _Optional[float] = ..., alpha: _Optional[float] = ...) -> None: ...

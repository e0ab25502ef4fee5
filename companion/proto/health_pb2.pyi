from companion.proto import navigation_pb2 as _navigation_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Iterable as _Iterable, Mapping as _Mapping, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class SensorHealth(_message.Message):
    __slots__ = ("kind", "source", "state", "used", "rate_hz", "age_s", "samples", "lost", "saturated")
    class State(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        WAITING: _ClassVar[SensorHealth.State]
        OK: _ClassVar[SensorHealth.State]
        SLOW: _ClassVar[SensorHealth.State]
        SILENT: _ClassVar[SensorHealth.State]
        BACK: _ClassVar[SensorHealth.State]
        NO_FIX: _ClassVar[SensorHealth.State]
    WAITING: SensorHealth.State
    OK: SensorHealth.State
    SLOW: SensorHealth.State
    SILENT: SensorHealth.State
    BACK: SensorHealth.State
    NO_FIX: SensorHealth.State
    KIND_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    USED_FIELD_NUMBER: _ClassVar[int]
    RATE_HZ_FIELD_NUMBER: _ClassVar[int]
    AGE_S_FIELD_NUMBER: _ClassVar[int]
    SAMPLES_FIELD_NUMBER: _ClassVar[int]
    LOST_FIELD_NUMBER: _ClassVar[int]
    SATURATED_FIELD_NUMBER: _ClassVar[int]
    kind: str
    source: str
    state: SensorHealth.State
    used: bool
    rate_hz: float
    age_s: float
    samples: int
    lost: int
    saturated: int
    def __init__(self, kind: _Optional[str] = ..., source: _Optional[str] = ..., state: _Optional[_Union[SensorHealth.State, str]] = ..., used: bool = ..., rate_hz: _Optional[float] = ..., age_s: _Optional[float] = ..., samples: _Optional[int] = ..., lost: _Optional[int] = ..., saturated: _Optional[int] = ...) -> None: ...

class LinkHealth(_message.Message):
    __slots__ = ("name", "state", "received", "malformed", "reopened", "note")
    class State(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        UP: _ClassVar[LinkHealth.State]
        LOST: _ClassVar[LinkHealth.State]
        RETRYING: _ClassVar[LinkHealth.State]
    UP: LinkHealth.State
    LOST: LinkHealth.State
    RETRYING: LinkHealth.State
    NAME_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    RECEIVED_FIELD_NUMBER: _ClassVar[int]
    MALFORMED_FIELD_NUMBER: _ClassVar[int]
    REOPENED_FIELD_NUMBER: _ClassVar[int]
    NOTE_FIELD_NUMBER: _ClassVar[int]
    name: str
    state: LinkHealth.State
    received: int
    malformed: int
    reopened: int
    note: str
    def __init__(self, name: _Optional[str] = ..., state: _Optional[_Union[LinkHealth.State, str]] = ..., received: _Optional[int] = ..., malformed: _Optional[int] = ..., reopened: _Optional[int] = ..., note: _Optional[str] = ...) -> None: ...

class LoopHealth(_message.Message):
    __slots__ = ("load", "latency_p50_ms", "latency_p99_ms", "latency_max_ms", "stall_ms")
    LOAD_FIELD_NUMBER: _ClassVar[int]
    LATENCY_P50_MS_FIELD_NUMBER: _ClassVar[int]
    LATENCY_P99_MS_FIELD_NUMBER: _ClassVar[int]
    LATENCY_MAX_MS_FIELD_NUMBER: _ClassVar[int]
    STALL_MS_FIELD_NUMBER: _ClassVar[int]
    load: float
    latency_p50_ms: float
    latency_p99_ms: float
    latency_max_ms: float
    stall_ms: float
    def __init__(self, load: _Optional[float] = ..., latency_p50_ms: _Optional[float] = ..., latency_p99_ms: _Optional[float] = ..., latency_max_ms: _Optional[float] = ..., stall_ms: _Optional[float] = ...) -> None: ...

class LogHealth(_message.Message):
    __slots__ = ("state", "path", "written_bytes", "queued_bytes", "dropped_bytes")
    class State(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        OFF: _ClassVar[LogHealth.State]
        WRITING: _ClassVar[LogHealth.State]
        STOPPED: _ClassVar[LogHealth.State]
    OFF: LogHealth.State
    WRITING: LogHealth.State
    STOPPED: LogHealth.State
    STATE_FIELD_NUMBER: _ClassVar[int]
    PATH_FIELD_NUMBER: _ClassVar[int]
    WRITTEN_BYTES_FIELD_NUMBER: _ClassVar[int]
    QUEUED_BYTES_FIELD_NUMBER: _ClassVar[int]
    DROPPED_BYTES_FIELD_NUMBER: _ClassVar[int]
    state: LogHealth.State
    path: str
    written_bytes: int
    queued_bytes: int
    dropped_bytes: int
    def __init__(self, state: _Optional[_Union[LogHealth.State, str]] = ..., path: _Optional[str] = ..., written_bytes: _Optional[int] = ..., queued_bytes: _Optional[int] = ..., dropped_bytes: _Optional[int] = ...) -> None: ...

class Health(_message.Message):
    __slots__ = ("vehicle", "t_ns", "uptime_s", "mode", "level", "text", "sensors", "links", "loop", "log", "counters")
    class Level(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        OK: _ClassVar[Health.Level]
        WARNING: _ClassVar[Health.Level]
        ERROR: _ClassVar[Health.Level]
    OK: Health.Level
    WARNING: Health.Level
    ERROR: Health.Level
    class CountersEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: int
        def __init__(self, key: _Optional[str] = ..., value: _Optional[int] = ...) -> None: ...
    VEHICLE_FIELD_NUMBER: _ClassVar[int]
    T_NS_FIELD_NUMBER: _ClassVar[int]
    UPTIME_S_FIELD_NUMBER: _ClassVar[int]
    MODE_FIELD_NUMBER: _ClassVar[int]
    LEVEL_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    SENSORS_FIELD_NUMBER: _ClassVar[int]
    LINKS_FIELD_NUMBER: _ClassVar[int]
    LOOP_FIELD_NUMBER: _ClassVar[int]
    LOG_FIELD_NUMBER: _ClassVar[int]
    COUNTERS_FIELD_NUMBER: _ClassVar[int]
    vehicle: str
    t_ns: int
    uptime_s: float
    mode: _navigation_pb2.NavState.Mode
    level: Health.Level
    text: str
    sensors: _containers.RepeatedCompositeFieldContainer[SensorHealth]
    links: _containers.RepeatedCompositeFieldContainer[LinkHealth]
    loop: LoopHealth
    log: LogHealth
    counters: _containers.ScalarMap[str, int]
    def __init__(self, vehicle: _Optional[str] = ..., t_ns: _Optional[int] = ..., uptime_s: _Optional[float] = ..., mode: _Optional[_Union[_navigation_pb2.NavState.Mode, str]] = ..., level: _Optional[_Union[Health.Level, str]] = ..., text: _Optional[str] = ..., sensors: _Optional[_Iterable[_Union[SensorHealth, _Mapping[str, object]]]] = ..., links: _Optional[_Iterable[_Union[LinkHealth, _Mapping[str, object]]]] = ..., loop: _Optional[_Union[LoopHealth, _Mapping[str, object]]] = ..., log: _Optional[_Union[LogHealth, _Mapping[str, object]]] = ..., counters: _Optional[_Mapping[str, int]] = ...) -> None: ...

from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Iterable as _Iterable, Mapping as _Mapping, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Config(_message.Message):
    __slots__ = ("toml",)
    TOML_FIELD_NUMBER: _ClassVar[int]
    toml: str
    def __init__(self, toml: _Optional[str] = ...) -> None: ...

class Versions(_message.Message):
    __slots__ = ("log_format", "metadata")
    class MetadataEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: str
        def __init__(self, key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...
    LOG_FORMAT_FIELD_NUMBER: _ClassVar[int]
    METADATA_FIELD_NUMBER: _ClassVar[int]
    log_format: int
    metadata: _containers.ScalarMap[str, str]
    def __init__(self, log_format: _Optional[int] = ..., metadata: _Optional[_Mapping[str, str]] = ...) -> None: ...

class Stream(_message.Message):
    __slots__ = ("kind", "source", "count", "rate_hz", "longest_gap_s", "gaps", "note", "first_seq")
    KIND_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    COUNT_FIELD_NUMBER: _ClassVar[int]
    RATE_HZ_FIELD_NUMBER: _ClassVar[int]
    LONGEST_GAP_S_FIELD_NUMBER: _ClassVar[int]
    GAPS_FIELD_NUMBER: _ClassVar[int]
    NOTE_FIELD_NUMBER: _ClassVar[int]
    FIRST_SEQ_FIELD_NUMBER: _ClassVar[int]
    kind: str
    source: str
    count: int
    rate_hz: float
    longest_gap_s: float
    gaps: int
    note: str
    first_seq: int
    def __init__(self, kind: _Optional[str] = ..., source: _Optional[str] = ..., count: _Optional[int] = ..., rate_hz: _Optional[float] = ..., longest_gap_s: _Optional[float] = ..., gaps: _Optional[int] = ..., note: _Optional[str] = ..., first_seq: _Optional[int] = ...) -> None: ...

class VehicleInfo(_message.Message):
    __slots__ = ("name", "height_datum", "order", "streams", "live")
    NAME_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_DATUM_FIELD_NUMBER: _ClassVar[int]
    ORDER_FIELD_NUMBER: _ClassVar[int]
    STREAMS_FIELD_NUMBER: _ClassVar[int]
    LIVE_FIELD_NUMBER: _ClassVar[int]
    name: str
    height_datum: str
    order: _containers.RepeatedCompositeFieldContainer[Stream]
    streams: _containers.RepeatedCompositeFieldContainer[Stream]
    live: bool
    def __init__(self, name: _Optional[str] = ..., height_datum: _Optional[str] = ..., order: _Optional[_Iterable[_Union[Stream, _Mapping[str, object]]]] = ..., streams: _Optional[_Iterable[_Union[Stream, _Mapping[str, object]]]] = ..., live: bool = ...) -> None: ...

class Checkpoint(_message.Message):
    __slots__ = ("seq", "digest", "digest_published")
    SEQ_FIELD_NUMBER: _ClassVar[int]
    DIGEST_FIELD_NUMBER: _ClassVar[int]
    DIGEST_PUBLISHED_FIELD_NUMBER: _ClassVar[int]
    seq: int
    digest: str
    digest_published: str
    def __init__(self, seq: _Optional[int] = ..., digest: _Optional[str] = ..., digest_published: _Optional[str] = ...) -> None: ...

class Summary(_message.Message):
    __slots__ = ("json",)
    JSON_FIELD_NUMBER: _ClassVar[int]
    json: str
    def __init__(self, json: _Optional[str] = ...) -> None: ...

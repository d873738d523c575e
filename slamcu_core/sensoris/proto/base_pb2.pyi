from google.protobuf import any_pb2 as _any_pb2
from google.protobuf import wrappers_pb2 as _wrappers_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Version(_message.Message):
    __slots__ = ("major", "minor", "patch", "name")
    MAJOR_FIELD_NUMBER: _ClassVar[int]
    MINOR_FIELD_NUMBER: _ClassVar[int]
    PATCH_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    major: _wrappers_pb2.Int64Value
    minor: _wrappers_pb2.Int64Value
    patch: _wrappers_pb2.Int64Value
    name: _wrappers_pb2.StringValue
    def __init__(self, major: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., minor: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., patch: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., name: _Optional[_Union[_wrappers_pb2.StringValue, _Mapping]] = ...) -> None: ...

class Entity(_message.Message):
    __slots__ = ("primary_id", "secondary_id", "type", "software_version", "hardware_version", "extension")
    PRIMARY_ID_FIELD_NUMBER: _ClassVar[int]
    SECONDARY_ID_FIELD_NUMBER: _ClassVar[int]
    TYPE_FIELD_NUMBER: _ClassVar[int]
    SOFTWARE_VERSION_FIELD_NUMBER: _ClassVar[int]
    HARDWARE_VERSION_FIELD_NUMBER: _ClassVar[int]
    EXTENSION_FIELD_NUMBER: _ClassVar[int]
    primary_id: _wrappers_pb2.StringValue
    secondary_id: _wrappers_pb2.StringValue
    type: _wrappers_pb2.StringValue
    software_version: Version
    hardware_version: Version
    extension: _containers.RepeatedCompositeFieldContainer[_any_pb2.Any]
    def __init__(self, primary_id: _Optional[_Union[_wrappers_pb2.StringValue, _Mapping]] = ..., secondary_id: _Optional[_Union[_wrappers_pb2.StringValue, _Mapping]] = ..., type: _Optional[_Union[_wrappers_pb2.StringValue, _Mapping]] = ..., software_version: _Optional[_Union[Version, _Mapping]] = ..., hardware_version: _Optional[_Union[Version, _Mapping]] = ..., extension: _Optional[_Iterable[_Union[_any_pb2.Any, _Mapping]]] = ...) -> None: ...

class Timestamp(_message.Message):
    __slots__ = ("posix_time", "posix_time_fraction")
    POSIX_TIME_FIELD_NUMBER: _ClassVar[int]
    POSIX_TIME_FRACTION_FIELD_NUMBER: _ClassVar[int]
    posix_time: _wrappers_pb2.Int64Value
    posix_time_fraction: _wrappers_pb2.Int64Value
    def __init__(self, posix_time: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., posix_time_fraction: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ...) -> None: ...

class TimestampInterval(_message.Message):
    __slots__ = ("start_inclusive", "end_exclusive")
    START_INCLUSIVE_FIELD_NUMBER: _ClassVar[int]
    END_EXCLUSIVE_FIELD_NUMBER: _ClassVar[int]
    start_inclusive: Timestamp
    end_exclusive: Timestamp
    def __init__(self, start_inclusive: _Optional[_Union[Timestamp, _Mapping]] = ..., end_exclusive: _Optional[_Union[Timestamp, _Mapping]] = ...) -> None: ...

class ExtensionTypeUrl(_message.Message):
    __slots__ = ("google_type_url_suffix", "type_url")
    GOOGLE_TYPE_URL_SUFFIX_FIELD_NUMBER: _ClassVar[int]
    TYPE_URL_FIELD_NUMBER: _ClassVar[int]
    google_type_url_suffix: _wrappers_pb2.StringValue
    type_url: _wrappers_pb2.StringValue
    def __init__(self, google_type_url_suffix: _Optional[_Union[_wrappers_pb2.StringValue, _Mapping]] = ..., type_url: _Optional[_Union[_wrappers_pb2.StringValue, _Mapping]] = ...) -> None: ...

class ExtensionTypeUrlAndVersion(_message.Message):
    __slots__ = ("type_url", "version")
    TYPE_URL_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    type_url: ExtensionTypeUrl
    version: Version
    def __init__(self, type_url: _Optional[_Union[ExtensionTypeUrl, _Mapping]] = ..., version: _Optional[_Union[Version, _Mapping]] = ...) -> None: ...

class EventEnvelope(_message.Message):
    __slots__ = ("id", "timestamp", "detection_type", "extension")
    class DetectionType(_message.Message):
        __slots__ = ("type",)
        class Type(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
            __slots__ = ()
            UNKNOWN_TYPE: _ClassVar[EventEnvelope.DetectionType.Type]
            TRIGGERED_MANUALLY: _ClassVar[EventEnvelope.DetectionType.Type]
            TRIGGERED_AUTOMATED_REGULAR: _ClassVar[EventEnvelope.DetectionType.Type]
            TRIGGERED_AUTOMATED_RARE: _ClassVar[EventEnvelope.DetectionType.Type]
            READING_SINGLE: _ClassVar[EventEnvelope.DetectionType.Type]
            READING_SIMPLE: _ClassVar[EventEnvelope.DetectionType.Type]
            READING_FUSION: _ClassVar[EventEnvelope.DetectionType.Type]
            COMPLEX: _ClassVar[EventEnvelope.DetectionType.Type]
        UNKNOWN_TYPE: EventEnvelope.DetectionType.Type
        TRIGGERED_MANUALLY: EventEnvelope.DetectionType.Type
        TRIGGERED_AUTOMATED_REGULAR: EventEnvelope.DetectionType.Type
        TRIGGERED_AUTOMATED_RARE: EventEnvelope.DetectionType.Type
        READING_SINGLE: EventEnvelope.DetectionType.Type
        READING_SIMPLE: EventEnvelope.DetectionType.Type
        READING_FUSION: EventEnvelope.DetectionType.Type
        COMPLEX: EventEnvelope.DetectionType.Type
        TYPE_FIELD_NUMBER: _ClassVar[int]
        type: EventEnvelope.DetectionType.Type
        def __init__(self, type: _Optional[_Union[EventEnvelope.DetectionType.Type, str]] = ...) -> None: ...
    ID_FIELD_NUMBER: _ClassVar[int]
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    DETECTION_TYPE_FIELD_NUMBER: _ClassVar[int]
    EXTENSION_FIELD_NUMBER: _ClassVar[int]
    id: _wrappers_pb2.Int64Value
    timestamp: Timestamp
    detection_type: EventEnvelope.DetectionType
    extension: _containers.RepeatedCompositeFieldContainer[_any_pb2.Any]
    def __init__(self, id: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., timestamp: _Optional[_Union[Timestamp, _Mapping]] = ..., detection_type: _Optional[_Union[EventEnvelope.DetectionType, _Mapping]] = ..., extension: _Optional[_Iterable[_Union[_any_pb2.Any, _Mapping]]] = ...) -> None: ...

class EventDetectionStatus(_message.Message):
    __slots__ = ("type", "confidence")
    class Type(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        UNKNOWN_TYPE: _ClassVar[EventDetectionStatus.Type]
        EXPECTED_AND_DETECTED: _ClassVar[EventDetectionStatus.Type]
        EXPECTED_AND_NOT_DETECTED: _ClassVar[EventDetectionStatus.Type]
        EXPECTED_AND_NOT_DETECTED_ACCESS_BLOCKED: _ClassVar[EventDetectionStatus.Type]
        EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE: _ClassVar[EventDetectionStatus.Type]
        NOT_EXPECTED_AND_DETECTED: _ClassVar[EventDetectionStatus.Type]
    UNKNOWN_TYPE: EventDetectionStatus.Type
    EXPECTED_AND_DETECTED: EventDetectionStatus.Type
    EXPECTED_AND_NOT_DETECTED: EventDetectionStatus.Type
    EXPECTED_AND_NOT_DETECTED_ACCESS_BLOCKED: EventDetectionStatus.Type
    EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE: EventDetectionStatus.Type
    NOT_EXPECTED_AND_DETECTED: EventDetectionStatus.Type
    TYPE_FIELD_NUMBER: _ClassVar[int]
    CONFIDENCE_FIELD_NUMBER: _ClassVar[int]
    type: EventDetectionStatus.Type
    confidence: Confidence
    def __init__(self, type: _Optional[_Union[EventDetectionStatus.Type, str]] = ..., confidence: _Optional[_Union[Confidence, _Mapping]] = ...) -> None: ...

class CategoryEnvelope(_message.Message):
    __slots__ = ("extension",)
    EXTENSION_FIELD_NUMBER: _ClassVar[int]
    extension: _containers.RepeatedCompositeFieldContainer[_any_pb2.Any]
    def __init__(self, extension: _Optional[_Iterable[_Union[_any_pb2.Any, _Mapping]]] = ...) -> None: ...

class Int64GaussianDistribution(_message.Message):
    __slots__ = ("timestamp_interval", "mean", "variance")
    TIMESTAMP_INTERVAL_FIELD_NUMBER: _ClassVar[int]
    MEAN_FIELD_NUMBER: _ClassVar[int]
    VARIANCE_FIELD_NUMBER: _ClassVar[int]
    timestamp_interval: TimestampInterval
    mean: _wrappers_pb2.Int64Value
    variance: _wrappers_pb2.Int64Value
    def __init__(self, timestamp_interval: _Optional[_Union[TimestampInterval, _Mapping]] = ..., mean: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., variance: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ...) -> None: ...

class Int64Value(_message.Message):
    __slots__ = ("value", "gaussian_distribution")
    VALUE_FIELD_NUMBER: _ClassVar[int]
    GAUSSIAN_DISTRIBUTION_FIELD_NUMBER: _ClassVar[int]
    value: int
    gaussian_distribution: Int64GaussianDistribution
    def __init__(self, value: _Optional[int] = ..., gaussian_distribution: _Optional[_Union[Int64GaussianDistribution, _Mapping]] = ...) -> None: ...

class Int64ValueAndAccuracy(_message.Message):
    __slots__ = ("value_and_accuracy", "gaussian_distribution")
    class ValueAndAccuracy(_message.Message):
        __slots__ = ("value", "accuracy")
        VALUE_FIELD_NUMBER: _ClassVar[int]
        ACCURACY_FIELD_NUMBER: _ClassVar[int]
        value: int
        accuracy: _wrappers_pb2.Int64Value
        def __init__(self, value: _Optional[int] = ..., accuracy: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ...) -> None: ...
    VALUE_AND_ACCURACY_FIELD_NUMBER: _ClassVar[int]
    GAUSSIAN_DISTRIBUTION_FIELD_NUMBER: _ClassVar[int]
    value_and_accuracy: Int64ValueAndAccuracy.ValueAndAccuracy
    gaussian_distribution: Int64GaussianDistribution
    def __init__(self, value_and_accuracy: _Optional[_Union[Int64ValueAndAccuracy.ValueAndAccuracy, _Mapping]] = ..., gaussian_distribution: _Optional[_Union[Int64GaussianDistribution, _Mapping]] = ...) -> None: ...

class Confidence(_message.Message):
    __slots__ = ("value",)
    VALUE_FIELD_NUMBER: _ClassVar[int]
    value: int
    def __init__(self, value: _Optional[int] = ...) -> None: ...

class CountAndConfidence(_message.Message):
    __slots__ = ("count", "confidence")
    COUNT_FIELD_NUMBER: _ClassVar[int]
    CONFIDENCE_FIELD_NUMBER: _ClassVar[int]
    count: _wrappers_pb2.Int64Value
    confidence: Confidence
    def __init__(self, count: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., confidence: _Optional[_Union[Confidence, _Mapping]] = ...) -> None: ...

class Int64Matrix3x3(_message.Message):
    __slots__ = ("a11", "a12", "a13", "a21", "a22", "a23", "a31", "a32", "a33")
    A11_FIELD_NUMBER: _ClassVar[int]
    A12_FIELD_NUMBER: _ClassVar[int]
    A13_FIELD_NUMBER: _ClassVar[int]
    A21_FIELD_NUMBER: _ClassVar[int]
    A22_FIELD_NUMBER: _ClassVar[int]
    A23_FIELD_NUMBER: _ClassVar[int]
    A31_FIELD_NUMBER: _ClassVar[int]
    A32_FIELD_NUMBER: _ClassVar[int]
    A33_FIELD_NUMBER: _ClassVar[int]
    a11: _wrappers_pb2.Int64Value
    a12: _wrappers_pb2.Int64Value
    a13: _wrappers_pb2.Int64Value
    a21: _wrappers_pb2.Int64Value
    a22: _wrappers_pb2.Int64Value
    a23: _wrappers_pb2.Int64Value
    a31: _wrappers_pb2.Int64Value
    a32: _wrappers_pb2.Int64Value
    a33: _wrappers_pb2.Int64Value
    def __init__(self, a11: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., a12: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., a13: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., a21: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., a22: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., a23: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., a31: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., a32: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., a33: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ...) -> None: ...

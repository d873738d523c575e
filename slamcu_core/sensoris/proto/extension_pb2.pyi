from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class PassEvidence(_message.Message):
    __slots__ = ("weight_for", "weight_against", "started_at", "ended_at", "frames_detected", "frames_missed", "frames_blocked", "place", "invalid", "sign", "value")
    class Place(_message.Message):
        __slots__ = ("longitude", "latitude", "variance_east", "covariance", "variance_north")
        LONGITUDE_FIELD_NUMBER: _ClassVar[int]
        LATITUDE_FIELD_NUMBER: _ClassVar[int]
        VARIANCE_EAST_FIELD_NUMBER: _ClassVar[int]
        COVARIANCE_FIELD_NUMBER: _ClassVar[int]
        VARIANCE_NORTH_FIELD_NUMBER: _ClassVar[int]
        longitude: float
        latitude: float
        variance_east: float
        covariance: float
        variance_north: float
        def __init__(self, longitude: _Optional[float] = ..., latitude: _Optional[float] = ..., variance_east: _Optional[float] = ..., covariance: _Optional[float] = ..., variance_north: _Optional[float] = ...) -> None: ...
    WEIGHT_FOR_FIELD_NUMBER: _ClassVar[int]
    WEIGHT_AGAINST_FIELD_NUMBER: _ClassVar[int]
    STARTED_AT_FIELD_NUMBER: _ClassVar[int]
    ENDED_AT_FIELD_NUMBER: _ClassVar[int]
    FRAMES_DETECTED_FIELD_NUMBER: _ClassVar[int]
    FRAMES_MISSED_FIELD_NUMBER: _ClassVar[int]
    FRAMES_BLOCKED_FIELD_NUMBER: _ClassVar[int]
    PLACE_FIELD_NUMBER: _ClassVar[int]
    INVALID_FIELD_NUMBER: _ClassVar[int]
    SIGN_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    weight_for: float
    weight_against: float
    started_at: int
    ended_at: int
    frames_detected: int
    frames_missed: int
    frames_blocked: int
    place: PassEvidence.Place
    invalid: bool
    sign: str
    value: str
    def __init__(self, weight_for: _Optional[float] = ..., weight_against: _Optional[float] = ..., started_at: _Optional[int] = ..., ended_at: _Optional[int] = ..., frames_detected: _Optional[int] = ..., frames_missed: _Optional[int] = ..., frames_blocked: _Optional[int] = ..., place: _Optional[_Union[PassEvidence.Place, _Mapping]] = ..., invalid: _Optional[bool] = ..., sign: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...

class MessageHealth(_message.Message):
    __slots__ = ("trusted", "effective_particles", "innovation_ratio", "unexplained_ratio", "sensor_model", "software_version")
    TRUSTED_FIELD_NUMBER: _ClassVar[int]
    EFFECTIVE_PARTICLES_FIELD_NUMBER: _ClassVar[int]
    INNOVATION_RATIO_FIELD_NUMBER: _ClassVar[int]
    UNEXPLAINED_RATIO_FIELD_NUMBER: _ClassVar[int]
    SENSOR_MODEL_FIELD_NUMBER: _ClassVar[int]
    SOFTWARE_VERSION_FIELD_NUMBER: _ClassVar[int]
    trusted: bool
    effective_particles: float
    innovation_ratio: float
    unexplained_ratio: float
    sensor_model: str
    software_version: str
    def __init__(self, trusted: _Optional[bool] = ..., effective_particles: _Optional[float] = ..., innovation_ratio: _Optional[float] = ..., unexplained_ratio: _Optional[float] = ..., sensor_model: _Optional[str] = ..., software_version: _Optional[str] = ...) -> None: ...

from google.protobuf import any_pb2 as _any_pb2
from google.protobuf import wrappers_pb2 as _wrappers_pb2
from slamcu_core.sensoris.proto import base_pb2 as _base_pb2
from slamcu_core.sensoris.proto import spatial_pb2 as _spatial_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class StaticObject(_message.Message):
    __slots__ = ("envelope", "object_id", "existence_confidence", "detection_status", "type_and_confidence", "rectangular_box_and_accuracy", "cone_and_accuracy")
    class TypeAndConfidence(_message.Message):
        __slots__ = ("type", "confidence")
        class Type(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
            __slots__ = ()
            UNKNOWN_TYPE: _ClassVar[StaticObject.TypeAndConfidence.Type]
            BRIDGE: _ClassVar[StaticObject.TypeAndConfidence.Type]
            TUNNEL: _ClassVar[StaticObject.TypeAndConfidence.Type]
            POLE: _ClassVar[StaticObject.TypeAndConfidence.Type]
            POLE_LIGHT: _ClassVar[StaticObject.TypeAndConfidence.Type]
            POLE_REFLECTOR: _ClassVar[StaticObject.TypeAndConfidence.Type]
            POLE_DELINEATOR: _ClassVar[StaticObject.TypeAndConfidence.Type]
            POLE_GANTRY: _ClassVar[StaticObject.TypeAndConfidence.Type]
            POLE_SIGN: _ClassVar[StaticObject.TypeAndConfidence.Type]
            POLE_GUARD_RAIL: _ClassVar[StaticObject.TypeAndConfidence.Type]
            BAR: _ClassVar[StaticObject.TypeAndConfidence.Type]
            TREE: _ClassVar[StaticObject.TypeAndConfidence.Type]
            BOLLARD: _ClassVar[StaticObject.TypeAndConfidence.Type]
            CONE: _ClassVar[StaticObject.TypeAndConfidence.Type]
            BARREL: _ClassVar[StaticObject.TypeAndConfidence.Type]
            WALL: _ClassVar[StaticObject.TypeAndConfidence.Type]
            TRAFFIC_ISLAND: _ClassVar[StaticObject.TypeAndConfidence.Type]
            SPEED_BUMP: _ClassVar[StaticObject.TypeAndConfidence.Type]
            POT_HOLE: _ClassVar[StaticObject.TypeAndConfidence.Type]
            MANHOLE_COVER: _ClassVar[StaticObject.TypeAndConfidence.Type]
            MANHOLE_COVER_CLOSED: _ClassVar[StaticObject.TypeAndConfidence.Type]
            MANHOLE_COVER_OPEN: _ClassVar[StaticObject.TypeAndConfidence.Type]
            SIGN_BRIDGE: _ClassVar[StaticObject.TypeAndConfidence.Type]
            TRAFFIC_LIGHT_BODY: _ClassVar[StaticObject.TypeAndConfidence.Type]
            BARRIER_PARKING_LOT: _ClassVar[StaticObject.TypeAndConfidence.Type]
            SURFACE_RAISED: _ClassVar[StaticObject.TypeAndConfidence.Type]
            TRAFFIC_ENFORCEMENT_CAMERA: _ClassVar[StaticObject.TypeAndConfidence.Type]
            TRAFFIC_ENFORCEMENT_CAMERA_FIXED: _ClassVar[StaticObject.TypeAndConfidence.Type]
            TRAFFIC_ENFORCEMENT_CAMERA_MOBILE: _ClassVar[StaticObject.TypeAndConfidence.Type]
        UNKNOWN_TYPE: StaticObject.TypeAndConfidence.Type
        BRIDGE: StaticObject.TypeAndConfidence.Type
        TUNNEL: StaticObject.TypeAndConfidence.Type
        POLE: StaticObject.TypeAndConfidence.Type
        POLE_LIGHT: StaticObject.TypeAndConfidence.Type
        POLE_REFLECTOR: StaticObject.TypeAndConfidence.Type
        POLE_DELINEATOR: StaticObject.TypeAndConfidence.Type
        POLE_GANTRY: StaticObject.TypeAndConfidence.Type
        POLE_SIGN: StaticObject.TypeAndConfidence.Type
        POLE_GUARD_RAIL: StaticObject.TypeAndConfidence.Type
        BAR: StaticObject.TypeAndConfidence.Type
        TREE: StaticObject.TypeAndConfidence.Type
        BOLLARD: StaticObject.TypeAndConfidence.Type
        CONE: StaticObject.TypeAndConfidence.Type
        BARREL: StaticObject.TypeAndConfidence.Type
        WALL: StaticObject.TypeAndConfidence.Type
        TRAFFIC_ISLAND: StaticObject.TypeAndConfidence.Type
        SPEED_BUMP: StaticObject.TypeAndConfidence.Type
        POT_HOLE: StaticObject.TypeAndConfidence.Type
        MANHOLE_COVER: StaticObject.TypeAndConfidence.Type
        MANHOLE_COVER_CLOSED: StaticObject.TypeAndConfidence.Type
        MANHOLE_COVER_OPEN: StaticObject.TypeAndConfidence.Type
        SIGN_BRIDGE: StaticObject.TypeAndConfidence.Type
        TRAFFIC_LIGHT_BODY: StaticObject.TypeAndConfidence.Type
        BARRIER_PARKING_LOT: StaticObject.TypeAndConfidence.Type
        SURFACE_RAISED: StaticObject.TypeAndConfidence.Type
        TRAFFIC_ENFORCEMENT_CAMERA: StaticObject.TypeAndConfidence.Type
        TRAFFIC_ENFORCEMENT_CAMERA_FIXED: StaticObject.TypeAndConfidence.Type
        TRAFFIC_ENFORCEMENT_CAMERA_MOBILE: StaticObject.TypeAndConfidence.Type
        TYPE_FIELD_NUMBER: _ClassVar[int]
        CONFIDENCE_FIELD_NUMBER: _ClassVar[int]
        type: StaticObject.TypeAndConfidence.Type
        confidence: _base_pb2.Confidence
        def __init__(self, type: _Optional[_Union[StaticObject.TypeAndConfidence.Type, str]] = ..., confidence: _Optional[_Union[_base_pb2.Confidence, _Mapping]] = ...) -> None: ...
    class ConeAndAccuracy(_message.Message):
        __slots__ = ("lower_position_and_accuracy", "upper_position_and_accuracy", "lower_diameter_and_accuracy", "upper_diameter_and_accuracy", "extension")
        LOWER_POSITION_AND_ACCURACY_FIELD_NUMBER: _ClassVar[int]
        UPPER_POSITION_AND_ACCURACY_FIELD_NUMBER: _ClassVar[int]
        LOWER_DIAMETER_AND_ACCURACY_FIELD_NUMBER: _ClassVar[int]
        UPPER_DIAMETER_AND_ACCURACY_FIELD_NUMBER: _ClassVar[int]
        EXTENSION_FIELD_NUMBER: _ClassVar[int]
        lower_position_and_accuracy: _spatial_pb2.PositionAndAccuracy
        upper_position_and_accuracy: _spatial_pb2.PositionAndAccuracy
        lower_diameter_and_accuracy: _base_pb2.Int64ValueAndAccuracy
        upper_diameter_and_accuracy: _base_pb2.Int64ValueAndAccuracy
        extension: _containers.RepeatedCompositeFieldContainer[_any_pb2.Any]
        def __init__(self, lower_position_and_accuracy: _Optional[_Union[_spatial_pb2.PositionAndAccuracy, _Mapping]] = ..., upper_position_and_accuracy: _Optional[_Union[_spatial_pb2.PositionAndAccuracy, _Mapping]] = ..., lower_diameter_and_accuracy: _Optional[_Union[_base_pb2.Int64ValueAndAccuracy, _Mapping]] = ..., upper_diameter_and_accuracy: _Optional[_Union[_base_pb2.Int64ValueAndAccuracy, _Mapping]] = ..., extension: _Optional[_Iterable[_Union[_any_pb2.Any, _Mapping]]] = ...) -> None: ...
    ENVELOPE_FIELD_NUMBER: _ClassVar[int]
    OBJECT_ID_FIELD_NUMBER: _ClassVar[int]
    EXISTENCE_CONFIDENCE_FIELD_NUMBER: _ClassVar[int]
    DETECTION_STATUS_FIELD_NUMBER: _ClassVar[int]
    TYPE_AND_CONFIDENCE_FIELD_NUMBER: _ClassVar[int]
    RECTANGULAR_BOX_AND_ACCURACY_FIELD_NUMBER: _ClassVar[int]
    CONE_AND_ACCURACY_FIELD_NUMBER: _ClassVar[int]
    envelope: _base_pb2.EventEnvelope
    object_id: _wrappers_pb2.Int64Value
    existence_confidence: _base_pb2.Confidence
    detection_status: _base_pb2.EventDetectionStatus
    type_and_confidence: StaticObject.TypeAndConfidence
    rectangular_box_and_accuracy: _spatial_pb2.RectangularBoxAndAccuracy
    cone_and_accuracy: StaticObject.ConeAndAccuracy
    def __init__(self, envelope: _Optional[_Union[_base_pb2.EventEnvelope, _Mapping]] = ..., object_id: _Optional[_Union[_wrappers_pb2.Int64Value, _Mapping]] = ..., existence_confidence: _Optional[_Union[_base_pb2.Confidence, _Mapping]] = ..., detection_status: _Optional[_Union[_base_pb2.EventDetectionStatus, _Mapping]] = ..., type_and_confidence: _Optional[_Union[StaticObject.TypeAndConfidence, _Mapping]] = ..., rectangular_box_and_accuracy: _Optional[_Union[_spatial_pb2.RectangularBoxAndAccuracy, _Mapping]] = ..., cone_and_accuracy: _Optional[_Union[StaticObject.ConeAndAccuracy, _Mapping]] = ...) -> None: ...

class ObjectDetectionCategory(_message.Message):
    __slots__ = ("envelope", "static_object")
    ENVELOPE_FIELD_NUMBER: _ClassVar[int]
    STATIC_OBJECT_FIELD_NUMBER: _ClassVar[int]
    envelope: _base_pb2.CategoryEnvelope
    static_object: _containers.RepeatedCompositeFieldContainer[StaticObject]
    def __init__(self, envelope: _Optional[_Union[_base_pb2.CategoryEnvelope, _Mapping]] = ..., static_object: _Optional[_Iterable[_Union[StaticObject, _Mapping]]] = ...) -> None: ...

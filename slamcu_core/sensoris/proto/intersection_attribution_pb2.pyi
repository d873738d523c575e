from slamcu_core.sensoris.proto import base_pb2 as _base_pb2
from slamcu_core.sensoris.proto import spatial_pb2 as _spatial_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class TrafficSignal(_message.Message):
    __slots__ = ("envelope", "existence_confidence", "detection_status", "rectangular_box_and_accuracy", "bulb_count_and_confidence", "orientation_and_confidence")
    class OrientationAndConfidence(_message.Message):
        __slots__ = ("type", "confidence")
        class Type(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
            __slots__ = ()
            UNKNOWN_TYPE: _ClassVar[TrafficSignal.OrientationAndConfidence.Type]
            OTHER: _ClassVar[TrafficSignal.OrientationAndConfidence.Type]
            HORIZONTAL: _ClassVar[TrafficSignal.OrientationAndConfidence.Type]
            VERTICAL: _ClassVar[TrafficSignal.OrientationAndConfidence.Type]
            MIXED: _ClassVar[TrafficSignal.OrientationAndConfidence.Type]
        UNKNOWN_TYPE: TrafficSignal.OrientationAndConfidence.Type
        OTHER: TrafficSignal.OrientationAndConfidence.Type
        HORIZONTAL: TrafficSignal.OrientationAndConfidence.Type
        VERTICAL: TrafficSignal.OrientationAndConfidence.Type
        MIXED: TrafficSignal.OrientationAndConfidence.Type
        TYPE_FIELD_NUMBER: _ClassVar[int]
        CONFIDENCE_FIELD_NUMBER: _ClassVar[int]
        type: TrafficSignal.OrientationAndConfidence.Type
        confidence: _base_pb2.Confidence
        def __init__(self, type: _Optional[_Union[TrafficSignal.OrientationAndConfidence.Type, str]] = ..., confidence: _Optional[_Union[_base_pb2.Confidence, _Mapping]] = ...) -> None: ...
    ENVELOPE_FIELD_NUMBER: _ClassVar[int]
    EXISTENCE_CONFIDENCE_FIELD_NUMBER: _ClassVar[int]
    DETECTION_STATUS_FIELD_NUMBER: _ClassVar[int]
    RECTANGULAR_BOX_AND_ACCURACY_FIELD_NUMBER: _ClassVar[int]
    BULB_COUNT_AND_CONFIDENCE_FIELD_NUMBER: _ClassVar[int]
    ORIENTATION_AND_CONFIDENCE_FIELD_NUMBER: _ClassVar[int]
    envelope: _base_pb2.EventEnvelope
    existence_confidence: _base_pb2.Confidence
    detection_status: _base_pb2.EventDetectionStatus
    rectangular_box_and_accuracy: _spatial_pb2.RectangularBoxAndAccuracy
    bulb_count_and_confidence: _base_pb2.CountAndConfidence
    orientation_and_confidence: TrafficSignal.OrientationAndConfidence
    def __init__(self, envelope: _Optional[_Union[_base_pb2.EventEnvelope, _Mapping]] = ..., existence_confidence: _Optional[_Union[_base_pb2.Confidence, _Mapping]] = ..., detection_status: _Optional[_Union[_base_pb2.EventDetectionStatus, _Mapping]] = ..., rectangular_box_and_accuracy: _Optional[_Union[_spatial_pb2.RectangularBoxAndAccuracy, _Mapping]] = ..., bulb_count_and_confidence: _Optional[_Union[_base_pb2.CountAndConfidence, _Mapping]] = ..., orientation_and_confidence: _Optional[_Union[TrafficSignal.OrientationAndConfidence, _Mapping]] = ...) -> None: ...

class IntersectionAttributionCategory(_message.Message):
    __slots__ = ("envelope", "traffic_signal")
    ENVELOPE_FIELD_NUMBER: _ClassVar[int]
    TRAFFIC_SIGNAL_FIELD_NUMBER: _ClassVar[int]
    envelope: _base_pb2.CategoryEnvelope
    traffic_signal: _containers.RepeatedCompositeFieldContainer[TrafficSignal]
    def __init__(self, envelope: _Optional[_Union[_base_pb2.CategoryEnvelope, _Mapping]] = ..., traffic_signal: _Optional[_Iterable[_Union[TrafficSignal, _Mapping]]] = ...) -> None: ...

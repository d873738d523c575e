from slamcu_core.sensoris.proto import base_pb2 as _base_pb2
from slamcu_core.sensoris.proto import spatial_pb2 as _spatial_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class VehiclePositionAndOrientation(_message.Message):
    __slots__ = ("envelope", "position_and_accuracy", "orientation_and_accuracy")
    ENVELOPE_FIELD_NUMBER: _ClassVar[int]
    POSITION_AND_ACCURACY_FIELD_NUMBER: _ClassVar[int]
    ORIENTATION_AND_ACCURACY_FIELD_NUMBER: _ClassVar[int]
    envelope: _base_pb2.EventEnvelope
    position_and_accuracy: _spatial_pb2.PositionAndAccuracy
    orientation_and_accuracy: _spatial_pb2.RotationAndAccuracy
    def __init__(self, envelope: _Optional[_Union[_base_pb2.EventEnvelope, _Mapping]] = ..., position_and_accuracy: _Optional[_Union[_spatial_pb2.PositionAndAccuracy, _Mapping]] = ..., orientation_and_accuracy: _Optional[_Union[_spatial_pb2.RotationAndAccuracy, _Mapping]] = ...) -> None: ...

class LocalizationCategory(_message.Message):
    __slots__ = ("envelope", "vehicle_position_and_orientation")
    ENVELOPE_FIELD_NUMBER: _ClassVar[int]
    VEHICLE_POSITION_AND_ORIENTATION_FIELD_NUMBER: _ClassVar[int]
    envelope: _base_pb2.CategoryEnvelope
    vehicle_position_and_orientation: _containers.RepeatedCompositeFieldContainer[VehiclePositionAndOrientation]
    def __init__(self, envelope: _Optional[_Union[_base_pb2.CategoryEnvelope, _Mapping]] = ..., vehicle_position_and_orientation: _Optional[_Iterable[_Union[VehiclePositionAndOrientation, _Mapping]]] = ...) -> None: ...

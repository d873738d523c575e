from slamcu_core.sensoris.proto import base_pb2 as _base_pb2
from slamcu_core.sensoris.proto import spatial_pb2 as _spatial_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class MapReference(_message.Message):
    __slots__ = ("envelope", "location_reference")
    ENVELOPE_FIELD_NUMBER: _ClassVar[int]
    LOCATION_REFERENCE_FIELD_NUMBER: _ClassVar[int]
    envelope: _base_pb2.EventEnvelope
    location_reference: _spatial_pb2.MapLocationReference
    def __init__(self, envelope: _Optional[_Union[_base_pb2.EventEnvelope, _Mapping]] = ..., location_reference: _Optional[_Union[_spatial_pb2.MapLocationReference, _Mapping]] = ...) -> None: ...

class MapCategory(_message.Message):
    __slots__ = ("envelope", "map_reference")
    ENVELOPE_FIELD_NUMBER: _ClassVar[int]
    MAP_REFERENCE_FIELD_NUMBER: _ClassVar[int]
    envelope: _base_pb2.CategoryEnvelope
    map_reference: _containers.RepeatedCompositeFieldContainer[MapReference]
    def __init__(self, envelope: _Optional[_Union[_base_pb2.CategoryEnvelope, _Mapping]] = ..., map_reference: _Optional[_Iterable[_Union[MapReference, _Mapping]]] = ...) -> None: ...

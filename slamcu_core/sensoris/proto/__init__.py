"""The SENSORIS subset and slamcu's extension as protobuf, with the generated classes (`scripts/generate-protobuf`)."""

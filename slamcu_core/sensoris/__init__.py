"""slamcu sensoris."""

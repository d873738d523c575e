"""Simulated worlds, recorded robots, scoring and the demo of slamcu."""

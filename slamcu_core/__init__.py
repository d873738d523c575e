"""SLAMCU: simultaneous localization and map change update, after Jo, Kim and Sunwoo (Sensors 2018, 18, 3145).

The package is the part of slamcu that cars and cloud share. It needs numpy (and protobuf for the wire) and does no
I/O, reads no clock and touches no global random state; only `program`, for command lines, acts on the process.
"""

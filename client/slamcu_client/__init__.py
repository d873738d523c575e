"""The vehicle side of slamcu."""

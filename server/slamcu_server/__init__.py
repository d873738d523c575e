"""The cloud side of slamcu."""
